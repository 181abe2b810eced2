"""The sections of a run's report, each from the arrays and records that its stage has written."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qjrl.geometry.pose import row_errors
from qjrl.report import error_figures
from qjrl.report.compare import strand_figures
from qjrl.report.compare.training_figures import learning_curves
from qjrl.report.html import Number
from qjrl.report.metrics import by_target_set, error_table, tension_table
from qjrl.report.outcomes import Outcome, target_set_label
from qjrl.report.page import Picture, Section
from qjrl.report.rendering import image_png, render_arm
from qjrl.report.robot_drawing import draw_robot
from qjrl.robot import forward_kinematics
from qjrl.robot.kinds import kind_of
from qjrl.robot.verbs import Robot, configuration_from_cables

Arrays = Mapping[str, np.ndarray]
Metrics = Mapping[str, Any]
Records = Sequence[Mapping[str, Any]]


def results_section(outcomes: Sequence[Outcome], text: str = "", pretension: float | None = None) -> Section:
    """Every controller on every target set: tables, cumulative curves, tensions.

    Args:
        pretension: of the strands at home [N].
    """
    pictures = []
    for target_set, group in by_target_set(outcomes).items():
        label, shown = target_set_label(target_set), list(group.values())
        position = error_figures.cumulative_errors(shown, "position")
        orientation = error_figures.cumulative_errors(shown, "orientation")
        hint = "the further left a curve, the better; its dot is the median"
        pictures.append(Picture(position, f"Position error, {label}: {hint}."))
        pictures.append(Picture(orientation, f"Orientation error, {label}: the same targets."))
    first = list(next(iter(by_target_set(outcomes).values())).values())
    caption = f"What the strands carry at the end of a target, {target_set_label(first[0].target_set)}: a slack strand carries nothing."
    pictures.append(Picture(strand_figures.tension_histogram(first, pretension), caption))
    return Section("Results", text, tables=(error_table(outcomes), tension_table(outcomes)), pictures=tuple(pictures))


def arm_section(
    robot: Robot, configurations: np.ndarray, targets: np.ndarray, joint_positions: np.ndarray | None = None
) -> Section:
    """The arm at a few targets, and the first of them by MuJoCo where this machine can render.

    Args:
        configurations: (k, ...) where the robot is.
        targets: (k, 9) where it should be [m, -].
        joint_positions: (nq,) of the first one, for the rendering; None: no rendering.
    """
    caption = (
        "The arm at some of the targets; small frames are the targets (x orange, y green, z blue), squares are 100 mm."
    )
    pictures = []
    if kind_of(robot).drawing is not None:
        pictures.append(Picture(draw_robot(robot, configurations, targets), caption, is_wide=True))
    image = None if joint_positions is None else render_arm(robot, joint_positions)
    if image is not None:
        pictures.append(
            Picture(image_png(image), "The first of them in MuJoCo, with every strand that crosses a joint.")
        )
    particulars = kind_of(robot).particulars
    text = (
        f"{robot.name}, kind {robot.kind}." if particulars is None else f"{robot.name}: {particulars.summary(robot)}."
    )
    return Section("Arm", text, pictures=tuple(pictures))


def sample_section(robot: Robot, data: Arrays) -> Section:
    """The data set: how many rows, what never settled, and how far the settled tip lies from the nominal kinematics.

    Args:
        data: columns of the data set, as `artifacts.load` gives them.
    """
    settled = data["converged"]
    poses, home = data["pose"][settled], np.asarray(forward_kinematics(robot, kind_of(robot).home(robot)))
    deviation, _ = row_errors(_nominal_poses(robot, jnp.asarray(data["cable_lengths"][settled])), poses)
    tension = data["strand_tension"][settled]
    distance = 1e3 * np.linalg.norm(poses[:, :3] - home[:3], axis=1)
    numbers = (
        Number("settled rows", int(settled.sum())),
        Number("never settled", int((~settled).sum()), note="left out of training"),
        Number("tip off the nominal closed form", 1e3 * float(np.median(deviation)), "mm", "median"),
        Number("largest strand tension", float(tension.max()), "N"),
    )
    figure = error_figures.error_against(distance, {"nominal": deviation}, "distance of the tip from home [mm]")
    caption = "How far gravity, stiffness and stretch move the tip from where the closed form expects it: what there is to learn."
    return Section(
        "Sample",
        "Cable commands settled in the physics until the arm rests.",
        numbers,
        pictures=(Picture(figure, caption),),
    )


def forward_model_section(metrics: Metrics, records: Records) -> Section:
    """The learned forward model on rows it never saw.

    Args:
        metrics: `forward_model/metrics.json`.
        records: `forward_model/progress.jsonl`; none of a model that is not fitted in epochs.
    """
    held_out, nominal = metrics["held_out"], metrics["nominal"]
    numbers = (
        Number("position, median", held_out["median_mm"], "mm", f"nominal closed form: {nominal['median_mm']:.2f} mm"),
        Number("position, p99", held_out["p99_mm"], "mm", f"nominal closed form: {nominal['p99_mm']:.2f} mm"),
        Number(
            "orientation, median", held_out["median_deg"], "°", f"nominal closed form: {nominal['median_deg']:.2f}°"
        ),
        Number("rows held out", metrics["rows"]["held_out"], note=f"{metrics['rows']['fitted']:,} fitted"),
    )
    if not records:
        return Section("Forward model", f"A model of the kind “{metrics['kind']}”.", numbers)
    errors = learning_curves(
        records, {"median_mm": "median", "p90_mm": "p90", "p99_mm": "p99"}, "epoch", "epoch",
        "held-out position error [mm]", True, {"nominal closed form, median": nominal["median_mm"]},
    )  # fmt: skip
    loss = learning_curves(records, {"train_loss": "training"}, "epoch", "epoch", "training loss [normalised²]", True)
    text = f"The network in its “{metrics['form']}” form; the best checkpoint is the one after epoch {metrics['best_epoch']}."
    pictures = (
        Picture(errors, "Errors on rows that the fit never sees."),
        Picture(loss, "The loss that the fit minimises, mean of every epoch."),
    )
    return Section("Forward model", text, numbers, pictures=pictures)


def ik_section(answers: Arrays, metrics: Metrics, target_sets: Sequence[str]) -> Section:
    """What the IK believes of its answers, and what the physics makes of them.

    Args:
        answers: `ik/held_out.npz`.
        metrics: `ik/metrics.json`.
        target_sets: their names, in the order of the numbers in the answers.
    """
    pictures, numbers = [], [Number("answers", metrics["targets_per_second"], "per second")]
    for index, target_set in enumerate(target_sets):
        rows = (answers["target_set"] == index) & answers["learned_settled"]
        if not rows.any():
            continue
        predicted, real = (answers[f"{source}_position_error"][rows] for source in ("predicted", "learned"))
        label = target_set_label(target_set)
        numbers += [
            Number(f"predicted, {label}", 1e3 * float(np.median(predicted)), "mm", "median"),
            Number(f"real, {label}", 1e3 * float(np.median(real)), "mm", "median"),
        ]
        caption = f"Every answer, {label}: above the dashed line the physics errs more than the model believed."
        pictures.append(Picture(error_figures.predicted_and_real(predicted, real), caption))
    text = "Every answer was settled in the nominal physics, so that the error is real and not the model's own belief."
    return Section("Inverse kinematics", text, tuple(numbers), pictures=tuple(pictures))


def policy_section(
    records: Records,
    errors: Mapping[str, str],
    start: Mapping[str, float],
    numbers: Sequence[Number] = (),
    text: str = "",
) -> Section:
    """The residual policy's training.

    Args:
        records: `policy/progress.jsonl`.
        errors: key of a median error [mm] of the deterministic policy in the records -> its name in the legend.
        start: name -> median of the untrained policy on the same targets [mm]; of its base, where it starts as that.
    """
    steps = ("env_steps", "environment steps")
    kl, std = (learning_curves(records, {key: name}, *steps, label, False)
               for key, name, label in (("kl", "KL", "KL divergence of an update [nat]"),
                                        ("std", "std", "exploration: standard deviation of the action [–]")))  # fmt: skip
    pictures = (
        Picture(
            learning_curves(records, errors, *steps, "position error of the deterministic policy [mm]", False, start),
            "The error that counts, without exploration; dashed: before any training.",
        ),
        Picture(
            learning_curves(records, {"return": "return"}, *steps, "return of an episode [–]"),
            "What the exploring policy earns.",
        ),
        Picture(kl, "How far one update moves the policy."),
        Picture(std, "How much it explores."),
    )
    return Section("Policy", text, tuple(numbers), pictures=pictures)


def warnings_of(outcomes: Sequence[Outcome], num_rows: int = 0, num_unsettled: int = 0) -> tuple[str, ...]:
    """What a reader must know before believing the numbers: rows that never settled, targets left out, slack strands.

    Args:
        num_rows: of the data set, with those that never settled.
    """
    lines = []
    if num_unsettled:
        share = f"{num_unsettled:,} of {num_rows:,} sampled commands ({100 * num_unsettled / num_rows:.2g} %)"
        lines.append(f"{share} never settled and were left out of training.")
    for target_set, group in by_target_set(outcomes).items():
        worst = max(group.values(), key=lambda outcome: outcome.num_left_out)
        if worst.num_left_out:
            total = len(worst.position_error) + worst.num_left_out
            lines.append(
                f"{target_set_label(target_set)}: up to {worst.num_left_out} of {total} targets were left out."
            )
        slack = max(float(outcome.is_slack.mean()) for outcome in group.values())
        if slack > 0.0:
            lines.append(f"{target_set_label(target_set)}: up to {100 * slack:.2g} % of the strands are slack.")
    return tuple(line[0].upper() + line[1:] for line in lines)


@jax.jit
def _nominal_poses(robot: Robot, lengths: jax.Array) -> jax.Array:
    """Poses (n, 9) of the nominal closed form at cable lengths (n, cables) [m]."""
    return jax.vmap(lambda row: forward_kinematics(robot, configuration_from_cables(robot, row)))(lengths)
