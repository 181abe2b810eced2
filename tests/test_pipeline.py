import dataclasses
import fcntl
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import pytest

from qjrl import artifacts, pipeline
from qjrl.artifacts import ArtifactError
from qjrl.config import ConfigError, Range
from qjrl.pipeline import Stage
from qjrl.report.output import Output
from qjrl.stage_config import StageConfig


@dataclasses.dataclass(frozen=True)
class First:
    count: Annotated[int, Range(1, 10)]


@dataclasses.dataclass(frozen=True)
class Second:
    gain: float = 1.0


@dataclasses.dataclass(frozen=True)
class FirstConfig(StageConfig):
    first: First


@dataclasses.dataclass(frozen=True)
class SecondConfig(StageConfig):
    second: Second


TREE: dict[str, Any] = {"name": "t", "stages": ["second", "first"], "seed": 1, "first": {"count": 2}, "second": {}}


@pytest.fixture
def calls(monkeypatch) -> list[str]:
    """Two fake stages, the second reading the first; the list records each run of one."""
    calls: list[str] = []

    def run_first(config: FirstConfig, inputs: dict[str, Path], out: Path) -> Output:
        calls.append("first, going on" if (out / "partial.json").exists() else "first")
        artifacts.write_json(out / "partial.json", 0)
        if config.first.count == 7:
            raise KeyboardInterrupt
        return Output(records={"count": config.first.count})

    def run_second(config: SecondConfig, inputs: dict[str, Path], out: Path) -> Output:
        calls.append("second")
        return Output(records={"product": config.second.gain * artifacts.load(inputs["first"] / "count.json")})

    for name, kind, run in (("first", FirstConfig, run_first), ("second", SecondConfig, run_second)):
        module = ModuleType(f"fake_{name}")
        module.__dict__.update(Config=kind, run=run)
        monkeypatch.setitem(sys.modules, f"fake_{name}", module)
    stages = {
        "first": Stage("fake_first", "counts", writes="one"),
        "second": Stage("fake_second", "multiplies", reads=("first",), writes="two"),
    }
    monkeypatch.setattr(pipeline, "STAGES", stages)
    monkeypatch.setattr(pipeline, "GROUPS", {"first": "first", "second": "second"})
    return calls


def run(run_dir: Path, stages: list[str] | None = None, **changes: Any) -> None:
    tree = TREE | changes | ({"stages": stages} if stages else {})
    pipeline.run(pipeline.selected(tree), pipeline.build_configs(tree), run_dir)


def test_stages_run_in_the_order_of_the_data_flow_whatever_the_order_asked_for(tmp_path, calls) -> None:
    run(tmp_path)
    assert calls == ["first", "second"]
    assert artifacts.load(tmp_path / "two" / "product.json") == 2.0


def test_what_is_done_and_unchanged_is_skipped(tmp_path, calls) -> None:
    run(tmp_path)
    run(tmp_path)
    assert calls == ["first", "second"]


def test_a_change_runs_again_only_what_depends_on_it_and_keeps_the_old_output(tmp_path, calls) -> None:
    run(tmp_path)
    run(tmp_path, second={"gain": 3})
    assert calls == ["first", "second", "second"]
    assert artifacts.load(tmp_path / "two" / "product.json") == 6.0
    assert artifacts.load(tmp_path / "two.previous" / "product.json") == 2.0
    run(tmp_path, first={"count": 4}, second={"gain": 3})
    assert calls == ["first", "second", "second", "first", "second"]
    assert artifacts.load(tmp_path / "two.previous" / "product.json") == 6.0
    assert artifacts.load(tmp_path / "two.previous-2" / "product.json") == 2.0


def test_an_interrupted_stage_goes_on_in_its_directory(tmp_path, calls) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, first={"count": 7})
    assert artifacts.done_marker(tmp_path / "one") is None
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, first={"count": 7})
    run(tmp_path, first={"count": 8})  # another configuration: not the work of the interrupted run
    assert calls == ["first", "first, going on", "first", "second"]


def test_an_input_that_is_missing_or_unfinished_is_one_line_that_says_what_to_run(tmp_path, calls) -> None:
    with pytest.raises(ArtifactError, match=r"does not exist; run stages=\[first,second\]"):
        run(tmp_path, stages=["second"])
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, first={"count": 7})
    with pytest.raises(ArtifactError, match="is not finished"):
        run(tmp_path, stages=["second"])
    assert not (tmp_path / "two").exists()


def test_all_stages_that_are_missing_are_named_at_once(tmp_path, calls, monkeypatch) -> None:
    stages = pipeline.STAGES | {"third": Stage("fake_second", "multiplies", reads=("first", "second"), writes="three")}
    monkeypatch.setattr(pipeline, "STAGES", stages)
    configs = {"third": SecondConfig(Second(), seed=1)}
    with pytest.raises(ArtifactError, match=r"one, which does not exist; run stages=\[first,second,third\]"):
        pipeline.run(["third"], configs, tmp_path)
    run(tmp_path, stages=["first"])
    with pytest.raises(ArtifactError, match=r"two, which does not exist; run stages=\[second,third\]"):
        pipeline.run(["third"], configs, tmp_path)
    pipeline.run(["second", "third"], configs | {"second": SecondConfig(Second(), seed=1)}, tmp_path)
    assert calls == ["first", "second", "second"]


def test_what_a_stage_finds_outside_of_its_configuration_is_part_of_its_identity(tmp_path, calls, monkeypatch) -> None:
    for outside in ({}, {"missing": "onnx"}, {"missing": "onnx"}, {}, {"missing": "h5"}):
        monkeypatch.setattr(FirstConfig, "packages", outside)
        run(tmp_path, stages=["first"])
    assert calls == ["first"] * 3  # the fourth takes the first's output back


def test_a_second_run_in_the_same_directory_is_refused(tmp_path, calls) -> None:
    with open(tmp_path / ".lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(ArtifactError, match="another run is at work here"):
            run(tmp_path)
    run(tmp_path)
    assert calls == ["first", "second"]


@dataclasses.dataclass(frozen=True)
class Share:
    index: int | None = None


@dataclasses.dataclass(frozen=True)
class ShareConfig(StageConfig):
    """A stage that two processes may share: each writes its number, the whole adds them."""

    share: Share = Share()

    @property
    def part(self) -> str | None:
        return None if self.share.index is None else f"{self.share.index}-of-2"

    def whole(self) -> "ShareConfig":
        return ShareConfig(seed=self.seed)

    def parts(self) -> "dict[str, ShareConfig]":
        configs = [ShareConfig(Share(index), seed=self.seed) for index in range(2)]
        return {str(config.part): config for config in configs}


@pytest.fixture
def shared(calls, monkeypatch) -> list[str]:
    """The first of the two fake stages becomes one that can be shared."""

    def run_share(config: ShareConfig, inputs: dict[str, Path], out: Path) -> Output:
        calls.append(config.part or "whole")
        if config.part:
            return Output(records={"count": config.seed + (config.share.index or 0)})
        counts = [artifacts.load(path) for path in artifacts.parts_of(out).glob("*-of-2/count.json")]
        return Output(records={"count": sum(counts)})

    monkeypatch.setattr(sys.modules["fake_first"], "Config", ShareConfig)
    monkeypatch.setattr(sys.modules["fake_first"], "run", run_share)
    monkeypatch.setattr(pipeline, "GROUPS", {"share": "first", "second": "second"})
    return calls


def run_shared(run_dir: Path, share: int | None, stages: list[str], seed: int = 1) -> None:
    tree = {"name": "t", "stages": stages, "seed": seed, "share": {"index": share}, "second": {}}
    pipeline.run(pipeline.selected(tree), pipeline.build_configs(tree), run_dir)


def test_the_part_that_ends_last_makes_the_whole_and_a_run_of_the_whole_skips_it(tmp_path, shared) -> None:
    run_shared(tmp_path, 1, ["first"])
    run_shared(tmp_path, 1, ["first"])
    assert shared == ["1-of-2"] and not (tmp_path / "one").exists()
    run_shared(tmp_path, 0, ["first"])
    assert shared == ["1-of-2", "0-of-2", "whole"]
    run_shared(tmp_path, None, ["first", "second"])
    assert shared == ["1-of-2", "0-of-2", "whole", "second"]
    assert artifacts.load(tmp_path / "two" / "product.json") == 3.0
    run_shared(tmp_path, 0, ["first"])
    assert shared[-1] == "second"


def test_a_part_of_another_configuration_does_not_make_the_whole(tmp_path, shared) -> None:
    run_shared(tmp_path, 1, ["first"], seed=5)
    run_shared(tmp_path, 0, ["first"])
    assert shared == ["1-of-2", "0-of-2"]
    run_shared(tmp_path, 1, ["first"])
    assert shared == ["1-of-2", "0-of-2", "1-of-2", "whole"]
    assert artifacts.load(tmp_path / "one" / "count.json") == 3
    assert (tmp_path / "one.parts" / "1-of-2.previous").exists()


def test_parts_are_made_beside_each_other_but_one_part_by_one_process(tmp_path, shared) -> None:
    (tmp_path / "one.parts").mkdir()
    with open(tmp_path / "one.parts" / ".0-of-2.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        run_shared(tmp_path, 1, ["first"])
        with pytest.raises(ArtifactError, match="another run is at work here"):
            run_shared(tmp_path, 0, ["first"])
    assert shared == ["1-of-2"]


def test_a_part_is_made_without_the_stages_that_need_the_whole(tmp_path, shared) -> None:
    with pytest.raises(
        ConfigError, match=r"^stages: got \[first,second\], allowed: \[first\] alone to make part 0-of-2"
    ):
        run_shared(tmp_path, 0, ["first", "second"])
    assert shared == []


def test_the_whole_configuration_is_checked_before_any_work(tmp_path, calls) -> None:
    with pytest.raises(ConfigError, match=r"^second.gain: got 'x'"):
        run(tmp_path, stages=["first"], second={"gain": "x"})
    with pytest.raises(ConfigError, match=r"^secnd: .* did you mean 'second'\?"):
        run(tmp_path, secnd={"gain": 1})
    assert calls == []


@pytest.mark.parametrize(
    ("stages", "message"),
    [
        (["frist"], r"^stages: got 'frist', did you mean 'first'\? known: first, second"),
        ([], r"^stages: got \[\]"),
        ("first", r"^stages: got 'first', allowed: a list"),
    ],
)
def test_stages_that_do_not_exist_are_refused_with_those_that_do(calls, stages, message) -> None:
    with pytest.raises(ConfigError, match=message):
        pipeline.selected(TREE | {"stages": stages})


def test_every_output_has_its_provenance_and_its_marker(tmp_path, calls) -> None:
    run(tmp_path)
    provenance = artifacts.load(tmp_path / "one" / "provenance.json")
    assert provenance["config"] == {"first": {"count": 2}, "seed": 1} and provenance["seed"] == 1
    assert provenance["hardware"]["cores"] >= 1 and "numpy" in provenance["versions"]
    assert str(tmp_path) not in json.dumps(provenance)
    assert artifacts.load(tmp_path / "two" / "done.json")["inputs"].keys() == {"first"}


def test_the_data_flow_reads_only_what_stages_before_it_write() -> None:
    names = list(pipeline.STAGES)
    for name, stage in pipeline.STAGES.items():
        assert all(names.index(source) < names.index(name) for source in stage.reads)
    assert len({stage.writes for stage in pipeline.STAGES.values()}) == len(names)


@pytest.mark.parametrize(
    ("stages", "processes", "message"),
    [
        (
            ["sample"],
            {"count": 2, "coordinator": "host:1"},
            r"^stages: got \[sample\], allowed: \[policy\] alone, by several",
        ),
        (["policy"], {"count": 2}, r"^processes\.coordinator: got '', allowed: HOST:PORT, for a count of 2"),
        (["policy"], {"count": 2, "index": 2, "coordinator": "host:1"}, r"^processes\.index: got 2, allowed: 0 to 1"),
    ],
)
def test_processes_that_cannot_run_a_stage_together_are_one_line(stages, processes, message) -> None:
    with pytest.raises(ConfigError, match=message):
        pipeline.selected({"name": "x", "stages": stages, "processes": processes})


def test_a_stage_refuses_a_combination_only_where_it_is_asked_for(calls, monkeypatch) -> None:
    def check(config: SecondConfig) -> None:
        if config.second.gain == 3.0:
            raise ConfigError("second: refuses this")

    monkeypatch.setattr(SecondConfig, "check", check)
    odd = TREE | {"second": {"gain": 3.0}}
    assert pipeline.build_configs(odd, ["first"]).keys() == {"first"}
    for names in (["second"], ["first", "second"]):
        with pytest.raises(ConfigError, match=r"^second: refuses this"):
            pipeline.build_configs(odd, names)
    with pytest.raises(ConfigError, match=r"^second: refuses this"):
        pipeline.build_configs(odd)
