import re
from html.parser import HTMLParser

import numpy as np
import pytest

from qjrl.report.canvas import as_png
from qjrl.report.error_figures import cumulative_errors
from qjrl.report.html import clock, prose, three_digits
from qjrl.report.metrics import error_table
from qjrl.report.outcomes import Outcome
from qjrl.report.page import Number, Picture, Report, Section, report_page, write_report

EVIL = "<script>alert('1 & 2')</script>"
VOID = {"meta", "img", "path", "use", "image"}


@pytest.fixture(scope="module")
def page() -> str:
    errors = np.linspace(1e-4, 5e-3, 40)
    outcome = Outcome("nominal", "uniform", errors, errors, np.ones((40, 2)), np.zeros((40, 2), bool))
    figure = cumulative_errors([outcome])
    section = Section(
        EVIL,
        f"One {EVIL}\n\nTwo",
        (Number(EVIL, EVIL, EVIL, EVIL),),
        (error_table([outcome]),),
        (Picture(figure, EVIL), Picture(figure, "again"), Picture(as_png(figure, 50), EVIL, is_wide=True)),
    )
    provenance = {"config": {"name": EVIL}, EVIL: EVIL, "seed": 3, "code": {"commit": "0123456789abcdef"}}
    return report_page(
        Report(
            EVIL, "The verdict", EVIL, False, (Number("median", 1.234, "mm"),), (EVIL,), (section, section),
            {EVIL: 75.0}, provenance,
        )
    )  # fmt: skip


class Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.stack: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.first_text = ""

    def handle_starttag(self, tag, attrs):
        attributes = {key: value or "" for key, value in attrs}
        self.ids += [attributes["id"]] if "id" in attributes else []
        self.links += [attributes[key] for key in ("src", "href", "srcset", "data", "action") if key in attributes]
        if tag not in VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.stack.pop()

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.stack.pop() == tag

    def handle_data(self, data):
        if data.strip() and "body" in self.stack and not self.first_text:
            self.first_text = data.strip()


@pytest.fixture(scope="module")
def read(page) -> Reader:
    reader = Reader()
    reader.feed(page)
    return reader


def test_page_needs_nothing_from_outside(page, read):
    assert not re.search(r"https?:|//[a-z]|@import|url\((?!#)", re.sub(r'"data:image/png;base64,[^"]*"', '""', page))
    assert read.links
    assert all(link.startswith(("data:", "#")) for link in read.links)


def test_all_texts_are_escaped(page):
    assert "<script" not in page
    assert page.count("&lt;script&gt;") > 15


def test_page_is_well_formed(read):
    assert read.stack == []


def test_the_first_line_is_the_verdict(read):
    assert read.first_text == "The verdict"


def test_ids_of_figures_do_not_clash(page, read):
    in_figures = [name for name in read.ids if re.match(r"s\d+p\d+-", name)]
    assert len(in_figures) == len(set(in_figures))
    references = set(re.findall(r"url\(#([^)]+)\)", page))
    assert references
    assert references <= set(read.ids)


def test_figures_follow_light_and_dark(page):
    drawings = re.findall(r"<svg.*?</svg>", page, flags=re.DOTALL)
    assert len(drawings) == 4
    assert all("var(--ink)" in drawing and not re.search(r"#[0-9a-f]{6}\b", drawing) for drawing in drawings)
    assert "prefers-color-scheme: dark" in page


def test_the_file_is_written_whole(tmp_path):
    write_report(tmp_path / "report.html", Report("run", "Verdict"))
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert "Verdict" in (tmp_path / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("value", "text"),
    [(8192, "8,192"), (0.0, "0"), (1.791, "1.79"), (23.46, "23.5"), (0.0123, "0.0123"), (238.4, "238")],
)
def test_three_digits(value, text):
    assert three_digits(value) == text


def test_durations_are_readable():
    assert [clock(seconds) for seconds in (12, 185.4, 3723)] == ["12 s", "3:05 min", "1:02:03 h"]


def test_numbers_keep_their_units():
    assert prose("1.2 mm and 3 % & more") == "1.2\u00a0mm and 3\u00a0% &amp; more"
