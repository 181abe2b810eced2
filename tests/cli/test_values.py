"""Values of the command mean what they mean in a YAML file, or are refused in one line."""

from pathlib import Path

import pytest
from command import Command, assert_one_line
from hypothesis import given
from hypothesis import strategies as st

from qjrl import plain_yaml
from qjrl.cli.arguments import TEXTS, for_hydra
from qjrl.cli.values import checked
from qjrl.config import ConfigError

NUMBERS = st.from_regex(r"[-+]?[0-9_]{1,6}(\.[0-9_]{0,4})?(e[-+]?[0-9]{1,2})?", fullmatch=True)


@given(NUMBERS)
def test_what_hydra_reads_as_a_number_is_the_number_of_yaml(text) -> None:
    from hydra.core.override_parser.overrides_parser import OverridesParser

    in_yaml = plain_yaml.load(text)
    try:
        (override,) = checked([f"key={text}"], False, TEXTS)
    except ConfigError:
        assert "_" in text
        return
    on_the_command = OverridesParser.create().parse_override(for_hydra(override)).value()
    if isinstance(in_yaml, int | float) or isinstance(on_the_command, int | float):
        assert on_the_command == in_yaml and type(on_the_command) is type(in_yaml)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["seed=1", "seed=2"], "seed: got both 1 and 2"),
        (["robot.link_length=0.03", "++robot.link_length=0.04"], "robot.link_length: got both 0.03 and 0.04"),
        (["seed==1"], "seed==1: got '=' twice, allowed: seed=1"),
        (["seed=1_000"], "seed: got 1_000, allowed: digits without '_', as in 1000"),
        (["stages=[first]", "robot.joints_per_segment=[2,1_0]"], "got 1_0"),
        (["robot.link_length=0,03"], "0.03, without a decimal comma"),
        (["robot.link_length=0,5"], "a decimal comma? write 0.5"),
        (["-m"], "-m: got no value to sweep over"),
        (["--multirun", "seed=1", "stages=[first]"], "-m: got no value to sweep over"),
        ([f"name={'a' * 300}"], "below 240 bytes"),
    ],
    ids=str,
)
def test_a_value_that_can_be_meant_in_two_ways_is_refused_before_any_work(qjrl: Command, arguments, words) -> None:
    assert_one_line(qjrl(*arguments), words)
    assert not Path("outputs").exists()


def test_padded_numbers_are_decimal_and_the_record_holds_what_was_typed(qjrl: Command) -> None:
    from qjrl import artifacts

    assert qjrl("seed=007", "stages=[first]").code == 0
    assert artifacts.load("outputs/default/dataset/provenance.json")["config"]["seed"] == 7
    assert "seed=007" in artifacts.load("outputs/default/summary.json")["overrides"]


def test_the_same_value_twice_and_texts_are_let_be() -> None:
    same = ["seed=1", "seed=1", "name=1_000", "track.path=a/007/b_1.csv", "x='007'", "x='007'"]
    assert checked(same, False, TEXTS) == same
    assert checked(["seed=1", "hydra/launcher=submitit_slurm"], True, TEXTS)
    assert checked(["seed=range(1,4)"], True, TEXTS) == ["seed=range(1,4)"]
