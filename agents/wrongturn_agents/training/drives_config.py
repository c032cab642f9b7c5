"""Settings of the cars that an agent learns from: their drives, rewards and evaluations."""

from dataclasses import dataclass
from typing import ClassVar, Final

from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.settings import SHARE, Settings, without

_FARTHEST_WINDOW: Final = 60.0
_SHARES: Final = (
    *("near_junctions", "near_bends", "inside_junctions", "traffic", "hesitant", "leaders", "crossers", "waiters"),
)
MOST_ROAD_USERS: Final = 200
"""Most other cars of a drive, and most pedestrians."""


@dataclass(frozen=True, kw_only=True)
class CarsConfig(Settings):
    """The curriculum of cars that cruise about towns: where they start, and whom they meet. And the evaluations."""

    RANGES: ClassVar = dict.fromkeys(_SHARES, SHARE) | dict.fromkeys(("vehicles", "pedestrians"), (0, MOST_ROAD_USERS))
    POSITIVE: ClassVar[tuple[str, ...]] = ("learning_rate", "time_limit", "window_nearest")

    num_envs: int = 512
    """Number of cars that drive side by side."""
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
    """Minutes between two saves of the agent and of ``state.pt``. Each evaluation saves them as well."""

    bf16: bool = True
    """Compute encoders in bfloat16 on CUDA. Heads and losses are always float32."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.near_junctions + self.near_bends + self.inside_junctions > 1.0:
            raise TrainingError(
                "option near_junctions, near_bends, inside_junctions: are more than all drives; give shares of at most "
                "1 together"
            )
        if not self.window_nearest <= self.window_farthest <= _FARTHEST_WINDOW:
            raise TrainingError(
                f"option window_nearest, window_farthest: are {self.window_nearest} and {self.window_farthest}, which "
                f"is no range; give the least and the greatest distance, at most {_FARTHEST_WINDOW:.0f} m"
            )


@dataclass(frozen=True, kw_only=True)
class DrivesConfig(CarsConfig):
    """The curriculum, and the rewards of a learner that drives."""

    track: ClassVar[str] = "segmentation"
    """Track whose observation the environments return."""
    keys: ClassVar[tuple[str, ...]] = ("speed", "steering", "command", "segmentation")
    """Keys of the observation that learning keeps."""
    RANGES: ClassVar = {**CarsConfig.RANGES, "gamma": SHARE}
    POSITIVE: ClassVar[tuple[str, ...]] = (*CarsConfig.POSITIVE, "reward_divisor")

    steps: int = 3_000_000
    """Environment steps of the whole run. The learning rate falls over them."""
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
    evaluate_every: int = 600_000
    """Steps between two evaluations on held-out journeys."""


@dataclass(frozen=True, kw_only=True)
class PlacesConfig(CarsConfig):
    """Where the cars drive, what cameras they have and how the weather looks.

    All is drawn from seeds that no draw of a suite gives.
    """

    RANGES: ClassVar = {**CarsConfig.RANGES, **dict.fromkeys(("towns", "sceneries"), (0, 1000))}

    towns: int = 0
    """Number of drawn towns beside Town01."""
    sceneries: int = 0
    """Number of drawn sceneries of Town01 beside the one that it ships with."""
    cameras: bool = False
    """Mount each car's camera otherwise: by up to 0.05 rad of pitch, 0.2 m of height and 8 % of its focal length."""
    weathers: bool = False
    """Let the weather of each drive look like one of the training weathers or like something between two."""
    groups: int = 4
    """Number of groups of cars, each in a town of its own. With 8, six runs on a GPU took 2.5 times as long for a step.
    """
    stay: int = 960
    """Decisions after which each group moves on to its next town."""


@dataclass(frozen=True, kw_only=True)
class WorldConfig(PlacesConfig, DrivesConfig):
    """Settings of a learner that drives in many towns, whose pictures and steering may be disturbed too."""

    RANGES: ClassVar = {
        **PlacesConfig.RANGES,
        **DrivesConfig.RANGES,
        "noise": (0, 100),
        "delay": (0, 20),
        "steering": (0, 0.9),
    }

    noise: float = 0.0
    """Greatest standard deviation of the noise of each pixel's red, green and blue, of 255. Each drive
    draws its own.
    """
    delay: int = 0
    """Most decisions by which what the agent sees is late. Each drive draws its own number."""
    steering: float = 0.0
    """Greatest share by which the wheels turn more or less than the agent steers. Each drive draws its own."""


@dataclass(frozen=True, kw_only=True)
class PretrainedConfig(DrivesConfig):
    """Settings of a learner whose encoder learns to see before it drives."""

    POSITIVE: ClassVar[tuple[str, ...]] = (*DrivesConfig.POSITIVE, "pretraining_minutes", "pretraining_passes")

    pretrained: bool = True
    """Ablation: without it the encoder starts at random."""
    augment: bool = True
    """Ablation: augment RGB (erasing, blur, hue, saturation, brightness), in pretraining and while driving."""
    pretraining_frames: int = 131_000
    """Frames, or stacks of them, of random places for the encoder's pretraining."""
    pretraining_passes: float = 3.0
    """Number of times that each frame is used, on average."""
    pretraining_batch: int = 512
    """Frames of a minibatch in pretraining. With fewer, a GPU mostly waits for its kernels to be launched."""
    pretraining_rate: float = 1e-3
    """Greatest learning rate of pretraining (AdamW): it rises during the first tenth, then falls by a half cosine."""
    pretraining_minutes: float = 1_000.0
    """Most minutes of pretraining, from its first pictures on. The learning rate follows frames or minutes, whichever
    are further on.
    """
    encoder: str = ""
    """Path of a run's ``encoder.pt`` to use instead of a new pretraining."""

    @property
    def variant(self) -> str | None:
        """``without-pretraining``, ``without-augmentation``, both or None."""
        return without(pretraining=self.pretrained, augmentation=self.augment)
