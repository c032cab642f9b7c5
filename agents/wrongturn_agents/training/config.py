"""Settings of each algorithm: one dataclass for each, with every field explained.

The architectures and the reward are the paper's (Carton et al., IV 2021). What the paper leaves open was found here.
Fields marked *ablation* change what is learned and give a run its ``variant``. The others change how fast it learns.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from wrongturn_agents.training.errors import TrainingError

_POSITIVE: Final = ("learning_rate", "reward_divisor", "time_limit", "clip_range", "window_nearest")
_ACTIVATIONS: Final = ("tanh", "elu", "relu")
_MOST: Final = 10**12
_SHOWN: Final = 40
_FARTHEST_WINDOW: Final = 60.0
_SHARES: Final = (
    *("gamma", "gae_lambda", "near_junctions", "near_bends", "inside_junctions", "masked_classes", "auxiliary_share"),
    *("traffic", "hesitant", "leaders"),
)
_ROAD_USERS: Final = ("vehicles", "pedestrians")
_MOST_ROAD_USERS: Final = 200
_BEFORE: Final[Mapping[str, Any]] = {
    "inside_junctions": 0.0,
    "projection_learning_rate": 1.0,
    "collision_penalty": 0.0,
    "traffic": 0.0,
    "window_nearest": 15.0,
    "window_farthest": 15.0,
}
"""Values of settings in runs that were stored before the settings existed."""


@dataclass(frozen=True, kw_only=True)
class PPOConfig:
    """Settings that the three algorithms have in common."""

    algorithm: ClassVar[str]
    track: ClassVar[str]
    """Track whose observation the environments return."""
    keys: ClassVar[tuple[str, ...]]
    """Keys of the observation that the rollout buffer keeps."""

    steps: int = 3_000_000
    """Environment steps of the whole run. The learning rate falls over them."""
    num_envs: int = 512
    """Number of cars that drive side by side."""
    n_steps: int = 32
    """Decisions of each car between two updates."""
    batch_size: int = 2_048
    """Frames in a minibatch."""
    n_epochs: int = 4
    """Passes over a rollout."""
    learning_rate: float = 1e-3
    """Adam's learning rate at the start. It falls linearly to this times ``final_learning_rate``."""
    encoder_learning_rate: float = 1.0
    """Share of the learning rate for the encoder's convolutions. The layers after them get all of it."""
    projection_learning_rate: float = 1.0
    """Share of the learning rate for the layer from 6,144 to 512 numbers behind a ResNet. ``ppo-segmentation`` has
    no such layer.
    """
    final_learning_rate: float = 0.1
    """Share of the learning rate that is left at the end."""
    gamma: float = 0.97
    """Discount. At ten decisions a second, 0.97 looks about three seconds ahead."""
    gae_lambda: float = 0.95
    """Lambda of the generalised advantage estimation (Schulman et al. 2016)."""
    clip_range: float = 0.2
    """Clip range of the policy's ratio."""
    ent_coef: float = 0.0
    """Weight of the entropy bonus."""
    vf_coef: float = 0.5
    """Weight of the value loss."""
    max_grad_norm: float = 0.5
    """Greatest norm of the gradient. A longer gradient is shortened."""
    kl_stop: float = 0.03
    """An update's passes end when the policy's divergence from the policy that drove exceeds this."""
    kl_revert: float = 5.0
    """An update is undone when that divergence exceeds this many times ``kl_stop``."""

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
    activation: str = "tanh"
    """Activation of the heads: ``tanh``, ``elu`` or ``relu``. With ``relu``, a command's whole head died in some
    runs.
    """
    accelerate: float = 0.5
    """Mean of the action *accelerate* at the start.

    Brakes are stronger than the motor, so a policy that starts at 0 stands still and sees nothing of the town.
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
    compile: bool = False
    """Compile the encoder with ``torch.compile``. It costs a minute at the start and pays off in long runs on CUDA."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value: Any = getattr(self, field.name)
            kind: Any = type(field.default)
            if not _is(value, kind):
                raise TrainingError(f"option {field.name}: is {value!r}; give a {kind.__name__}")
            if isinstance(value, bool | str):
                continue
            # A negative limit of the divergence stops each update at once.
            counts = kind is int and field.name not in _ROAD_USERS
            least = -math.inf if field.name == "kl_stop" else 1 if counts else 0
            if kind is int and value > _MOST:
                raise TrainingError(f"option {field.name}: is {value}; give at most {_MOST}")
            if not (math.isfinite(value) and value >= least):
                raise TrainingError(f"option {field.name}: is {value}; give a finite number, {least} or more")
            if field.name in _ROAD_USERS and value > _MOST_ROAD_USERS:
                raise TrainingError(f"option {field.name}: is {value}; give at most {_MOST_ROAD_USERS}")
            if field.name in _POSITIVE and value == 0.0:
                raise TrainingError(f"option {field.name}: is 0; give a number above 0")
            if field.name in _SHARES and value > 1.0:
                raise TrainingError(f"option {field.name}: is {value}; give a number from 0 to 1")
        if self.near_junctions + self.near_bends + self.inside_junctions > 1.0:
            raise TrainingError(
                "option near_junctions, near_bends, inside_junctions: are more than all drives; give shares of at "
                "most 1 together"
            )
        if not self.window_nearest <= self.window_farthest <= _FARTHEST_WINDOW:
            raise TrainingError(
                f"option window_nearest, window_farthest: are {self.window_nearest} and {self.window_farthest}, which "
                f"is no range; give the least and the greatest distance, at most {_FARTHEST_WINDOW:.0f} m"
            )
        if self.activation not in _ACTIVATIONS:
            raise TrainingError(f"option activation: is {self.activation!r}; give one of {', '.join(_ACTIVATIONS)}")
        if 1 in {self.batch_size, self.num_envs * self.n_steps % self.batch_size}:
            raise TrainingError(
                f"option batch_size: is {self.batch_size}, so that a minibatch of num_envs * n_steps = "
                f"{self.num_envs * self.n_steps} frames has one alone, without a deviation; give another"
            )

    @property
    def frozen(self) -> bool:
        """Whether PPO leaves the encoder as it is. Each frame is then encoded once, and the buffer keeps features."""
        return getattr(self, "pretrained", False)

    @property
    def augmented(self) -> bool:
        """Whether pictures are augmented before the policy sees them."""
        return getattr(self, "augment", False)

    @property
    def masked(self) -> float:
        """Probability that each class of a segmentation is masked."""
        return getattr(self, "masked_classes", 0.0)

    @property
    def auxiliary_loss(self) -> bool:
        """Whether the segmentation loss joins PPO's loss."""
        return getattr(self, "auxiliary", False)

    @property
    def predicted_share(self) -> float:
        """Share of each minibatch whose segmentation is predicted."""
        return getattr(self, "auxiliary_share", 0.0)

    @property
    def statistics(self) -> bool:
        """Whether batch normalisation learns its statistics while driving."""
        return False

    @property
    def disturbed(self) -> bool:
        """Whether the policy's pictures are changed at random."""
        return self.augmented or self.masked > 0.0

    @property
    def variant(self) -> str | None:
        """Name of the ablation for tables; None for the unchanged algorithm."""
        return None

    def with_options(self, options: Iterable[str]) -> "PPOConfig":
        """Return this configuration with the fields of ``name=value`` options changed.

        Raises:
            TrainingError: there is no such field, or the value has another type.
        """
        fields = {field.name: field for field in dataclasses.fields(self)}
        changed: dict[str, Any] = {}
        for option in options:
            name, equals, text = option.partition("=")
            if not equals or name not in fields:
                raise TrainingError(f"option {option!r}: give name=value with one of {', '.join(sorted(fields))}")
            changed[name] = _parsed(name, text, type(getattr(self, name)))
        return dataclasses.replace(self, **changed)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name, ready for JSON."""
        return dataclasses.asdict(self)


@dataclass(frozen=True, kw_only=True)
class SegmentationConfig(PPOConfig):
    """``ppo-segmentation``: NatureCNN on one-hot segmentation, trained from scratch."""

    algorithm: ClassVar[str] = "ppo-segmentation"
    track: ClassVar[str] = "segmentation"
    keys: ClassVar[tuple[str, ...]] = ("speed", "steering", "command", "segmentation")

    masked_classes: float = 0.0
    """Ablation, proposed in the paper: probability that each class but the road is hidden in a frame."""

    @property
    def variant(self) -> str | None:
        """``masked-classes`` or None."""
        return "masked-classes" if self.masked_classes else None


@dataclass(frozen=True, kw_only=True)
class ImageConfig(PPOConfig):
    """``ppo-image``: ResNet-34 pretrained on segmentation and frozen; PPO trains the layers after it."""

    algorithm: ClassVar[str] = "ppo-image"
    track: ClassVar[str] = "camera"
    keys: ClassVar[tuple[str, ...]] = ("speed", "steering", "command", "rgb")

    steps: int = 4_000_000
    """Environment steps of the whole run. The learning rate falls over them."""
    learning_rate: float = 4e-4
    """Adam's learning rate at the start. A layer over 6,144 normalised numbers needs smaller steps than one over
    512.
    """
    encoder_learning_rate: float = 0.25
    """Share of the learning rate for the encoder's convolutions, if they are trained at all."""
    projection_learning_rate: float = 0.1
    """Share of the learning rate for the layer from 6,144 to 512. At 1, 65 to 70 % of its outputs die, and many runs
    never learn one of the turns.
    """
    pretrained: bool = True
    """Ablation: without it the encoder starts at random and learns from PPO's loss alone."""
    augment: bool = True
    """Ablation: augment RGB (erasing, blur, hue, saturation, brightness), in pretraining and while driving."""
    pretraining_frames: int = 131_000
    """Frames of random places in Town01 for the encoder's pretraining."""
    pretraining_passes: float = 3.0
    """Number of times that each frame is used, on average."""
    pretraining_batch: int = 512
    """Frames of a minibatch in pretraining. With fewer, a GPU mostly waits for its kernels to be launched."""
    pretraining_rate: float = 1e-3
    """Greatest learning rate of pretraining (AdamW, one cycle)."""
    encoder: str = ""
    """Path of a run's ``encoder.pt`` to use instead of a new pretraining."""

    @property
    def statistics(self) -> bool:
        """False with pretraining: the statistics stay as they are."""
        return not self.pretrained

    @property
    def variant(self) -> str | None:
        """``without-pretraining``, ``without-augmentation``, both or None."""
        return _without(pretraining=self.pretrained, augmentation=self.augment)


@dataclass(frozen=True, kw_only=True)
class AuxiliaryConfig(PPOConfig):
    """``ppo-auxiliary``: ResNet-34 trained end to end, by PPO and by predicting the segmentation."""

    algorithm: ClassVar[str] = "ppo-auxiliary"
    track: ClassVar[str] = "segmentation"
    keys: ClassVar[tuple[str, ...]] = ("speed", "steering", "command", "rgb", "segmentation")

    steps: int = 3_000_000
    """Environment steps of the whole run. The learning rate falls over them."""
    n_epochs: int = 3
    """Passes over a rollout. Few, because a pass through a ResNet is slow."""
    learning_rate: float = 5e-4
    """Adam's learning rate at the start, for the decoder and the layers after the ResNet."""
    encoder_learning_rate: float = 0.2
    """Share of the learning rate for the ResNet's convolutions, which need smaller steps."""
    projection_learning_rate: float = 0.1
    """Share of the learning rate for the layer from 6,144 to 512, as in ``ppo-image``."""
    auxiliary: bool = True
    """Ablation: without it there is no segmentation loss."""
    auxiliary_share: float = 0.25
    """Share of each minibatch whose segmentation is predicted. This pass costs more than the policy's."""
    augment: bool = True
    """Ablation: augment RGB (erasing, blur, hue, saturation, brightness)."""

    @property
    def statistics(self) -> bool:
        """Always True."""
        return True

    @property
    def variant(self) -> str | None:
        """``without-auxiliary-loss``, ``without-augmentation``, both or None."""
        return _without(**{"auxiliary-loss": self.auxiliary, "augmentation": self.augment})


ALGORITHMS: Final[Mapping[str, type[PPOConfig]]] = {
    config.algorithm: config for config in (SegmentationConfig, ImageConfig, AuxiliaryConfig)
}
"""The configurations by algorithm."""


def config_of(algorithm: str, fields: Mapping[str, Any] | None = None) -> PPOConfig:
    """Return the configuration of an algorithm.

    Args:
        algorithm: its name.
        fields: of a stored run. A setting that is younger than the run gets the value by which it changes nothing;
            without fields every setting has its default.

    Raises:
        TrainingError: there is no such algorithm, or no such field.
    """
    if algorithm not in ALGORITHMS:
        raise TrainingError(f"algorithm: there is no {algorithm!r}; choose one of {', '.join(ALGORITHMS)}")
    config = ALGORITHMS[algorithm]
    unknown = [name for name in fields or {} if name not in {field.name for field in dataclasses.fields(config)}]
    if unknown:
        raise TrainingError(f"config: this version knows no {unknown[0]!r} of {algorithm}; install the one it is of")
    return config() if fields is None else config(**{**_BEFORE, **fields})


def _without(**present: bool) -> str | None:
    left_out = [name for name, there in present.items() if not there]
    return "without-" + "-and-".join(left_out) if left_out else None


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
        raise TrainingError(f"option {name}: is {text[:_SHOWN]!r}; give a {kind.__name__}") from error
