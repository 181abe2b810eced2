import logging
import subprocess
import sys

import numpy as np
import pytest

from qjrl import artifacts
from qjrl.provenance import provenance
from qjrl.report.canvas import DPI, new_figure
from qjrl.report.output import Drawn, Output, write_output
from qjrl.report.page import Report
from qjrl.report.tables import Column, Table, as_markdown, as_text

TABLE = Table((Column("name"), Column("error", 1, "mm")), (("a", 1.0), ("b", 2.5)))
OTHER = Table((Column("name"),), (("c",),))


def test_what_a_stage_returns_is_written_under_the_names_it_gives_and_nothing_else(tmp_path) -> None:
    artifacts.write_json(tmp_path / artifacts.PROVENANCE, provenance({"x": 1}, 7, None))
    output = Output(
        {"median_mm": 1.5},
        {"raw": {"errors": np.arange(3.0)}},
        lambda: Drawn({"arm": new_figure(2.0, 1.0)}, {"report": Report("a run", "It holds")}),
        {"table": (TABLE, OTHER)},
        {"contract": {"format": 1}},
        {"forward.stablehlo": b"\x00\x01"},
    )
    write_output(output, tmp_path)
    written = {path.name for path in tmp_path.iterdir()} - {artifacts.PROVENANCE}
    assert written == {
        "metrics.json", "raw.npz", "arm.png", "table.md", "report.html", "contract.json", "forward.stablehlo"
    }  # fmt: skip
    assert artifacts.load(tmp_path / "metrics.json") == {"median_mm": 1.5}
    assert artifacts.load(tmp_path / "raw.npz")["errors"].tolist() == [0.0, 1.0, 2.0]
    assert artifacts.load(tmp_path / "contract.json") == {"format": 1}
    assert (tmp_path / "forward.stablehlo").read_bytes() == b"\x00\x01"
    assert (tmp_path / "table.md").read_text() == as_markdown(TABLE) + "\n" + as_markdown(OTHER)
    width = int.from_bytes((tmp_path / "arm.png").read_bytes()[16:20])
    assert width == pytest.approx(2.0 * DPI, abs=1)
    page = (tmp_path / "report.html").read_text()
    assert "It holds" in page and "&quot;x&quot;: 1" in page  # the provenance of the stage


def test_a_drawing_that_fails_loses_no_number(tmp_path) -> None:
    def draw() -> Drawn:
        raise ZeroDivisionError("a picture of nothing")

    output = Output({"median_mm": 1.5}, {"raw": {"errors": np.arange(3.0)}}, draw, {"table": (TABLE,)})
    with pytest.raises(ZeroDivisionError):
        write_output(output, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"metrics.json", "raw.npz", "table.md"}
    assert artifacts.load(tmp_path / "metrics.json") == {"median_mm": 1.5}


def test_tables_of_files_come_first_in_the_log_then_what_is_shown(tmp_path, caplog) -> None:
    with caplog.at_level(logging.INFO):
        write_output(Output(tables={"table": (TABLE,)}, shown=(OTHER, "a verdict")), tmp_path)
    assert [message.rstrip() for message in caplog.messages] == [as_text(TABLE), as_text(OTHER), "a verdict"]
    assert {path.name for path in tmp_path.iterdir()} == {"table.md"}


def test_an_empty_output_writes_nothing(tmp_path) -> None:
    write_output(Output(), tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_stage_without_figures_does_not_load_matplotlib(tmp_path) -> None:
    program = (
        "import sys; from pathlib import Path; from qjrl.report.output import Output, write_output; "
        "import qjrl.stages.sample; write_output(Output({'a': 1.0}), Path(sys.argv[1])); "
        "sys.exit('matplotlib' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program, str(tmp_path)]).returncode == 0
