import jax.numpy as jnp
import numpy as np
import pytest

from qjrl.report.compare import sections
from qjrl.report.outcomes import Outcome
from qjrl.report.page import Report, report_page
from qjrl.robot import cable_lengths, forward_kinematics, load_robot

TARGET_SETS = ("uniform", "near_home")


@pytest.fixture(scope="module")
def arm():
    return load_robot("qj_22")


def outcomes(num_left_out: int = 0) -> list[Outcome]:
    errors, tension = np.linspace(1e-3, 2e-3, 20), np.full((20, 8), 15.0)
    return [
        Outcome(name, target_set, errors, errors, tension, tension < 0.01, num_left_out)
        for target_set in TARGET_SETS
        for name in ("nominal", "learned_ik")
    ]


def test_sample_section_measures_the_distance_from_the_closed_form(arm):
    bends = np.full((10, 2, 2), 0.1)
    pose = np.tile(np.asarray(forward_kinematics(arm, bends[0])), (10, 1))
    pose[:, 0] += 0.005
    data = {
        "bends": bends,
        "pose": pose,
        "cable_lengths": np.tile(np.asarray(cable_lengths(arm, bends[0])), (10, 1)),
        "strand_tension": np.full((10, 8), 12.0),
        "converged": np.arange(10) > 0,
    }
    section = sections.sample_section(arm, data)
    values = [number.value for number in section.numbers]
    assert values == pytest.approx([9, 1, 5.0, 12.0])


def test_forward_model_section_sets_the_closed_form_beside_the_model():
    errors = {"median_mm": 0.7, "p99_mm": 3.0, "median_deg": 0.2}
    metrics = {
        "form": "corrected", "best_epoch": 5, "held_out": errors, "nominal": {**errors, "median_mm": 6.9},
        "rows": {"fitted": 90, "held_out": 10, "unsettled": 0},
    }  # fmt: skip
    records = [{"epoch": epoch, "train_loss": 1.0, "median_mm": 1.0, "p90_mm": 2.0, "p99_mm": 3.0} for epoch in (0, 5)]
    section = sections.forward_model_section(metrics, records)
    assert section.numbers[0].value == 0.7
    assert "6.90 mm" in section.numbers[0].note
    assert len(section.pictures) == 2


def test_forward_model_section_of_a_model_without_epochs_draws_no_curves():
    errors = {"median_mm": 0.7, "p99_mm": 3.0, "median_deg": 0.2}
    metrics = {"kind": "ridge", "held_out": errors, "nominal": errors, "rows": {"fitted": 90, "held_out": 10}}
    section = sections.forward_model_section(metrics, [])
    assert "ridge" in section.text and not section.pictures and section.numbers[0].value == 0.7


def test_ik_section_compares_belief_and_physics():
    answers = {
        "target_set": np.repeat([0, 1], 8),
        "learned_settled": np.repeat([True, False], 8),
        "predicted_position_error": np.full(16, 1e-4),
        "learned_position_error": np.full(16, 2e-3),
    }
    section = sections.ik_section(answers, {"targets_per_second": 5.0}, TARGET_SETS)
    assert [number.value for number in section.numbers] == pytest.approx([5.0, 0.1, 2.0])
    assert len(section.pictures) == 1  # of the other set nothing settled


def test_policy_section_survives_a_training_of_no_steps():
    section = sections.policy_section([{"iteration": 0, "env_steps": 0}], {"evaluation/error": "error"}, {"base": 2.0})
    assert "Policy" in report_page(Report("run", "Verdict", sections=(section,)))


def test_results_section_shows_both_errors_of_both_sets():
    section = sections.results_section(outcomes(), pretension=15.0)
    assert len(section.tables) == 2
    assert len(section.pictures) == 5


def test_arm_section_draws(arm):
    section = sections.arm_section(
        arm, np.zeros((1, 2, 2)), np.asarray(forward_kinematics(arm, jnp.zeros((2, 2))))[None]
    )
    assert section.text.startswith("qj_22: 2 segments of 2, 2 rolling quaternion joints, 4 cables")
    assert len(section.pictures) == 1


def test_warnings_name_what_was_left_out():
    assert sections.warnings_of(outcomes()) == ()
    lines = sections.warnings_of(outcomes(2), 1000, 10)
    assert lines[0].startswith("10 of 1,000 sampled commands (1 %) never settled")
    assert lines[1:] == tuple(
        f"{name}: up to 2 of 22 targets were left out." for name in ("Uniform bends", "Near home")
    )
