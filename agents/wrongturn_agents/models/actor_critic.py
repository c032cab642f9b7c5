"""The whole agent: an encoder, speed and steering beside it, and a policy and a value for each command."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from wrongturn_agents.models.branches import Branches
from wrongturn_agents.models.encoders import FEATURES, AuxiliaryEncoder, Encoder, ImageEncoder, SegmentationEncoder
from wrongturn_agents.models.inputs import Observation, wanted

ALGORITHMS: Final = ("ppo-segmentation", "ppo-image", "ppo-auxiliary")
"""The paper's three agents."""
_MEASURED = 64
_SPEED = 10.0  # m/s that count as 1
_STD = (0.24, 0.40)  # of steering and accelerating, to begin with


class ActorCritic(nn.Module):
    """The paper's branched actor-critic, with any of the encoders.

    An observation is a dict of tensors with a batch axis: ``speed`` (B, 1) in m/s, ``steering`` (B, 1), ``command`` (B,
    1) int64, and ``rgb`` (B, 64, 192, 3) or ``segmentation`` (B, 64, 192), uint8 as from the environments. The policy's
    action is (steer, accelerate). Both are meant for [-1, 1], and not clipped here.

    Under bf16 autocast only the encoder changes its precision; the layers after it stay in float32.

    Attributes:
        algorithm: name of the algorithm.
        features_width: F, the width of :meth:`features`.
        log_std: (2,), learned logarithms of the standard deviations of steer and accelerate.
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
        """Return the observation with its image changed at random (RGB augmented, or classes hidden), still uint8."""
        with torch.no_grad():
            return self.encoder.disturb(observation, generator)

    def features(self, observation: Observation) -> Tensor:
        """Return the input of the heads, (B, F) float32."""
        return self.join(self.encode(observation), observation)

    def encode(self, observation: Observation) -> Tensor:
        """Encode the image as (B, ``encoder.width``) in autocast's dtype.

        While the encoder is frozen, you can keep this instead of the picture and pass it to :meth:`join` again and
        again.
        """
        encoded: Tensor = self.encoder(observation)
        return encoded

    def join(self, encoded: Tensor, observation: Observation) -> Tensor:
        """Return features (B, F) float32 from an encoding (B, ``encoder.width``), ``speed`` and ``steering``."""
        with _float32(encoded):
            measured = torch.cat([observation["speed"] / _SPEED, observation["steering"]], 1).float()
            return torch.cat([self.encoder.project(encoded.float()), self.measurements(measured)], 1)

    def forward(self, features: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean actions (B, 2) and values (B,) together, faster than :meth:`act` and :meth:`value`."""
        with _float32(features):
            both: tuple[Tensor, Tensor] = self.branches(features, command)
            return both

    def act(self, features: Tensor, command: Tensor) -> Tensor:
        """Return the commanded branch's mean actions (B, 2) for features (B, F) and commands (B, 1) or (B,)."""
        with _float32(features):
            return self.branches.act(features, command)

    def value(self, features: Tensor, command: Tensor) -> Tensor:
        """Return the commanded branch's values (B,)."""
        with _float32(features):
            return self.branches.estimate(features, command)

    def drive(self, observation: Observation) -> Tensor:
        """Return steer, throttle and brake (B, 3): the mean action, clipped, with accelerate as throttle or brake."""
        return controls(self.act(self.features(observation), observation["command"]))

    def segmentation_logits(self, observation: Observation) -> Tensor:
        """Return logits (B, 11, 64, 192) of each pixel's class, from ``rgb``.

        In training mode, batch normalisation learns its statistics here and nowhere else.
        """
        return self.encoder.segmentation_logits(observation)

    def segmentation_loss(self, observation: Observation, *, augment: bool = False) -> Tensor:
        """Return the mean cross-entropy of the observation's ``segmentation``; ``augment`` disturbs the image first."""
        logits = self.segmentation_logits(self.disturb(observation) if augment else observation)
        return functional.cross_entropy(logits, wanted(observation, "segmentation").long())

    def update_statistics(self, observation: Observation) -> None:
        """Update the batch normalisation of the driving path with one batch, without gradients.

        A ResNet that starts from nothing needs a few dozen of these before it drives. Without a segmentation loss it
        needs them all the time.
        """
        self.encoder.update_statistics(observation)


def build(
    algorithm: str,
    *,
    seed: int | None = None,
    masked_classes: float = 0.0,
    frozen: bool = True,
    activation: str = "tanh",
    projection: str = "elu",
) -> ActorCritic:
    """Build the networks of one of :data:`ALGORITHMS`, untrained, on the CPU, with channels last in memory.

    With a seed of the first weights, torch's own random state stays as it is. ``masked_classes`` is for
    ``ppo-segmentation``: the probability that a class is hidden when observations are disturbed. ``frozen`` is for
    ``ppo-image``: its ResNet learns segmentation unfrozen and drives frozen (``encoder.freeze(...)``).
    ``projection`` is the end of the layer behind a ResNet, one of ``encoders.PROJECTIONS``.
    """
    encoders: dict[str, Callable[[], Encoder]] = {
        "ppo-segmentation": lambda: SegmentationEncoder(masked_classes),
        "ppo-image": lambda: ImageEncoder(frozen=frozen, projection=projection),
        "ppo-auxiliary": lambda: AuxiliaryEncoder(projection=projection),
    }
    if algorithm not in encoders:
        raise ValueError(f"algorithm: {algorithm!r} is none of {', '.join(ALGORITHMS)}")
    with torch.random.fork_rng(devices=[], enabled=seed is not None):
        if seed is not None:
            torch.manual_seed(seed)
        model = ActorCritic(algorithm, encoders[algorithm](), activation=activation)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return model


def controls(action: Tensor) -> Tensor:
    """Turn the policy's (..., 2) into steer, throttle and brake (..., 3), clipped to their ranges."""
    steer, accelerate = action.clamp(-1.0, 1.0).unbind(-1)
    return torch.stack([steer, accelerate.clamp(min=0.0), (-accelerate).clamp(min=0.0)], -1)


@contextmanager
def _float32(like: Tensor) -> Iterator[None]:
    # Only within autocast, so that an exported graph does not contain it.
    device = like.device.type
    if torch.is_autocast_enabled(device):
        with torch.autocast(device, enabled=False):
            yield
    else:
        yield


class Homoscedastic(nn.Module):
    """The paper's equation 1, after Kendall et al., "Multi-task learning using uncertainty to weigh losses" (2017).

    l = exp(-sigma_rl) l_rl + sigma_rl + exp(-sigma_aux) l_aux + sigma_aux. Both sigmas are learned, from 0 on. A sigma
    falls without end while its loss is negative, which the policy's loss may be: clip the result, or keep the loss
    positive.
    """

    def __init__(self) -> None:
        super().__init__()
        self.sigma_rl = nn.Parameter(torch.zeros(()))
        self.sigma_aux = nn.Parameter(torch.zeros(()))

    def forward(self, rl: Tensor, auxiliary: Tensor) -> Tensor:
        """Join the reinforcement loss () and the auxiliary loss ()."""
        joined: Tensor = (
            (-self.sigma_rl).exp() * rl + self.sigma_rl + (-self.sigma_aux).exp() * auxiliary + self.sigma_aux
        )
        return joined
