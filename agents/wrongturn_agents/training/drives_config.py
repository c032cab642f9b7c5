"""Settings that every agent has in common that learns by driving: its drives, its rewards and its evaluations."""

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.options import in_words, with_options

_POSITIVE: Final = ("learning_rate", "reward_divisor", "time_limit", "clip_range", "window_nearest")
_MOST: Final = 10**12
_SHOWN: Final = 40
_FARTHEST_WINDOW: Final = 60.0
_SHARES: Final = (
    *("gamma", "gae_lambda", "near_junctions", "near_bends", "inside_junctions", "masked_classes", "auxiliary_share"),
    *("traffic", "hesitant", "leaders", "crossers", "waiters"),
)
ROAD_USERS: Final = ("vehicles", "pedestrians")
MOST_ROAD_USERS: Final = 200
"""Most other cars of a drive, and most pedestrians."""


@dataclass(frozen=True, kw_only=True)
class DrivesConfig:
    """Settings of the drives, the rewards and the evaluations of a run."""

    algorithm: ClassVar[str]
    track: ClassVar[str]
    """Track whose observation the environments return."""
    keys: ClassVar[tuple[str, ...]]
    """Keys of the observation that learning keeps."""

    steps: int = 3_000_000
    """Environment steps of the whole run. The learning rate falls over them."""
    num_envs: int = 512
    """Number of cars that drive side by side."""
    reward_divisor: float = 300.0
    """Divisor of the paper's reward, so that returns are about 1."""
    failure_penalty: float = 0.0
    """Taken off the divided reward when a drive ends off the road, in a collision or in an oncoming lane.

    A failure already costs everything that would have been earned after it. With a greater cost, cars learned to stand
    still before junctions.
    """
    collision_penalty: float = 2.0
    """Taken off the divided reward when a drive ends in a collision, beside ``failure_penalty``.

    Waiting behind another car earns little, so a crash that ends it would cost little too.
    """
    standing_penalty: float = 1.0
    """Taken off the divided reward when a drive ends because the car stands still.

    Not in the paper, whose formula rewards a car for standing still.
    """
    standing_cost: float = 0.05
    """Taken off the divided reward of each decision after which the car stands. At 0.04, standing earns nothing.
    Standing is free while other road users block the way.

    Not in the paper. Unlike a penalty at the end, the policy feels it at once, whatever the discount.
    """
    near_junctions: float = 0.3
    """Share of the drives that start shortly before a junction."""
    near_bends: float = 0.2
    """Share of the drives that start shortly before a bend."""
    inside_junctions: float = 0.2
    """Share of the drives that start inside a junction, on the route's path, at 5 m/s or less.

    A random crossing earns as little as -302, so without these starts a turn's head first learns to leave the road
    before the junction. These starts show it what comes after.
    """
    traffic: float = 0.7
    """Share of the drives beside other cars and pedestrians. 0: all cars drive alone, and no journey has traffic."""
    vehicles: int = 60
    """Most other cars of such a drive, in the whole town. Each drive draws a third of them or more."""
    pedestrians: int = 50
    """Most pedestrians of such a drive, on the pavements. Each drive draws a third of them or more."""
    hesitant: float = 0.3
    """Share of the other cars that drive slowly and stop now and then without need. The suites have none: they let
    the learner often meet a car that brakes.
    """
    leaders: float = 0.5
    """Share of the drives with traffic that start shortly behind another car, where the lane has room."""
    crossers: float = 0.5
    """Share of the junctions at which the car has to give way and another one then crosses its way. Without these,
    cars learned to follow others but not to give way.
    """
    waiters: float = 0.3
    """Share of the junctions at which a car stands at a stop line: ahead in the car's own lane, or in the oncoming lane
    of the street into which it turns. Without these, cars learned to turn through those that wait.
    """
    lateral: float = 0.4
    """Standard deviation of the start's offset from the lane's centre, metres."""
    yaw: float = 0.06
    """Standard deviation of the start's heading, radians."""
    window_nearest: float = 10.0
    """Least distance before the stop line at which the command's window opens, metres. Each drive draws its own."""
    window_farthest: float = 20.0
    """Greatest distance at which it opens, metres. The suites of version 2 draw it between 10 and 20 m."""
    time_limit: float = 60.0
    """Time limit of a drive, seconds. The value of what would follow is bootstrapped."""

    evaluate_every: int = 600_000
    """Steps between two evaluations on held-out journeys."""
    journeys: int = 50
    """Held-out journeys of the last evaluation, which also decides between the best agents before it."""
    brief_journeys: int = 20
    """Held-out journeys of the earlier evaluations: the shortest ones."""
    strict_evaluation: bool = True
    """A held-out journey fails when the car leaves its road or lane, or stands: stricter than CoRL 2017, and
    quicker.

    So the best agent drives cleanly. In the suites such a journey continues and the infraction is counted.
    """
    patience: float = 30.0
    """An evaluation gives a journey up after its car stood still for this long, seconds."""

    save_every: float = 10.0
    """Minutes between two saves of ``last.pt`` and ``state.pt``. Each evaluation saves them as well."""

    bf16: bool = True
    """Compute encoders in bfloat16 on CUDA. Heads and losses are always float32."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value: Any = getattr(self, field.name)
            kind: Any = type(field.default)
            if not _is(value, kind):
                raise TrainingError(f"option {field.name}: is {value!r}; give {in_words(kind)}")
            if isinstance(value, bool | str):
                continue
            # A negative limit of the divergence stops each update at once.
            counts = kind is int and field.name not in ROAD_USERS
            least = -math.inf if field.name == "kl_stop" else 1 if counts else 0
            if kind is int and value > _MOST:
                raise TrainingError(f"option {field.name}: is {value}; give at most {_MOST}")
            if not (math.isfinite(value) and value >= least):
                raise TrainingError(f"option {field.name}: is {value}; give a finite number, {least} or more")
            if field.name in ROAD_USERS and value > MOST_ROAD_USERS:
                raise TrainingError(f"option {field.name}: is {value}; give at most {MOST_ROAD_USERS}")
            if field.name in _POSITIVE and value == 0.0:
                raise TrainingError(f"option {field.name}: is 0; give a number above 0")
            if field.name in _SHARES and value > 1.0:
                raise TrainingError(f"option {field.name}: is {value}; give a number from 0 to 1")
        check_starts(
            (self.near_junctions, self.near_bends, self.inside_junctions), (self.window_nearest, self.window_farthest)
        )

    @property
    def variant(self) -> str | None:
        """Name of the ablation for tables; None for the unchanged algorithm."""
        return None

    def with_options(self, options: Iterable[str]) -> Self:
        """Return this configuration with the fields of ``name=value`` options changed.

        Raises:
            TrainingError: there is no such field, or the value has another type.
        """
        return with_options(self, options, _parsed)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name, ready for JSON."""
        return dataclasses.asdict(self)


def check_starts(shares: tuple[float, float, float], window: tuple[float, float]) -> None:
    """Check where drives begin and where their commands' windows open.

    Args:
        shares: of all drives, those that begin near a junction, near a bend and inside a junction.
        window: least and greatest distance before the stop line, m.

    Raises:
        TrainingError: the shares exceed 1 together, or the window is no range.
    """
    if sum(shares) > 1.0:
        raise TrainingError(
            "option near_junctions, near_bends, inside_junctions: are more than all drives; give shares of at most 1 "
            "together"
        )
    if not window[0] <= window[1] <= _FARTHEST_WINDOW:
        raise TrainingError(
            f"option window_nearest, window_farthest: are {window[0]} and {window[1]}, which is no range; give the "
            f"least and the greatest distance, at most {_FARTHEST_WINDOW:.0f} m"
        )


def _is(value: Any, kind: type) -> bool:
    """Return whether a value has a field's type. A whole number is also a float, and a boolean is no number."""
    if kind is float:
        kind = int if isinstance(value, int) else float
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


def _parsed(name: str, text: str, kind: type) -> Any:
    """Return a field's value from its text."""
    if kind is bool:
        values = {"true": True, "false": False, "1": True, "0": False, "yes": True, "no": False}
        if text.lower() not in values:
            raise TrainingError(f"option {name}: is {text!r}; give true or false")
        return values[text.lower()]
    try:
        return kind(text.replace("_", "")) if kind is int else kind(text)
    except ValueError as error:
        raise TrainingError(f"option {name}: is {text[:_SHOWN]!r}; give {in_words(kind)}") from error
