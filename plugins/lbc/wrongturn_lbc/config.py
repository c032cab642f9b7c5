"""Settings of the training of ``lbc``."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Final

from wrongturn_agents.training.drives_config import PlacesConfig
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.settings import PIXELS, SHARE, without

PRIVILEGED: Final = "lbc-privileged"
"""The agent from which ``lbc`` learns."""
_LEAST_WIDTH: Final = 8


@dataclass(frozen=True, kw_only=True)
class LBCConfig(PlacesConfig):
    """Settings of a training; the defaults are those of the shipped agents."""

    algorithm: ClassVar[str] = "lbc"
    track: ClassVar[str] = "camera"
    RANGES: ClassVar = {
        **PlacesConfig.RANGES,
        **dict.fromkeys(("noisy", "offline", "guided", "average", "privileged_share"), SHARE),
        "rounds": (0, 1e12),
    }
    POSITIVE: ClassVar[tuple[str, ...]] = (*PlacesConfig.POSITIVE, "uses")

    privileged_samples: int = 4_000_000
    """Samples from which the privileged agent learns."""
    samples: int = 12_000_000
    """Samples from which the agent with a camera learns. The learning rate falls over them."""
    privileged_share: float = 0.2
    """Share of the minutes for the privileged agent, if minutes are given, of those left when it begins to learn."""
    batch_size: int = 512
    """Samples in a minibatch."""
    learning_rate: float = 1e-3
    """AdamW's greatest learning rate."""
    warm_up: int = 200
    """Updates over which the learning rate rises."""
    weight_decay: float = 1e-4
    """AdamW's weight decay."""
    average: float = 0.998
    """Weight of the past in the average of the weights, which drives and is kept."""
    width: int = 64
    """Channels after the first stage of both ResNets. 64 is the ResNets' own."""
    augment: bool = True
    """Change RGB pictures at random."""
    num_envs: int = 256
    """Cars that drive side by side."""
    buffer: int = 262_144
    """Newest samples that are kept."""
    begin: int = 16_384
    """Samples that are collected before learning begins."""
    uses: float = 8.0
    """Times that a sample is learned from, on average."""
    shifts: int = 2
    """Samples of the privileged agent's that are made of each observation by moving and turning the car."""
    shift: float = 0.5
    """Standard deviation of the move to the side, metres."""
    turn: float = 0.1
    """Standard deviation of the turn, radians."""

    rounds: int = 40
    """DAgger's rounds after the first samples: in each, cars drive with the agent as it then is. *Ablation:* with 0,
    the privileged agent drives all cars."""
    offline: float = 0.25
    """Share of the samples before the first round. The privileged agent drives for them."""
    guided: float = 0.2
    """Share of the cars that the privileged agent drives in DAgger's rounds."""
    white_box: bool = True
    """Learn the privileged agent's waypoints for all commands. *Ablation:* without it, learn the expert's for the
    command that is given."""
    noisy: float = 0.5
    """Share of the cars whose steering is disturbed while the expert or the privileged agent drives."""
    noise: float = 0.15
    """Standard deviation of the disturbance."""
    teacher: str = ""
    """Path of a privileged agent's checkpoint to learn from. The agent with a camera then gets all samples and minutes.
    """

    inside_junctions: float = 0.1
    """Share of the drives that start inside a junction, on the route's path."""
    traffic: float = 0.5
    """Share of the drives beside other cars and pedestrians."""
    crossers: float = 0.0
    """Share of the junctions at which the car has to give way and another one then crosses its way."""
    waiters: float = 0.0
    """Share of the junctions at which a car stands at a stop line."""
    stay: int = 240
    """Decisions after which each group moves on to its next town; few, because a sample is learned from many times."""
    evaluations: int = 5
    """Evaluations on held-out journeys in the course of a run, the last one at its end."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.privileged_share < 1.0:
            raise TrainingError(f"option privileged_share: is {self.privileged_share}; give a number between 0 and 1")
        if self.begin > self.buffer:
            raise TrainingError(f"option begin: is {self.begin}, more than the buffer's {self.buffer}; give less")
        if self.width < _LEAST_WIDTH:
            raise TrainingError(
                f"option width: is {self.width}; give {_LEAST_WIDTH} or more: torch's convolutions crash on a CPU with "
                "fewer channels"
            )
        if self.batch_size == 1:
            raise TrainingError("option batch_size: is 1, which has no deviation; give 2 or more")

    @property
    def length(self) -> int:
        """Samples of the agent with a camera."""
        return self.samples

    @property
    def variant(self) -> str | None:
        """``without-white-box``, ``without-dagger``, both or None."""
        return without(white_box=self.white_box, dagger=self.rounds > 0)

    def memory(self) -> Iterable[tuple[str, int, str]]:
        """Return the bytes of the kept samples' pictures."""
        return [("buffer", self.buffer * 3 * PIXELS, "samples")]
