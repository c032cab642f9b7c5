"""Settings of the training of ``lbc``."""

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from wrongturn_agents.training.drives_config import MOST_ROAD_USERS, ROAD_USERS, check_starts
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.options import with_options

ALGORITHM: Final = "lbc"
"""The agent with a camera."""
PRIVILEGED: Final = "lbc-privileged"
"""The agent from which it learns."""
_SHARES: Final = (
    *("near_junctions", "near_bends", "inside_junctions", "traffic", "hesitant", "leaders", "noisy", "offline"),
    *("guided", "average"),
)
_MOST: Final = 1e12


@dataclass(frozen=True, kw_only=True)
class LBCConfig:
    """Settings of a training; the defaults are those of the shipped agents."""

    privileged_samples: int = 4_000_000
    """Samples from which the privileged agent learns."""
    samples: int = 12_000_000
    """Samples from which the agent with a camera learns. The learning rate falls over them."""
    privileged_share: float = 0.2
    """Share of the minutes for the privileged agent, if minutes are given."""
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
    bf16: bool = True
    """Compute encoders in bfloat16 on CUDA."""

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

    near_junctions: float = 0.3
    """Share of the drives that start shortly before a junction."""
    near_bends: float = 0.2
    """Share of the drives that start shortly before a bend."""
    inside_junctions: float = 0.1
    """Share of the drives that start inside a junction, on the route's path."""
    traffic: float = 0.5
    """Share of the drives beside other cars and pedestrians."""
    vehicles: int = 60
    """Most other cars of such a drive, in the whole town."""
    pedestrians: int = 50
    """Most pedestrians of such a drive."""
    hesitant: float = 0.3
    """Share of the other cars that drive slowly and stop now and then without need."""
    leaders: float = 0.5
    """Share of the drives with traffic that start shortly behind another car."""
    lateral: float = 0.4
    """Standard deviation of the start's offset from the lane's centre, metres."""
    yaw: float = 0.06
    """Standard deviation of the start's heading, radians."""
    window_nearest: float = 10.0
    """Least distance before the stop line at which the command's window opens, metres."""
    window_farthest: float = 20.0
    """Greatest distance at which it opens, metres."""
    time_limit: float = 60.0
    """Time limit of a drive, seconds."""

    evaluations: int = 5
    """Evaluations on held-out journeys in the course of a run, the last one at its end."""
    journeys: int = 50
    """Held-out journeys of the last evaluation."""
    brief_journeys: int = 20
    """Held-out journeys of the earlier evaluations: the shortest ones."""
    patience: float = 30.0
    """An evaluation gives a journey up after its car stood still for this long, seconds."""

    save_every: float = 10.0
    """Minutes between two saves of ``best.pt`` and ``state.pt``. Each evaluation saves them as well."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool):
                continue
            least = 1 if field.type == "int" or field.type is int else 1e-9
            free = (*_SHARES, *ROAD_USERS, "rounds", "noise", "shift", "turn", "lateral", "yaw", "weight_decay")
            if field.name in free:
                least = 0
            if not least <= value <= _MOST:
                raise TrainingError(f"option {field.name}: is {value}; give a number from {least:g} to {_MOST:g}")
            if field.name in ROAD_USERS and value > MOST_ROAD_USERS:
                raise TrainingError(f"option {field.name}: is {value}; give at most {MOST_ROAD_USERS}")
            if field.name in _SHARES and value > 1.0:
                raise TrainingError(f"option {field.name}: is {value}; give a number from 0 to 1")
        check_starts(
            (self.near_junctions, self.near_bends, self.inside_junctions), (self.window_nearest, self.window_farthest)
        )
        if not 0.0 < self.privileged_share < 1.0:
            raise TrainingError(f"option privileged_share: is {self.privileged_share}; give a number between 0 and 1")
        if self.begin > self.buffer:
            raise TrainingError(f"option begin: is {self.begin}, more than the buffer's {self.buffer}; give less")
        if self.batch_size == 1:
            raise TrainingError("option batch_size: is 1, which has no deviation; give 2 or more")

    @property
    def variant(self) -> str | None:
        """Name of the ablation for tables; None for the unchanged algorithm."""
        missing = [name for name, there in (("white-box", self.white_box), ("dagger", self.rounds > 0)) if not there]
        return f"without-{'-and-'.join(missing)}" if missing else None

    def with_options(self, options: Iterable[str]) -> "LBCConfig":
        """Return these settings with the fields of ``name=value`` options changed.

        Raises:
            TrainingError: an option has an unknown name or a wrong value.
        """
        return with_options(self, options)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name, ready for JSON."""
        return dataclasses.asdict(self)

    @classmethod
    def of(cls, fields: Any) -> "LBCConfig":
        """Return the settings of a stored run.

        Raises:
            TrainingError: a field is unknown or has a wrong value.
        """
        try:
            return cls(**fields)
        except TypeError as error:
            raise TrainingError(f"config: is not of this version ({error}); install the one it is of") from error
