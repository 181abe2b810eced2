"""The numbers of a PPO training."""

from typing import Annotated, Literal

from qjrl.config import Range, configuration
from qjrl.learning.ppo.dagger import DaggerConfig

Width = Annotated[int, Range(1, 8192)]


@configuration
class PPOConfig:
    """Values are the customary ones of PPO (Schulman et al. 2017 and brax) unless a field says otherwise."""

    num_steps: Annotated[int, Range(1)] = 307_200
    """Environment steps in all, over all envs; rounded up to whole iterations. Ours; paper 000, table 4, has 50 million."""
    unroll_length: Annotated[int, Range(1, 10_000)] = 20
    """Steps of every env between two updates."""
    num_epochs: Annotated[int, Range(1, 100)] = 4
    """Passes over the collected steps in one update."""
    num_minibatches: Annotated[int, Range(1, 1024)] = 8
    """Gradient steps in one pass."""
    discount: Annotated[float, Range(0, 1)] = 0.97
    """Weight of the next step's value; 0.97 looks about 33 steps ahead."""
    gae_lambda: Annotated[float, Range(0, 1)] = 0.95
    """Between one-step (0) and Monte-Carlo (1) advantages."""
    reward_scaling: Annotated[float, Range(above=0)] = 1.0
    """Factor on rewards inside the learner; the log shows unscaled rewards."""
    dagger: DaggerConfig = DaggerConfig()
    """What comes before PPO: the first iterations."""
    critic_warmup: Annotated[int, Range(0)] = 10
    """Iterations after DAgger in which the critic alone learns, so that it knows the actor before it evaluates it (ours)."""
    clipping: Annotated[float, Range(above=0, high=1)] = 0.2
    """Allowed relative change of an action's probability in one update."""
    entropy_cost: Annotated[float, Range(0)] = 0.0
    """Reward for keeping the exploration alive; 0 switches it off. Ours: exploration shall die away."""
    value_coefficient: Annotated[float, Range(0)] = 0.5
    """Weight of the critic's loss."""
    max_gradient_norm: Annotated[float, Range(above=0)] = 1.0
    """Largest global gradient norm, of the actor and of the critic each, so that neither drowns the other."""
    learning_rate: Annotated[float, Range(above=0, high=1)] = 1e-5
    """Of Adam, at the start: the actor's, and the only one that the schedule moves. Ours, as the bounds and `target_kl`: larger
    ones lose in minutes what DAgger gave."""
    critic_learning_rate: Annotated[float, Range(above=0, high=1)] = 1e-3
    """Of Adam for the critic. Ours, by itself: at the actor's rate it knew nothing, and PPO lost what DAgger had given."""
    learning_rate_schedule: Literal["constant", "linear", "adaptive_kl"] = "adaptive_kl"
    """`linear` falls to 0 at the end; `adaptive_kl` follows `target_kl`, once an update (rsl_rl's rule)."""
    target_kl: Annotated[float, Range(above=0)] = 0.002
    """Divergence between old and new policy that `adaptive_kl` aims at."""
    min_learning_rate: Annotated[float, Range(above=0, high=1)] = 1e-7
    """Where `adaptive_kl` stops slowing down (rsl_rl: 1e-5)."""
    max_learning_rate: Annotated[float, Range(above=0, high=1)] = 1e-4
    """Where `adaptive_kl` stops speeding up (rsl_rl: 1e-2)."""
    starts_at_zero: bool = True
    """The untrained policy does nothing (ours). Without, the actor's last layer is random, as is customary."""
    initial_std: Annotated[float, Range(0.002, 3)] = 0.03
    """Exploration at the start, before the tanh. Ours: a residual starts at zero, and millimetres matter. It has no effect on a random
    start, whose deviations are the random last layer's: softplus(0) + 0.001, about 0.69."""
    actor_layers: tuple[Width, ...] = (128, 128)
    """Hidden layers of the policy."""
    critic_layers: tuple[Width, ...] = (128, 128)
    """Hidden layers of the value function. Ours: they explain 0.99 of the returns' variance, as 256 did, for half the time."""
    activation: Literal["swish", "elu", "tanh", "relu"] = "swish"
    """Of both networks."""
    observation_clip: Annotated[float, Range(above=0)] = 10.0
    """Normalised observations are clipped to this many standard deviations."""
    max_invalid_fraction: Annotated[float, Range(0, 0.99)] = 0.05
    """Stop with `TrainingDiverged` when more of an iteration's steps are not finite or diverged."""
    checkpoint_every: Annotated[int, Range(1)] = 10
    """Iterations between two checkpoints (and evaluations)."""

    def __post_init__(self) -> None:
        if not self.min_learning_rate <= self.learning_rate <= self.max_learning_rate:
            bounds = f"min_learning_rate {self.min_learning_rate} to max_learning_rate {self.max_learning_rate}"
            raise ValueError(f"learning_rate: got {self.learning_rate}, allowed: from {bounds}")
