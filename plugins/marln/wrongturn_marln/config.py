"""Settings of MaRLn (Toromanoff et al., CVPR 2020): each field explained, as those of the other algorithms."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Final

from wrongturn_agents.training.drives_config import PlacesConfig, PretrainedConfig
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.settings import PIXELS, SHARE
from wrongturn_marln.network import FRAMES

_FEATURES: Final = 2 * 6144
"""Bytes of a decision's encoded pictures."""


@dataclass(frozen=True, kw_only=True)
class MarlnConfig(PretrainedConfig, PlacesConfig):
    """``marln``: ResNet-18 on four pictures, pretrained on affordances and frozen; Rainbow-IQN trains what follows."""

    algorithm: ClassVar[str] = "marln"
    track: ClassVar[str] = "camera"
    keys: ClassVar[tuple[str, ...]] = ("speed", "steering", "command", "rgb")
    RANGES: ClassVar = {
        **PretrainedConfig.RANGES,
        **PlacesConfig.RANGES,
        **dict.fromkeys(("priority_exponent", "priority_weight"), SHARE),
    }
    POSITIVE: ClassVar[tuple[str, ...]] = (*PretrainedConfig.POSITIVE, "replay_ratio", "kappa")

    steps: int = 6_000_000
    """Environment steps of the whole run. The learning rate falls over them."""
    reward_divisor: float = 100.0
    """Divisor of the reward. A decision then earns at most 0.47, and the quantile loss sees errors of about 1."""
    collision_penalty: float = 6.0
    """Taken off the divided reward when a drive ends in a collision, beside ``failure_penalty``."""
    standing_penalty: float = 3.0
    """Taken off the divided reward when a drive ends because the car stands still."""
    standing_cost: float = 0.15
    """Taken off the divided reward of each decision after which the car stands, unless others block its way."""

    batch_size: int = 512
    """Decisions in a minibatch."""
    replay_ratio: float = 8.0
    """Decisions learned from for each decision driven."""
    replay_size: int = 1_000_000
    """Decisions that the replay memory holds, each with its features: 12 kB."""
    learn_after: int = 50_000
    """Decisions driven before anything is learned."""
    priority_exponent: float = 0.2
    """How much likelier decisions with a great loss are replayed; 0 replays all alike. Rainbow-IQN's value."""
    priority_weight: float = 0.4
    """How much the loss corrects for that at the start. It rises to 1 at the end."""
    n_step: int = 6
    """Rewards of a return before the value of what follows."""
    gamma: float = 0.97
    """Discount. At ten decisions a second, 0.97 looks about three seconds ahead."""
    quantiles: int = 8
    """Quantiles that are learned of each decision in a minibatch; N of the paper on IQN."""
    target_quantiles: int = 8
    """Quantiles of the value of what follows; N' of that paper."""
    kappa: float = 1.0
    """Errors of a quantile up to this count by their square."""
    noise: float = 0.1
    """First deviation of the noisy layers, times the square root of their width. It alone explores."""
    noise_decisions: int = 8
    """Decisions that a car drives with the same noise, and with its pictures changed alike. New noise each decision
    would cancel out."""
    hidden: int = 256
    """Units of each stream's hidden layer."""
    target_every: int = 100
    """Updates between two copies of the network to the target network."""
    learning_rate: float = 3e-4
    """Adam's learning rate at the start. It falls linearly to this times ``final_learning_rate``."""
    final_learning_rate: float = 0.1
    """Share of the learning rate that is left at the end."""
    projection_learning_rate: float = 0.3
    """Share of the learning rate for the layer from 6,144 to 512 numbers behind the ResNet."""
    adam_epsilon: float = 1e-5
    """Adam's epsilon."""
    max_grad_norm: float = 10.0
    """Greatest norm of the gradient. A longer gradient is shortened."""

    pretraining_frames: int = 400_000
    """Stacks of pictures for the encoder's pretraining."""
    pretraining_passes: float = 2.0
    """Number of times that each stack is used, on average."""

    def __post_init__(self) -> None:
        super().__post_init__()
        least = self.num_envs * (self.n_step + 1)
        if self.replay_size < least:
            raise TrainingError(
                f"option replay_size: is {self.replay_size}, so that no return of {self.n_step} steps fits for "
                f"{self.num_envs} cars; give {least} or more"
            )
        if self.learn_after < least:
            raise TrainingError(
                f"option learn_after: is {self.learn_after}, before the first returns are there; give {least} or more"
            )

    def memory(self) -> Iterable[tuple[str, int, str]]:
        """Return the bytes of the replay memory, and of the cars' pictures beside it."""
        replay = self.replay_size * _FEATURES
        return [
            ("replay_size", replay, "decisions"),
            ("num_envs", replay + self.num_envs * FRAMES * 4 * PIXELS, "egos beside the replay memory"),
        ]
