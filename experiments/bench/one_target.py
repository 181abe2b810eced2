"""Inverse kinematics one target at a time and in batches, ours and PyRoki's, on an arm that a URDF states exactly.

    python experiments/bench/one_target.py [outputs/default/forward_model]

Both solve the same targets of `qj_2222_spherical`; PyRoki (extra `bench`) on the URDF that our own code writes, as its own
example does, from home or from the measured joints. Solved: to 0.01 mm and 0.01° by our kinematics,
evaluated again at the answers. PyRoki's limits are a box about our discs, and soft. The learned model of the last walk is that of
`inverse_kinematics.py`.
"""

import math
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from inverse_kinematics import ORIENTATION_TOLERANCE, POSITION_TOLERANCE, seconds_of, the_model, timed

from qjrl.geometry.pose import row_errors
from qjrl.learning.fitting import predict
from qjrl.provenance import provenance
from qjrl.robot import bends_from_angles, bends_from_cables, cable_lengths, forward_kinematics, load_robot
from qjrl.robot.forward_model import make_network, model_inputs, pose_function
from qjrl.robot.kinds import kind_of
from qjrl.robot.quaternion_arm.coordinates import bends_from_half_angles, half_angles
from qjrl.robot.quaternion_arm.urdf import build_urdf
from qjrl.solvers import FollowConfig, LeastSquaresConfig, PoseFollower, draw_candidates, solve_least_squares

BATCHES, NUM_SINGLE, NUM_STEPS = (100, 500, 4096), 100, 5000
LARGEST_FOR_RIVALS = 500
# Of the walk: share of the speed that a period keeps, speed of a coordinate [rad a period of 20 ms], noise of a joint [rad].
KEPT, SPEED, NOISE = 0.98, 0.004, math.radians(0.25)
CONFIG = LeastSquaresConfig(least_tension=0.0)


def random_bends(robot, count: int, largest_deg: float) -> np.ndarray:
    """Bends (count, segments, 2): directions uniform, angles uniform."""
    random = np.random.default_rng(1)
    directions, angles = (random.uniform(0.0, high, (count, robot.num_segments)) for high in (2 * np.pi, largest_deg))
    return np.asarray(bends_from_angles(jnp.asarray(directions), jnp.radians(jnp.asarray(angles))))


def walk(robot, largest_deg: float) -> np.ndarray:
    """Bends (steps, segments, 2) of a smooth random walk in the bend vectors, turned back at `largest_deg`."""
    random, largest = np.random.default_rng(0), np.radians(largest_deg)
    vectors = np.full((NUM_STEPS, robot.num_segments, 2), 0.1)
    speed = np.zeros(vectors.shape[1:])
    for step in range(1, NUM_STEPS):
        speed = KEPT * speed + SPEED * math.sqrt(1.0 - KEPT**2) * random.normal(size=speed.shape)
        moved = vectors[step - 1] + speed
        size = np.linalg.norm(moved, axis=1, keepdims=True)
        vectors[step] = moved * np.minimum(1.0, largest / size)
        speed = np.where(size > largest, -speed, speed)
    return bends_of(robot, vectors)


def bends_of(robot, vectors: np.ndarray) -> np.ndarray:
    """Of many bend vectors (n, segments, 2) [rad]."""
    rows = jax.vmap(partial(kind_of(robot).configuration_of, robot))(jnp.asarray(vectors.reshape(len(vectors), -1)))
    return np.asarray(rows)


def vectors_of(robot, bends: np.ndarray) -> np.ndarray:
    """Inverse of `bends_of`, on the host and quick: of one configuration or many."""
    size = np.maximum(np.linalg.norm(bends, axis=-1, keepdims=True), 1e-12)
    return 2.0 * np.arcsin(np.minimum(size, 1.0)) * bends / size


def poses_of(robot, bends) -> np.ndarray:
    """Poses (n, 9) of the closed form."""
    return np.asarray(jax.jit(jax.vmap(partial(forward_kinematics, robot)))(jnp.asarray(bends)))


def solved(robot, bends, poses, targets) -> str:
    """Share of the targets that are met, and that are met with a bend beyond the limit by more than 0.1 %."""
    position, orientation = row_errors(poses, targets)
    is_met = (position <= POSITION_TOLERANCE) & (orientation <= ORIENTATION_TOLERANCE)
    is_beyond = np.linalg.norm(bends, axis=-1).max(axis=-1) > 1.001 * np.sin(float(robot.bend_limit) / 2.0)
    return f"{100.0 * is_met.mean():6.2f} % solved, {100.0 * (is_met & is_beyond).mean():.2f} % beyond the limits"


class PyRoki:
    """Its example's costs and solver on our URDF, in single precision: its dense solver takes no other.

    Raises:
        ImportError: it is not installed.
    """

    def __init__(self, robot):
        import jaxlie  # pyright: ignore[reportMissingImports]
        import jaxls  # pyright: ignore[reportMissingImports]
        import pyroki  # pyright: ignore[reportMissingImports]
        import yourdfpy  # pyright: ignore[reportMissingImports]
        from loguru import logger  # pyright: ignore[reportMissingImports]

        logger.disable("jaxls")
        with tempfile.TemporaryDirectory() as folder, jax.enable_x64(False):
            path = Path(folder) / "arm.urdf"
            path.write_text(build_urdf(robot))
            arm = pyroki.Robot.from_urdf(yourdfpy.URDF.load(str(path), load_meshes=False))
            tip = jnp.array(arm.links.names.index("tip"), jnp.int32)

        def solve(target: jax.Array, bends: jax.Array) -> jax.Array:
            joints = arm.joint_var_cls(0)
            x, y = target[3:6], target[6:9]
            rotation = jaxlie.SO3.from_matrix(jnp.stack([x, y, jnp.cross(x, y)], axis=1))
            pose = jaxlie.SE3.from_rotation_and_translation(rotation, target[:3])
            weights = {"pos_weight": 50.0, "ori_weight": 10.0}
            costs = [
                pyroki.costs.pose_cost_analytic_jac(arm, joints, pose, tip, **weights),
                pyroki.costs.limit_cost(arm, joints, weight=100.0),
            ]
            start = jaxls.VarValues.make([joints.with_value(jax.vmap(half_angles)(bends).reshape(-1))])
            problem = jaxls.LeastSquaresProblem(costs, [joints]).analyze()
            trust = jaxls.TrustRegionConfig(lambda_initial=1.0)
            found = problem.solve(start, verbose=False, linear_solver="dense_cholesky", trust_region=trust)
            return bends_from_half_angles(found[joints].reshape(-1, 2))

        self._one, self._many = jax.jit(solve), jax.jit(jax.vmap(solve))

    def solve(self, target: np.ndarray, bends: np.ndarray) -> jax.Array:
        """Bends (segments, 2) for a target (9,) from bends."""
        with jax.enable_x64(False):
            return self._one(target.astype(np.float32), bends.astype(np.float32))

    def solve_many(self, targets: np.ndarray, bends: np.ndarray) -> jax.Array:
        """The same for rows."""
        with jax.enable_x64(False):
            return self._many(targets.astype(np.float32), bends.astype(np.float32))


def latency(seconds: list[float]) -> str:
    """Median and 99th percentile."""
    return f"median {1e3 * np.median(seconds):7.3f} ms, p99 {1e3 * np.quantile(seconds, 0.99):7.3f} ms"


def bench_batches(robot, rival: PyRoki | None, largest_deg: float) -> None:
    """From home, nothing known of the answers; a follower for it has 40 steps and no bound, and takes one target."""
    bends = random_bends(robot, max(BATCHES), largest_deg)
    targets, starts = poses_of(robot, bends), np.zeros(bends.shape)
    candidates = draw_candidates(robot, CONFIG)
    ours = lambda rows: solve_least_squares(robot, rows, None, CONFIG, candidates).bends  # noqa: E731
    patient = PoseFollower(robot, config=FollowConfig(iterations=40, largest_move=20.0, posture=0.0))
    alone = lambda rows: patient.solve(rows[0], starts[0]).configuration[None]  # noqa: E731
    ways: dict[str, Callable] = {"ours": ours, "follower": alone}
    if rival is not None:
        ways["PyRoki"] = lambda rows: rival.solve_many(rows, starts[: len(rows)])
    print(f"targets of bends to ±{largest_deg:g}°, from home")
    for name, solve in ways.items():
        jax.block_until_ready(solve(targets[:1]))
        seconds = [timed(lambda: solve(targets[row : row + 1])) for row in range(NUM_SINGLE)]  # noqa: B023
        found = np.concatenate([np.asarray(solve(targets[row : row + 1])) for row in range(NUM_SINGLE)])
        share = solved(robot, found, poses_of(robot, found), targets[:NUM_SINGLE])
        print(f"  {name:8} {1:5} at once: {latency(seconds)}, {share}")
        for count in BATCHES:
            if name == "follower" or (name == "PyRoki" and count > LARGEST_FOR_RIVALS):
                continue
            each = 1e3 * seconds_of(lambda: solve(targets[:count])) / count  # noqa: B023
            found = np.asarray(solve(targets[:count]))
            share = solved(robot, found, poses_of(robot, found), targets[:count])
            print(f"  {name:8} {count:5} at once: {each:7.4f} ms a target, {share}")


def bench_walk(name: str, robot, bends: np.ndarray, targets: np.ndarray, solve, pose_of, joints_of) -> None:
    """A target every 20 ms, each call begun at the joints as encoders measure them.

    Args:
        solve: target, bends -> bends that are commanded.
        pose_of: of many commanded bends, what is reached.
        joints_of: commanded bends -> where the joints come to rest.
    """
    random, measured = np.random.default_rng(2), bends[0]
    seconds, busy, answers, moves = [], [], [], []
    jax.block_until_ready(solve(targets[0], measured))
    for target in targets:
        noise = NOISE / math.sqrt(2.0) * random.normal(size=measured.shape)  # a segment has two joints
        start = np.asarray(bends_of_one(vectors_of(robot, measured) + noise))
        before = answers[-1] if answers else None
        began, used = time.perf_counter(), time.process_time()
        answers.append(np.asarray(solve(target, start)))
        busy.append(time.process_time() - used)
        seconds.append(time.perf_counter() - began)
        if before is not None:
            moves.append(np.linalg.norm(vectors_of(robot, answers[-1]) - vectors_of(robot, before)))
        measured = joints_of(answers[-1])
    share = solved(robot, np.stack(answers), pose_of(np.stack(answers)), targets)
    walked = np.linalg.norm(np.diff(vectors_of(robot, bends), axis=0).reshape(NUM_STEPS - 1, -1), axis=1).max()
    print(
        f"  {name:22} {latency(seconds)}; CPU time {latency(busy)}; {share}; "
        f"largest step {max(moves):.3f} rad, its p99 {np.quantile(moves, 0.99):.3f} (the walk's largest {walked:.3f})"
    )


def bends_of_one(vectors: np.ndarray) -> np.ndarray:
    """Bends of bend vectors, on the host."""
    size = np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return np.sin(size / 2.0) * vectors / size


def bench_walks(robot, rival: PyRoki | None, largest_deg: float) -> None:
    """The closed form."""
    bends = walk(robot, largest_deg)
    targets, poses = poses_of(robot, bends), partial(poses_of, robot)
    print(f"walk of {NUM_STEPS} poses at 50 Hz, bends to ±{largest_deg:g}°, {robot.name}")
    follower, itself = PoseFollower(robot), lambda bends: bends
    ours = lambda target, start: follower.solve(target, start).configuration  # noqa: E731
    bench_walk("ours, closed form", robot, bends, targets, ours, poses, itself)
    if rival is not None:
        bench_walk("PyRoki", robot, bends, targets, rival.solve, poses, itself)


def bench_model_walk(robot, fitted, largest_deg: float) -> None:
    """A learned model; the joints rest where it says."""
    model, form, network = pose_function(robot, fitted), fitted.config.form, make_network(robot, fitted.config)
    lengths_of = partial(cable_lengths, robot)

    def joints(bends: jax.Array) -> jax.Array:
        lengths = lengths_of(bends)
        answer = predict(network, fitted.fitted, model_inputs(robot, form, lengths))
        return bends_from_cables(robot, lengths) + answer.reshape(bends.shape)

    joints_of, poses = jax.jit(joints), jax.jit(jax.vmap(lambda bends: model(lengths_of(bends))))
    bends = walk(robot, largest_deg)
    follower = PoseFollower(robot, model)
    solve = lambda target, start: follower.solve(target, start).configuration  # noqa: E731
    print(f"walk of {NUM_STEPS} poses at 50 Hz, bends to ±{largest_deg:g}°, {robot.name}")
    rests = lambda bends: np.asarray(joints_of(bends))  # noqa: E731
    bench_walk("ours, learned model", robot, bends, np.asarray(poses(bends)), solve, poses, rests)


def main() -> None:
    """Print the machine, then everything."""
    jax.config.update("jax_enable_x64", True)
    machine = provenance({}, None, None)["hardware"]
    print(f"{machine['cpu']}, {machine['cores']} cores; jax {jax.__version__}")
    robot, rival = load_robot("qj_2222_spherical"), None
    try:
        rival = PyRoki(robot)
    except ImportError:
        print("PyRoki is not installed: pip install 'qjrl[bench]' to compare with it; skipped")
    for largest_deg in (30.0, 70.0):
        bench_walks(robot, rival, largest_deg)
    learned = load_robot("qj_2222")
    fitted = the_model(learned)
    for largest_deg in (30.0, 70.0):
        bench_model_walk(learned, fitted, largest_deg)
    for largest_deg in (30.0, 70.0):
        bench_batches(robot, rival, largest_deg)


if __name__ == "__main__":
    main()
