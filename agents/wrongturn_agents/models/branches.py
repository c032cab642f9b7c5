"""A head for each command (Codevilla et al., "End-to-end driving via conditional imitation learning", 2018)."""

import math
from collections.abc import Callable, Mapping
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from wrongturn_protocol import Command

COMMANDS: Final = (Command.LEFT, Command.RIGHT, Command.STRAIGHT, Command.LANE_FOLLOW)
"""Order of the branches."""

ACTIVATIONS: Final[Mapping[str, Callable[[Tensor], Tensor]]] = {
    "tanh": torch.tanh,
    "elu": functional.elu,
    "relu": functional.relu,
}
"""Activations of the heads' layers.

A branch learns only from the frames of its own command, which resemble each other. After a few large steps, all its
ReLUs can be silent for all of them, for good: one agent never learned one command while the other three drove. The
first two activations always have a slope.
"""


class Branches(nn.Module):
    """Policy and value heads, one pair for each command. Only the delivered command's pair is used and trained.

    As in the paper's figure, each branch has one layer that both heads share, then one layer for each head. VOID, and
    any number that is no command, uses LANE_FOLLOW's branch.

    Args:
        hidden: units of each layer.
        activation: ``tanh``, ``elu`` or ``relu``.
    """

    def __init__(self, features: int, hidden: int = 128, actions: int = 2, activation: str = "tanh") -> None:
        super().__init__()
        self._active = ACTIVATIONS[activation]
        gain = math.sqrt(2)
        self.common = _BranchedLinear(features, hidden, gain)
        self.policy_hidden = _BranchedLinear(hidden, hidden, gain)
        self.policy = _BranchedLinear(hidden, actions, 0.01)
        self.value_hidden = _BranchedLinear(hidden, hidden, gain)
        self.value = _BranchedLinear(hidden, 1, 1.0)

    def forward(self, features: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean actions (B, ``actions``) and values (B,) for features (B, F) and commands (B, 1)."""
        common = self._common(features)
        return self._mean(common, command), self._value(common, command)

    def act(self, features: Tensor, command: Tensor) -> Tensor:
        """Return only the mean actions (B, ``actions``)."""
        return self._mean(self._common(features), command)

    def estimate(self, features: Tensor, command: Tensor) -> Tensor:
        """Return only the values (B,)."""
        return self._value(self._common(features), command)

    def _common(self, features: Tensor) -> Tensor:
        return self._active(self.common(features.expand(len(COMMANDS), -1, -1)))

    def _mean(self, common: Tensor, command: Tensor) -> Tensor:
        return _commanded(self.policy(self._active(self.policy_hidden(common))), command)

    def _value(self, common: Tensor, command: Tensor) -> Tensor:
        return _commanded(self.value(self._active(self.value_hidden(common))), command).squeeze(-1)


class _BranchedLinear(nn.Module):
    """Four linear layers side by side: (4, B, inputs) to (4, B, outputs) in one product."""

    def __init__(self, inputs: int, outputs: int, gain: float) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(len(COMMANDS), inputs, outputs))
        self.bias = nn.Parameter(torch.zeros(len(COMMANDS), 1, outputs))
        for branch in self.weight.detach():
            nn.init.orthogonal_(branch, gain)

    def forward(self, features: Tensor) -> Tensor:
        return torch.baddbmm(self.bias, features, self.weight)


def branch_of(command: Tensor) -> Tensor:
    """Return each command's place in :data:`COMMANDS` (B,); VOID, and any number that is no command, has the last."""
    command = command.reshape(-1)
    follow = int(Command.LANE_FOLLOW)
    known = (command >= int(Command.LEFT)) & (command <= follow)
    return torch.where(known, command, follow) - int(Command.LEFT)


def _commanded(outputs: Tensor, command: Tensor) -> Tensor:
    """Select the commanded branch's (B, N) of (4, B, N)."""
    branch = branch_of(command).view(1, -1, 1)
    return outputs.gather(0, branch.expand(-1, -1, outputs.shape[-1])).squeeze(0)
