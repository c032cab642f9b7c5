"""Settings of the paper's three agents: one dataclass for each, with every field explained.

The architectures and the reward are the paper's (Carton et al., IV 2021). What the paper leaves open was found here.
Fields marked *ablation* change what is learned and give a run its ``variant``. The others change how fast it learns.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Final

from wrongturn_agents.models.encoders import PROJECTIONS
from wrongturn_agents.training.drives_config import PretrainedConfig, WorldConfig
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.settings import ANY, PIXELS, SHARE, without

_ACTIVATIONS: Final = ("tanh", "elu", "relu")
_BYTES: Final = {"rgb": 3 * PIXELS, "segmentation": PIXELS}
_FEATURES: Final = 2 * 6144
"""Bytes of a frozen encoder's output for a picture."""


@dataclass(frozen=True, kw_only=True)
class PPOConfig(WorldConfig):
    """Settings that the paper's three algorithms have in common."""

    RANGES: ClassVar = {
        **WorldConfig.RANGES,
        **dict.fromkeys(("gae_lambda", "masked_classes", "auxiliary_share"), SHARE),
        "kl_stop": ANY,  # a negative limit of the divergence stops each update at once
    }
    POSITIVE: ClassVar[tuple[str, ...]] = (*WorldConfig.POSITIVE, "clip_range")

    # Without types these are no options. An algorithm that has such an option declares it.
    pretrained = False
    """Whether PPO leaves the encoder as it is. Each frame is then encoded once, and the buffer keeps features."""
    augment = False
    """Whether pictures are augmented before the policy sees them."""
    masked_classes = 0.0
    """Probability that each class of a segmentation is masked."""
    auxiliary = False
    """Whether the segmentation loss joins PPO's loss."""
    auxiliary_share = 0.0
    """Share of each minibatch whose segmentation is predicted."""

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

    activation: str = "tanh"
    """Activation of the heads: ``tanh``, ``elu`` or ``relu``. With ``relu``, a command's whole head died in some
    runs.
    """
    accelerate: float = 0.5
    """Mean of the action *accelerate* at the start.

    Brakes are stronger than the motor, so a policy that starts at 0 stands still and sees nothing of the town.
    """
    compile: bool = False
    """Compile the encoder with ``torch.compile``. It costs a minute at the start and pays off in long runs on CUDA."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, known in (("activation", _ACTIVATIONS), ("projection", PROJECTIONS)):
            if (given := getattr(self, name, known[0])) not in known:
                raise TrainingError(f"option {name}: is {given!r}; give one of {', '.join(known)}")
        if 1 in {self.batch_size, self.num_envs * self.n_steps % self.batch_size}:
            raise TrainingError(
                f"option batch_size: is {self.batch_size}, so that a minibatch of num_envs * n_steps = "
                f"{self.num_envs * self.n_steps} frames has one alone, without a deviation; give another"
            )

    @property
    def statistics(self) -> bool:
        """Whether batch normalisation learns its statistics while driving."""
        return False

    @property
    def disturbed(self) -> bool:
        """Whether the policy's pictures are changed at random."""
        return self.augment or self.masked_classes > 0.0

    def memory(self) -> Iterable[tuple[str, int, str]]:
        """Return the bytes of a rollout's pictures or, if the encoder is frozen, of their features, about."""
        kept = _FEATURES if self.pretrained else sum(_BYTES.get(key, 0) for key in self.keys)
        current = sum(_BYTES.values())  # each car has a current picture of each kind
        return [("num_envs", self.num_envs * (self.n_steps * kept + current), "egos")]


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
class _ResNetConfig(PPOConfig):
    """Settings of the two agents that see RGB with a ResNet."""

    BEFORE: ClassVar = {"projection": "relu"}

    steps: int = 4_000_000
    """Environment steps of the whole run. The learning rate falls over them."""
    projection: str = "elu"
    """End of the layer from 6,144 to 512: ``elu`` after a layer normalisation, or ``relu``. With ``relu`` at the full
    learning rate, 65 to 70 % of its outputs die, and many runs never learn one of the turns.
    """
    waiters: float = 0.8
    """Share of the junctions at which a car stands at a stop line. With fewer, or with ``relu``, cars run into those
    that wait.
    """


@dataclass(frozen=True, kw_only=True)
class ImageConfig(_ResNetConfig, PretrainedConfig):
    """``ppo-image``: ResNet-34 pretrained on segmentation and frozen; PPO trains the layers after it."""

    algorithm: ClassVar[str] = "ppo-image"
    track: ClassVar[str] = "camera"
    keys: ClassVar[tuple[str, ...]] = ("speed", "steering", "command", "rgb")
    POSITIVE: ClassVar[tuple[str, ...]] = (*PPOConfig.POSITIVE, *PretrainedConfig.POSITIVE)

    learning_rate: float = 4e-4
    """Adam's learning rate at the start. A layer over 6,144 normalised numbers needs smaller steps than one over
    512.
    """
    encoder_learning_rate: float = 0.25
    """Share of the learning rate for the encoder's convolutions, if they are trained at all."""

    @property
    def statistics(self) -> bool:
        """False with pretraining: the statistics stay as they are."""
        return not self.pretrained


@dataclass(frozen=True, kw_only=True)
class AuxiliaryConfig(_ResNetConfig):
    """``ppo-auxiliary``: ResNet-34 trained end to end, by PPO and by predicting the segmentation."""

    algorithm: ClassVar[str] = "ppo-auxiliary"
    track: ClassVar[str] = "segmentation"
    keys: ClassVar[tuple[str, ...]] = ("speed", "steering", "command", "rgb", "segmentation")

    n_steps: int = 16
    """Decisions of each car between two updates. With 32, reward rose more slowly (``docs/training-runs.md``)."""
    batch_size: int = 1_024
    """Frames in a minibatch."""
    n_epochs: int = 3
    """Passes over a rollout. Few, because a pass through a ResNet is slow."""
    learning_rate: float = 5e-4
    """Adam's learning rate at the start, for the decoder and the layers after the ResNet."""
    encoder_learning_rate: float = 0.2
    """Share of the learning rate for the ResNet's convolutions, which need smaller steps."""
    ent_coef: float = 0.003
    """Weight of the entropy bonus. All heads share the spread of the actions, and it narrows as some succeed: without a
    bonus, one of five seeds never learned a turn.
    """
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
        return without(auxiliary_loss=self.auxiliary, augmentation=self.augment)
