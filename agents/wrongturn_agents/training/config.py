"""What each algorithm is trained with: one dataclass an algorithm, every field explained.

The architectures and the reward are the paper's (Carton et al., IV 2021); what the paper leaves open was found here.
Fields whose comment says *ablation* change what is learnt and give a run its ``variant``; the others change the pace.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

from wrongturn_agents.training.errors import TrainingError

_POSITIVE: Final = ("learning_rate", "reward_divisor", "time_limit", "clip_range")
_ACTIVATIONS: Final = ("tanh", "elu", "relu")
_MOST: Final = 10**12
_SHOWN: Final = 40
_SHARES: Final = (
    *("gamma", "gae_lambda", "near_junctions", "near_bends", "inside_junctions", "masked_classes", "auxiliary_share"),
)
_BEFORE: Final[Mapping[str, Any]] = {"inside_junctions": 0.0, "projection_learning_rate": 1.0}
"""Values of settings in runs that were stored before the settings existed."""


@dataclass(frozen=True, kw_only=True)
class PPOConfig:
    """What the three algorithms have in common."""

    algorithm: ClassVar[str]
    track: ClassVar[str]
    """Whose observation the environments give."""
    keys: ClassVar[tuple[str, ...]]
    """What of it is kept in the rollout buffer."""

    steps: int = 3_000_000
    """Environment steps of the whole run; the learning rate falls over them."""
    num_envs: int = 512
    """Egos driven side by side."""
    n_steps: int = 32
    """Decisions of each ego between two updates."""
    batch_size: int = 2_048
    """Frames of a minibatch."""
    n_epochs: int = 4
    """Passes over a rollout."""
    learning_rate: float = 1e-3
    """Of Adam at the start; it falls linearly to ``final_learning_rate`` times that."""
    encoder_learning_rate: float = 1.0
    """Share of the learning rate for the encoder's convolutions; what follows them has the whole of it."""
    projection_learning_rate: float = 1.0
    """Share of the learning rate for the layer from 6,144 to 512 numbers behind a ResNet; ``ppo-segmentation`` has
    none."""
    final_learning_rate: float = 0.1
    """Share of the learning rate that is left at the end."""
    gamma: float = 0.97
    """Discount: at ten decisions a second it looks some three seconds ahead."""
    gae_lambda: float = 0.95
    """Of the generalised advantage estimation (Schulman et al. 2016)."""
    clip_range: float = 0.2
    """Of the policy's ratio."""
    ent_coef: float = 0.0
    """Weight of the entropy bonus."""
    vf_coef: float = 0.5
    """Weight of the value's loss."""
    max_grad_norm: float = 0.5
    """Longest gradient; a longer one is shortened."""
    kl_stop: float = 0.03
    """Passes over a rollout end where the policy's divergence from the one that drove is above this."""
    kl_revert: float = 5.0
    """An update is undone where that divergence comes to be above this many times ``kl_stop``."""

    reward_divisor: float = 300.0
    """The paper's reward divided by it is what is learnt: returns are then of the order of 1."""
    failure_penalty: float = 0.0
    """Taken off the (divided) reward of a drive that ends off the road, in a collision or in an oncoming lane.

    What a failure costs is all that would have been earned after it; with more than that, cars were seen to learn to
    stand still before junctions.
    """
    standing_penalty: float = 1.0
    """Taken off where a drive ends because the car stood still.

    Not in the paper: by its formula a car that stands still earns reward for as long as it does.
    """
    standing_cost: float = 0.05
    """Taken off the (divided) reward of each decision after which the car stands; at 0.04 standing earns nothing.

    Nor is this in the paper. Unlike a penalty at the end, it is felt at once, however little the future counts.
    """
    activation: str = "tanh"
    """Of the heads: ``tanh``, ``elu`` or ``relu``; with the last, a command's whole head was seen to die."""
    accelerate: float = 0.5
    """Mean of the action accelerate to begin with.

    Brakes are stronger than the motor: a policy that begins at 0 stands still, and sees nothing of the town.
    """
    near_junctions: float = 0.3
    """Share of the drives that start shortly before a junction."""
    near_bends: float = 0.2
    """Share of the drives that start shortly before a bend."""
    inside_junctions: float = 0.2
    """Share of the drives that start inside a junction, on the route's path, at 5 m/s or less.

    Without them a command's head first learns to leave the road before the junction: a random crossing earns as little
    as -302, and the head sees few good ones. These starts show it what comes after a turn.
    """
    lateral: float = 0.4
    """Sigma of the start's offset from the lane's centre, metres."""
    yaw: float = 0.06
    """Sigma of the start's heading, radians."""
    time_limit: float = 60.0
    """Of a drive, seconds; the value of what comes after is then bootstrapped."""

    evaluate_every: int = 600_000
    """Steps between two evaluations on held-out journeys."""
    journeys: int = 50
    """Held-out journeys of the last evaluation, which decides among the best ones before it, too."""
    brief_journeys: int = 20
    """Of these the shortest, for the evaluations before it."""
    strict_evaluation: bool = True
    """A held-out journey fails where the car leaves its road or lane, or stands: stricter than CoRL 2017, and quicker.

    So the best is one that drives cleanly; the suites' journeys go on, and count it.
    """
    patience: float = 30.0
    """Seconds for which a car may stand still in an evaluation before its journey is given up as failed."""

    save_every: float = 10.0
    """Minutes after which ``last.pt`` and the state to resume from are written, beside each evaluation."""

    bf16: bool = True
    """Encoders compute in bfloat16 where the device is CUDA; heads and losses always in float32."""
    compile: bool = False
    """Compile the encoder with ``torch.compile``: a minute at the start, worth it in long runs on CUDA."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value: Any = getattr(self, field.name)
            kind: Any = type(field.default)
            if not _is(value, kind):
                raise TrainingError(f"option {field.name}: is {value!r}; give a {kind.__name__}")
            if isinstance(value, bool | str):
                continue
            # A negative divergence stops each update at once.
            least = -math.inf if field.name == "kl_stop" else 1 if kind is int else 0.0
            if kind is int and value > _MOST:
                raise TrainingError(f"option {field.name}: is {value}; give at most {_MOST}")
            if not (math.isfinite(value) and value >= least):
                raise TrainingError(f"option {field.name}: is {value}; give a finite number, {least} or more")
            if field.name in _POSITIVE and value == 0.0:
                raise TrainingError(f"option {field.name}: is 0; give a number above 0")
            if field.name in _SHARES and value > 1.0:
                raise TrainingError(f"option {field.name}: is {value}; give a number from 0 to 1")
        if self.near_junctions + self.near_bends + self.inside_junctions > 1.0:
            raise TrainingError(
                "option near_junctions, near_bends, inside_junctions: are more than all drives; give shares of at "
                "most 1 together"
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
        """Whether the encoder is not trained by PPO; each frame is then encoded once, and features are buffered."""
        return False

    @property
    def augmented(self) -> bool:
        """Whether pictures are augmented before the policy sees them."""
        return False

    @property
    def masked(self) -> float:
        """Probability of each class of a segmentation to be masked."""
        return 0.0

    @property
    def auxiliary_loss(self) -> bool:
        """Whether the segmentation's loss joins PPO's."""
        return False

    @property
    def predicted_share(self) -> float:
        """Share of each minibatch whose segmentation is predicted."""
        return 0.0

    @property
    def statistics(self) -> bool:
        """Whether batch normalisation learns its statistics from what is driven."""
        return False

    @property
    def disturbed(self) -> bool:
        """Whether what the policy sees is changed at random."""
        return self.augmented or self.masked > 0.0

    @property
    def variant(self) -> str | None:
        """What was left out or added, in words for a table; None for the algorithm as it is meant."""
        return None

    def with_options(self, options: Iterable[str]) -> "PPOConfig":
        """This configuration with fields of ``name=value`` changed.

        Raises:
            TrainingError: there is no such field, or the value is none of its kind.
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
        """The fields by name, as JSON takes them."""
        return dataclasses.asdict(self)


@dataclass(frozen=True, kw_only=True)
class SegmentationConfig(PPOConfig):
    """``ppo-segmentation``: NatureCNN on one-hot segmentation, trained from scratch."""

    algorithm: ClassVar[str] = "ppo-segmentation"
    track: ClassVar[str] = "segmentation"
    keys: ClassVar[tuple[str, ...]] = ("speed", "steering", "command", "segmentation")

    masked_classes: float = 0.0
    """Ablation, the paper's own proposal: probability of each class but the road's to be unseen in a frame."""

    @property
    def masked(self) -> float:
        """As :attr:`masked_classes`."""
        return self.masked_classes

    @property
    def variant(self) -> str | None:
        """``masked-classes`` or None."""
        return "masked-classes" if self.masked_classes else None


@dataclass(frozen=True, kw_only=True)
class ImageConfig(PPOConfig):
    """``ppo-image``: ResNet-34 pretrained on segmentation, frozen while PPO trains what follows it."""

    algorithm: ClassVar[str] = "ppo-image"
    track: ClassVar[str] = "camera"
    keys: ClassVar[tuple[str, ...]] = ("speed", "steering", "command", "rgb")

    steps: int = 4_000_000
    """Environment steps of the whole run; the learning rate falls over them."""
    learning_rate: float = 4e-4
    """Of Adam at the start: a layer over 6,144 normalised numbers takes smaller steps than one over 512."""
    encoder_learning_rate: float = 0.25
    """Share of it for the encoder's convolutions, where they are trained at all."""
    projection_learning_rate: float = 0.1
    """Share of it for the layer from 6,144 to 512. At 1, 65 to 70 % of the layer's outputs die, and many runs never
    learn one of the turns."""
    pretrained: bool = True
    """Ablation: without it the encoder begins at random and is trained by PPO's loss alone."""
    augment: bool = True
    """Ablation: RGB is augmented (erasing, blur, hue, saturation, brightness), in pretraining and while driving."""
    pretraining_frames: int = 131_000
    """Frames of random places in Town01 that the encoder is pretrained on."""
    pretraining_passes: float = 3.0
    """How often each of them is seen on average."""
    pretraining_batch: int = 512
    """Frames of a minibatch in pretraining; with fewer a GPU waits for what launches its kernels."""
    pretraining_rate: float = 1e-3
    """Highest learning rate of pretraining (AdamW, one cycle)."""
    encoder: str = ""
    """A run's ``encoder.pt`` to take instead of pretraining anew."""

    @property
    def frozen(self) -> bool:
        """The pretrained encoder is."""
        return self.pretrained

    @property
    def augmented(self) -> bool:
        """As :attr:`augment`."""
        return self.augment

    @property
    def statistics(self) -> bool:
        """Those of a pretrained encoder stay as they are."""
        return not self.pretrained

    @property
    def variant(self) -> str | None:
        """``without-pretraining``, ``without-augmentation``, both or None."""
        return _without(pretraining=self.pretrained, augmentation=self.augment)


@dataclass(frozen=True, kw_only=True)
class AuxiliaryConfig(PPOConfig):
    """``ppo-auxiliary``: ResNet-34 trained end to end by PPO and by predicting the segmentation."""

    algorithm: ClassVar[str] = "ppo-auxiliary"
    track: ClassVar[str] = "segmentation"
    keys: ClassVar[tuple[str, ...]] = ("speed", "steering", "command", "rgb", "segmentation")

    steps: int = 3_000_000
    """Environment steps of the whole run; the learning rate falls over them."""
    n_epochs: int = 3
    """Passes over a rollout; a ResNet learns slowly enough to count them."""
    learning_rate: float = 5e-4
    """Of Adam at the start, for what follows the ResNet and for the decoder."""
    encoder_learning_rate: float = 0.2
    """Share of it for the ResNet's convolutions: they take smaller steps than what follows them."""
    projection_learning_rate: float = 0.1
    """Share of it for the layer from 6,144 to 512, as in ``ppo-image``."""
    auxiliary: bool = True
    """Ablation: without it there is no segmentation loss."""
    auxiliary_share: float = 0.25
    """Share of each minibatch whose segmentation is predicted: that pass costs more than the policy's."""
    augment: bool = True
    """Ablation: RGB is augmented (erasing, blur, hue, saturation, brightness)."""

    @property
    def augmented(self) -> bool:
        """As :attr:`augment`."""
        return self.augment

    @property
    def auxiliary_loss(self) -> bool:
        """As :attr:`auxiliary`."""
        return self.auxiliary

    @property
    def predicted_share(self) -> float:
        """As :attr:`auxiliary_share`."""
        return self.auxiliary_share

    @property
    def statistics(self) -> bool:
        """They are learned all along."""
        return True

    @property
    def variant(self) -> str | None:
        """``without-auxiliary-loss``, ``without-augmentation``, both or None."""
        return _without(**{"auxiliary-loss": self.auxiliary, "augmentation": self.augment})


ALGORITHMS: Final[Mapping[str, type[PPOConfig]]] = {
    config.algorithm: config for config in (SegmentationConfig, ImageConfig, AuxiliaryConfig)
}
"""The configurations by the names of their algorithms."""


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
    """Whether a value is one of a field's kind; whole numbers are floats, and truth is no number."""
    if kind is float:
        kind = int if isinstance(value, int) else float
    return isinstance(value, kind) and (kind is bool or not isinstance(value, bool))


def _parsed(name: str, text: str, kind: type) -> Any:
    """A field's value from its text."""
    if kind is bool:
        values = {"true": True, "false": False, "1": True, "0": False, "yes": True, "no": False}
        if text.lower() not in values:
            raise TrainingError(f"option {name}: is {text!r}; give true or false")
        return values[text.lower()]
    try:
        return kind(text.replace("_", "")) if kind is int else kind(text)
    except ValueError as error:
        raise TrainingError(f"option {name}: is {text[:_SHOWN]!r}; give a {kind.__name__}") from error
