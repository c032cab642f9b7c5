"""Linear layers with learned noise, for exploration, with a head for each command.

Fortunato et al., "Noisy networks for exploration" (ICLR 2018), with factorised Gaussian noise.
"""

import math

import torch
from torch import Tensor, nn

from wrongturn_agents.models.branches import COMMANDS


class NoisyBranches(nn.Module):
    """Four linear layers side by side, one for each command: (B, N, inputs) and commands to (B, N, outputs).

    Each row of a batch has its own noise: w + s * (a x b), with a of the inputs and b of the outputs.

    Args:
        deviation: first deviation of the noise, times the square root of ``inputs``.
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
        """Return the outputs of each row's branch.

        Args:
            features: (B, N, inputs).
            branch: (B,) int64, the row's place in :data:`COMMANDS`.
            noise: (B, inputs + outputs) of :func:`draw_noise`; None for the mean weights.
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
