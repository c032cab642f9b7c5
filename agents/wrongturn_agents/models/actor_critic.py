"""The whole agent: an encoder, speed and steering beside it, and a policy and a value for each command."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn
from torch.nn import functional

from wrongturn_agents.models.branches import Branches
from wrongturn_agents.models.encoders import FEATURES, Encoder
from wrongturn_agents.models.inputs import Observation, wanted

_MEASURED = 64
_SPEED = 10.0  # m/s that count as 1
_STD = (0.24, 0.40)  # of steering and accelerating, to begin with


class ActorCritic(nn.Module):
    """The paper's branched actor-critic, over any of the encoders.

    An observation is a dict of tensors with a batch axis: ``speed`` (B, 1) in m/s, ``steering`` (B, 1), ``command``
    (B, 1) int64, and ``rgb`` (B, 64, 192, 3) or ``segmentation`` (B, 64, 192), uint8 as the environments give them. An
    action of the policy is (steer, accelerate), each meant for [-1, 1] and not bounded here.

    Under bf16 autocast the encoder alone takes part; the layers after it stay in float32.

    Attributes:
        algorithm: what it was built as.
        features_width: F, the width of :meth:`features`.
        log_std: (2,), logarithms of the standard deviations of steer and accelerate, learned.
    """

    def __init__(self, algorithm: str, encoder: Encoder, *, activation: str = "tanh") -> None:
        super().__init__()
        self.algorithm = algorithm
        self.encoder = encoder
        self.measurements = nn.Sequential(
            nn.Linear(2, _MEASURED), nn.ReLU(), nn.Linear(_MEASURED, _MEASURED), nn.ReLU()
        )
        self.features_width = FEATURES + _MEASURED
        self.branches = Branches(self.features_width, activation=activation)
        self.log_std = nn.Parameter(torch.tensor(_STD).log())

    def disturb(self, observation: Observation, generator: torch.Generator | None = None) -> Observation:
        """The same observation, its image changed at random (RGB augmented, or classes hidden), still uint8.

        ``features(..., augment=True)`` is this and then ``features``; called apart, what was seen can be kept.
        """
        with torch.no_grad():
            return self.encoder.disturb(observation, generator)

    def features(
        self, observation: Observation, *, augment: bool = False, generator: torch.Generator | None = None
    ) -> Tensor:
        """What the heads take, (B, F) float32.

        Args:
            observation: the batch.
            augment: whether its image is changed at random first.
            generator: where the random numbers come from, on the batch's device.

        Raises:
            ValueError: the observation lacks the image that this agent looks at, or it has another shape.
        """
        if augment:
            observation = self.disturb(observation, generator)
        return self.join(self.encode(observation), observation)

    def encode(self, observation: Observation) -> Tensor:
        """What the encoder makes of the image, (B, ``encoder.width``) in autocast's dtype.

        While the encoder is frozen this can be kept instead of the picture, and joined as often as one likes.
        """
        encoded: Tensor = self.encoder(observation)
        return encoded

    def join(self, encoded: Tensor, observation: Observation) -> Tensor:
        """Features (B, F) float32 of what was encoded (B, ``encoder.width``) and of ``speed`` and ``steering``."""
        with _float32(encoded):
            measured = torch.cat([observation["speed"] / _SPEED, observation["steering"]], 1).float()
            return torch.cat([self.encoder.project(encoded.float()), self.measurements(measured)], 1)

    def forward(self, features: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        """Mean actions (B, 2) and values (B,), together; cheaper than :meth:`act` and :meth:`value`."""
        with _float32(features):
            both: tuple[Tensor, Tensor] = self.branches(features, command)
            return both

    def act(self, features: Tensor, command: Tensor) -> Tensor:
        """Mean actions (B, 2) of the commanded branch, for features (B, F) and commands (B, 1) or (B,)."""
        with _float32(features):
            return self.branches.act(features, command)

    def value(self, features: Tensor, command: Tensor) -> Tensor:
        """Values (B,) by the commanded branch."""
        with _float32(features):
            return self.branches.estimate(features, command)

    def drive(self, observation: Observation) -> Tensor:
        """Steer, throttle, brake (B, 3), in range: the mean action, clipped; accelerate is throttle or brake."""
        return controls(self.act(self.features(observation), observation["command"]))

    def segmentation_logits(
        self, observation: Observation, *, augment: bool = False, generator: torch.Generator | None = None
    ) -> Tensor:
        """Logits (B, 11, 64, 192) of each pixel's class, from ``rgb``; arguments as :meth:`features`'.

        In training mode this is what teaches batch normalisation its statistics; nothing else does.

        Raises:
            ValueError: the agent looks at segmentation itself.
        """
        if augment:
            observation = self.disturb(observation, generator)
        return self.encoder.segmentation_logits(observation)

    def segmentation_loss(
        self, observation: Observation, *, augment: bool = False, generator: torch.Generator | None = None
    ) -> Tensor:
        """Mean cross-entropy of :meth:`segmentation_logits` with the observation's ``segmentation``."""
        logits = self.segmentation_logits(observation, augment=augment, generator=generator)
        return functional.cross_entropy(logits, wanted(observation, "segmentation").long())

    def update_statistics(self, observation: Observation) -> None:
        """Teach the driving path's batch normalisation by one batch, without gradients.

        A ResNet that starts from nothing needs a few dozen of these before it drives; without a loss of segmentation
        it needs them all along.
        """
        self.encoder.update_statistics(observation)


def controls(action: Tensor) -> Tensor:
    """Steer, throttle, brake (..., 3) of the policy's (..., 2), clipped to what a car takes."""
    steer, accelerate = action.clamp(-1.0, 1.0).unbind(-1)
    return torch.stack([steer, accelerate.clamp(min=0.0), (-accelerate).clamp(min=0.0)], -1)


@contextmanager
def _float32(like: Tensor) -> Iterator[None]:
    # Only within autocast, so that an exported graph holds no trace of it.
    device = like.device.type
    if torch.is_autocast_enabled(device):
        with torch.autocast(device, enabled=False):
            yield
    else:
        yield
