import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from customary import customary_ppo
from drifting_environment import DriftingEnvironment
from probe_environments import NUM_ENVS, ProbeEnvironment, a_sign

from qjrl.artifacts import ArtifactError, load
from qjrl.learning import checkpoints as ckpt
from qjrl.learning.divergence import TrainingDiverged
from qjrl.learning.ppo.environment import Env
from qjrl.learning.ppo.iteration import EXPLORES, make_plan
from qjrl.learning.ppo.mesh import device_mesh
from qjrl.learning.ppo.policy import deterministic_action, load_policy
from qjrl.learning.ppo.programs import make_programs
from qjrl.learning.ppo.train import run_iteration
from qjrl.learning.ppo.train import train as train_ppo

ITERATIONS = 5
CONFIG = customary_ppo(
    num_steps=ITERATIONS * 4 * NUM_ENVS,
    unroll_length=4,
    num_epochs=2,
    num_minibatches=2,
    actor_layers=(8,),
    critic_layers=(8,),
    checkpoint_every=2,
)
CHECKPOINTS = (0, 2, 4, 5)
TIMES = {"steps_per_second", "collecting_seconds", "learning_seconds"}


def the_closer_to_half_the_sign_the_better(seen, action):
    return seen - jnp.square(action - 0.5 * seen)


PROBE = ProbeEnvironment(a_sign, the_closer_to_half_the_sign_the_better, 3, truncates=True)
"""Episodes of three steps cut off by the time limit, so that none fits a rollout of four."""


def train(directory, env: Env = PROBE, config=CONFIG, seed=0, **options):
    return train_ppo(env, config, NUM_ENVS, seed, directory, **options)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An uninterrupted training and its directory."""
    directory = tmp_path_factory.mktemp("whole")
    return train(directory), directory


def progress_without_times(directory):
    return [{k: v for k, v in record.items() if k not in TIMES} for record in load(directory / "progress.jsonl")]


def test_one_process_trains_in_several_environments_with_the_same_plan(tmp_path):
    """The programs of a plan are shared, and compiled again for an environment of another kind."""
    config = dataclasses.replace(CONFIG, actor_layers=(9,), num_steps=4 * NUM_ENVS)  # a plan of its own
    longer = dataclasses.replace(PROBE, length=5)
    with jax.debug_key_reuse(False):  # which traces more often, and so hides what is kept from one trace to the next
        for number, env in enumerate((PROBE, longer)):
            train(tmp_path / str(number), env, config)
    assert load(tmp_path / "1" / "progress.jsonl")[-1]["iteration"] == 1


def interrupt_at(iteration):
    def callback(record):
        if record["iteration"] == iteration:
            raise KeyboardInterrupt

    return callback


def same_bits(one, other):
    return jax.tree.all(jax.tree.map(lambda a, b: np.array_equal(np.asarray(a), np.asarray(b)), one, other))


@pytest.mark.parametrize("iteration", [0, 1, 3, 4])  # on the way to a checkpoint, and in one
def test_a_resumed_training_equals_an_uninterrupted_one_bit_for_bit(whole, tmp_path, iteration):
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, callbacks=[interrupt_at(iteration)])
    policy = train(tmp_path)
    expected, directory = whole
    assert same_bits(policy, expected)
    assert same_bits(load(tmp_path / "checkpoints"), load(directory / "checkpoints"))
    assert progress_without_times(tmp_path) == progress_without_times(directory)


def test_a_training_is_not_what_another_seed_makes(whole, tmp_path):
    assert not same_bits(train(tmp_path, seed=1), whole[0])


def test_a_finished_training_is_only_read_again(whole):
    policy, directory = whole
    before = progress_without_times(directory)
    assert same_bits(train(directory, callbacks=[lambda record: pytest.fail("went on")]), policy)
    assert progress_without_times(directory) == before


@pytest.mark.parametrize(
    "change", [{"seed": 1}, {"config": dataclasses.replace(CONFIG, clipping=0.1)}, {"env": DriftingEnvironment()}]
)
def test_another_configuration_seed_or_environment_is_another_training(whole, change):
    with pytest.raises(ArtifactError, match="another configuration"):
        train(whole[1], **change)


def test_no_training_state_holds_a_float64_leaf(whole):
    training = load(whole[1] / "checkpoints")[str(ITERATIONS)]["training"]
    dtypes = {leaf.dtype for leaf in jax.tree.leaves(training)}
    assert dtypes == {np.dtype(np.float32), np.dtype(np.int32), np.dtype(np.uint32)}
    identity = load(whole[1] / "checkpoints" / "identity.json")["identity"]
    with ckpt.open_checkpoints(whole[1] / "checkpoints", identity) as checkpoints:
        envs = ckpt.restore_environment(checkpoints, ITERATIONS)
    assert {name.split("/")[0] for name in envs} == {"envs", "episodes"}
    assert {leaf.dtype for leaf in envs.values()} == {np.dtype(kind) for kind in ("f4", "i4", "u4", "?")}
    assert {len(leaf) for leaf in envs.values()} == {NUM_ENVS}


def test_the_log_tells_what_happened(whole):
    records = load(whole[1] / "progress.jsonl")
    assert [record["iteration"] for record in records] == [0, 1, 2, 3, 4, 5]
    assert [record["env_steps"] for record in records] == [n * 4 * NUM_ENVS for n in range(ITERATIONS + 1)]
    assert [record["episodes"] // NUM_ENVS for record in records[1:]] == [1, 1, 2, 1, 1]  # ends at 3, 6, 9, 12, 15, 18
    assert {record["episode_length"] for record in records[1:]} == {3.0}
    assert records[0].keys() == {"iteration", "env_steps"}
    every = {"iteration", "env_steps", "episodes", "episode_length", "return", "reward", "invalid", "invalid_fraction"}
    metrics = {"env/size", "env_end/size"}
    losses = {"policy_loss", "value_loss", "entropy", "kl", "std", "clip_fraction"}
    update = {"explained_variance", "value", "learning_rate"}
    assert records[-1].keys() == every | metrics | losses | update | TIMES


def scripted_evaluation(errors, seen):
    """Says one error after the other, and keeps the policies that it sees."""
    left = iter(errors)

    def evaluate(policy):
        seen.append(jax.tree.map(np.copy, policy))
        return {"error": next(left)}

    return evaluate


def assert_only_the_best_is_kept(directory, kept, seen, best):
    assert [same_bits(kept, policy) for policy in seen] == [number == best for number in range(len(seen))]
    assert same_bits(load_policy(directory / "policy"), seen[best])


@pytest.mark.parametrize("best", range(len(CHECKPOINTS)))
def test_the_policy_with_the_smallest_metric_is_kept_wherever_it_comes(tmp_path, best):
    errors, seen = [0.9, 0.7, 0.8, 0.6], []
    errors[best] = 0.2
    kept = train(tmp_path, evaluate=scripted_evaluation(errors, seen), minimise="error")
    assert_only_the_best_is_kept(tmp_path, kept, seen, best)
    again = train(tmp_path, evaluate=scripted_evaluation([], seen), minimise="error")
    assert_only_the_best_is_kept(tmp_path, again, seen, best)
    lines = [(record["iteration"], record.get("evaluation/error")) for record in load(tmp_path / "progress.jsonl")]
    expected: dict[int, float] = dict(zip(CHECKPOINTS, errors, strict=True))
    assert lines == [(iteration, expected.get(iteration)) for iteration in range(ITERATIONS + 1)]


@pytest.mark.parametrize("iteration", [2, 3, 4, 5])  # in the best checkpoint, and after it
def test_an_interrupted_training_keeps_the_best_of_before_and_after(tmp_path, iteration):
    errors, seen = [0.9, 0.2, 0.7, 0.5], []
    options = {"evaluate": scripted_evaluation(errors, seen), "minimise": "error"}
    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, **options, callbacks=[interrupt_at(iteration)])
    seen = seen[: sum(checkpoint < iteration for checkpoint in CHECKPOINTS)]  # the others are evaluated again
    kept = train(tmp_path, evaluate=scripted_evaluation(errors[len(seen) :], seen), minimise="error")
    assert_only_the_best_is_kept(tmp_path, kept, seen, 1)


def test_a_policy_without_a_finite_metric_is_not_the_best(tmp_path):
    seen = []
    errors = [np.nan, 0.2, None, np.inf]
    kept = train(tmp_path, evaluate=scripted_evaluation(errors, seen), minimise="error")
    assert_only_the_best_is_kept(tmp_path, kept, seen, 1)


def test_without_a_metric_to_minimise_the_latest_policy_is_kept(tmp_path):
    seen = []
    kept = train(tmp_path, evaluate=scripted_evaluation([0.9, 0.2, 0.7, 0.5], seen))
    assert_only_the_best_is_kept(tmp_path, kept, seen, 3)


def test_the_policy_evaluated_before_training_does_exactly_nothing(tmp_path):
    def evaluate(policy):
        rows = np.array([[-1], [1]], np.float32)
        assert np.array_equal(np.asarray(deterministic_action(policy, rows)), np.zeros((2, 1)))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, evaluate=evaluate, minimise="error")


def test_an_evaluation_by_the_environment_of_the_training_leaves_no_trace(whole, tmp_path):
    @jax.jit
    def rewards(policy, key):
        state = PROBE.reset(jax.random.split(key, NUM_ENVS))
        return PROBE.step(state, deterministic_action(policy, state.observation["state"])).reward

    policy = train(tmp_path, evaluate=lambda policy: {"reward": float(rewards(policy, jax.random.key(0)).mean())})
    assert same_bits(policy, whole[0])


def test_an_evaluation_computes_in_the_precision_of_the_caller(tmp_path):
    found = []

    def evaluate(policy):
        found.append(jnp.zeros(1).dtype)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(tmp_path, evaluate=evaluate)
    assert found == [jnp.float64]


RUNS_AWAY = DriftingEnvironment(limit=np.float32(0.8))
"""Some envs diverge at some steps, as their number and the action have it."""


def begun(env):
    """The plan of a training with `CONFIG`, its programs, and the untrained state."""
    plan = make_plan(env, CONFIG, NUM_ENVS, ITERATIONS, device_mesh())
    programs = make_programs(plan)
    return plan, programs, programs.begin(env, np.uint32(0))


def test_too_many_diverged_steps_stop_the_training_with_the_states_and_actions_of_exactly_those(tmp_path):
    with jax.enable_x64(False):
        _, programs, trainer = begun(RUNS_AWAY)
        _, (rollout, _) = programs.collect(RUNS_AWAY, trainer, np.float32(EXPLORES))
    rollout = jax.tree.map(np.asarray, rollout)
    places = np.argwhere(~rollout.valid)
    assert 0 < len(places) < rollout.valid.size / 2 and len(set(places[:, 0])) == CONFIG.unroll_length
    share = f"{len(places) / rollout.valid.size:.1%}"
    message = (
        rf"iteration 1: {share} of the steps .* allowed: 5.0% .*states, commands and parameters: {tmp_path}/diverged"
    )
    with pytest.raises(TrainingDiverged, match=message):
        train(tmp_path, RUNS_AWAY)
    found = load(tmp_path / "diverged.npz")
    np.testing.assert_array_equal(np.stack([found["rollout_step"], found["env"]], axis=1), places)
    np.testing.assert_array_equal(found["seen/state"], rollout.observation["state"][tuple(places.T)])
    np.testing.assert_array_equal(found["inner/value"], found["seen/state"][:, 0])
    np.testing.assert_array_equal(found["action"], rollout.action[tuple(places.T)])
    assert found["inner/key"].shape == (len(places), 2)


def test_a_diverging_training_goes_on_while_the_share_is_allowed():
    with jax.enable_x64(False):
        plan, programs, trainer = begun(RUNS_AWAY)
        allowing = dataclasses.replace(plan, config=dataclasses.replace(CONFIG, max_invalid_fraction=0.9))
        _, record = run_iteration(allowing, programs, RUNS_AWAY, trainer)
    assert 0.05 < record["invalid_fraction"] == record["invalid"] / (4 * NUM_ENVS)
    assert all(np.isfinite(record[name]) for name in ("policy_loss", "value_loss", "entropy", "kl"))


def test_rewards_that_are_not_finite_count_as_diverged(tmp_path):
    env = DriftingEnvironment(earns_up_to=np.float32(0.5))
    with pytest.raises(TrainingDiverged, match=r"iteration 1: \d\d\.\d% of the steps diverged or were not finite"):
        train(tmp_path, env)


def test_a_loss_that_is_not_finite_stops_the_training():
    with jax.enable_x64(False):
        plan, programs, trainer = begun(PROBE)
        parameters = trainer.learner.parameters
        parameters |= {"value": jax.tree.map(lambda leaf: leaf * jnp.nan, parameters["value"])}
        trainer = dataclasses.replace(trainer, learner=dataclasses.replace(trainer.learner, parameters=parameters))
        with pytest.raises(TrainingDiverged, match=r"^iteration 1: policy_loss, value_loss.* not finite"):
            run_iteration(plan, programs, PROBE, trainer)


def test_more_minibatches_than_steps_are_refused(tmp_path):
    config = dataclasses.replace(CONFIG, unroll_length=1, num_minibatches=100)
    with pytest.raises(ValueError, match="num_minibatches: got 100, allowed: at most 64"):
        train(tmp_path, config=config)
