"""Quantiles of the values of actions (Dabney et al., "Implicit quantile networks", 2018), dueling, per command."""

import math
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from wrongturn_agents.models.branches import COMMANDS, branch_of

_COSINES: Final = 64
"""Cosines that a quantile's share is told by; n of the paper's equation 4."""


class NoisyBranches(nn.Module):
    """Four noisy linear layers side by side, one for each command: (B, N, inputs) and commands to (B, N, outputs).

    Fortunato et al., "Noisy networks for exploration" (ICLR 2018), with factorised Gaussian noise. Each row of a batch
    has its own: w + s * (a x b), with a of the inputs and b of the outputs. ``deviation`` is the first one of the
    noise, times the square root of ``inputs``.
    """

    def __init__(self, inputs: int, outputs: int, deviation: float) -> None:
        super().__init__()
        bound = 1.0 / math.sqrt(inputs)
        self.inputs, self.outputs = inputs, outputs
        self.weight = nn.Parameter(torch.empty(len(COMMANDS), inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(len(COMMANDS), 1, outputs).uniform_(-bound, bound))
        self.weight_deviation = nn.Parameter(torch.full_like(self.weight, deviation * bound))
        self.bias_deviation = nn.Parameter(torch.full_like(self.bias, deviation * bound))

    @property
    def noise_width(self) -> int:
        """Random numbers that a row needs."""
        return self.inputs + self.outputs

    def forward(self, features: Tensor, branch: Tensor, noise: Tensor | None) -> Tensor:
        """Return the outputs of each row's branch, (B,) int64, its place in :data:`COMMANDS`, for (B, N, inputs).

        The noise is (B, inputs + outputs) of :func:`draw_noise`; None for the mean weights.
        """
        steady = self._branch(features, self.weight, self.bias, branch)
        if noise is None:
            return steady
        of_inputs, of_outputs = noise[:, None, : self.inputs], noise[:, None, self.inputs :]
        return steady + of_outputs * self._branch(
            features * of_inputs, self.weight_deviation, self.bias_deviation, branch
        )

    def _branch(self, features: Tensor, weight: Tensor, bias: Tensor, branch: Tensor) -> Tensor:
        rows, count, _ = features.shape
        flat = features.reshape(1, rows * count, self.inputs).expand(len(COMMANDS), -1, -1)
        every = torch.baddbmm(bias, flat, weight).view(len(COMMANDS), rows, count, self.outputs)
        chosen = branch.view(1, -1, 1, 1).expand(1, -1, count, self.outputs)
        return every.gather(0, chosen).squeeze(0)


def draw_noise(rows: int, width: int, device: torch.device, generator: torch.Generator | None = None) -> Tensor:
    """Return factorised noise (rows, width): sign(e) * sqrt(abs(e)) of normal random numbers e."""
    drawn = torch.randn(rows, width, device=device, generator=generator)
    return drawn.sign() * drawn.abs().sqrt()


class QuantileHeads(nn.Module):
    """From features and shares of the return's distribution to the quantile of each action, with a head per command.

    Each stream has ``hidden`` units; ``deviation`` is the first one of the noise.
    """

    cosines: Tensor

    def __init__(self, features: int, actions: int, *, hidden: int = 256, deviation: float = 0.1) -> None:
        super().__init__()
        self.embedding = nn.Linear(_COSINES, features)
        self.hidden = NoisyBranches(features, 2 * hidden, deviation)
        self.value = NoisyBranches(hidden, 1, deviation)
        self.advantage = NoisyBranches(hidden, actions, deviation)
        self.register_buffer("cosines", math.pi * torch.arange(_COSINES, dtype=torch.float32), persistent=False)

    @property
    def noise_width(self) -> int:
        """Random numbers that a row needs."""
        return sum(layer.noise_width for layer in (self.hidden, self.value, self.advantage))

    def draw_noise(self, rows: int, generator: torch.Generator | None = None) -> Tensor:
        """Return noise for a batch, (rows, ``noise_width``)."""
        return draw_noise(rows, self.noise_width, self.cosines.device, generator)

    def forward(self, features: Tensor, command: Tensor, shares: Tensor, noise: Tensor | None = None) -> Tensor:
        """Return the quantiles (B, N, actions) of the commanded heads, for features (B, F) and commands (B, 1) or (B,).

        Shares, (B, N) or (1, N) in [0, 1], say which quantiles. Noise is (B, ``noise_width``); None drives by the mean
        weights.
        """
        branch = branch_of(command)
        of_hidden = of_value = of_advantage = None
        if noise is not None:
            widths = [layer.noise_width for layer in (self.hidden, self.value, self.advantage)]
            of_hidden, of_value, of_advantage = torch.split(noise, widths, 1)
        told = self.embedding((shares.unsqueeze(-1) * self.cosines).cos()).relu()
        hidden = self.hidden(features.unsqueeze(1) * told, branch, of_hidden).relu()
        of_state, of_action = hidden.chunk(2, -1)
        value = self.value(of_state, branch, of_value)
        advantage = self.advantage(of_action, branch, of_advantage)
        quantiles: Tensor = value + advantage - advantage.mean(-1, keepdim=True)
        return quantiles


def quantile_huber(found: Tensor, wanted: Tensor, shares: Tensor, kappa: float = 1.0) -> Tensor:
    """Return each row's quantile regression loss (B,): summed over its quantiles, averaged over the targets.

    It is of quantiles (B, N) of the action that was taken, at shares (B, N) in [0, 1], against samples (B, M) of the
    target. Errors up to kappa count by their square.
    """
    error = wanted.unsqueeze(1) - found.unsqueeze(2)
    size = functional.huber_loss(error, torch.zeros_like(error), reduction="none", delta=kappa) / kappa
    weight = (shares.unsqueeze(2) - (error.detach() < 0.0).to(error.dtype)).abs()
    return (weight * size).mean(2).sum(1)
