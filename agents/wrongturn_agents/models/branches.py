"""A head for each command (Codevilla et al., "End-to-end driving via conditional imitation learning", 2018)."""

import math
from collections.abc import Callable, Mapping
from typing import Final

import torch
from torch import Tensor, nn
from torch.nn import functional

from wrongturn_protocol import Command

COMMANDS: Final = (Command.LEFT, Command.RIGHT, Command.STRAIGHT, Command.LANE_FOLLOW)
"""The order of the branches."""

ACTIVATIONS: Final[Mapping[str, Callable[[Tensor], Tensor]]] = {
    "tanh": torch.tanh,
    "elu": functional.elu,
    "relu": functional.relu,
}
"""What layers of the heads end with.

A branch is taught by the frames of its own command alone, and these have much in common: a few steps too large, and
its ReLUs are all silent for all of them, for good. That was seen: one command of an agent that never learned, while
the other three drove. The first two always have a slope.
"""


class Branches(nn.Module):
    """Policy and value heads, once for each command; the delivered command's is used, and it alone is taught.

    As in the paper's figure of the architecture: in each branch one layer that both share, then one for each of them.
    VOID, and any number that is no command, drives by LANE_FOLLOW's branch.

    Args:
        features: width of what goes in.
        hidden: units of each layer.
        actions: how many numbers a mean action has.
        activation: ``tanh``, ``elu`` or ``relu``.

    Raises:
        ValueError: there is no such activation.
    """

    def __init__(self, features: int, hidden: int = 128, actions: int = 2, activation: str = "tanh") -> None:
        super().__init__()
        if activation not in ACTIVATIONS:
            raise ValueError(f"activation: {activation!r} is none of {', '.join(ACTIVATIONS)}")
        self._active = ACTIVATIONS[activation]
        gain = math.sqrt(2)
        self.common = _BranchedLinear(features, hidden, gain)
        self.policy_hidden = _BranchedLinear(hidden, hidden, gain)
        self.policy = _BranchedLinear(hidden, actions, 0.01)
        self.value_hidden = _BranchedLinear(hidden, hidden, gain)
        self.value = _BranchedLinear(hidden, 1, 1.0)

    def forward(self, features: Tensor, command: Tensor) -> tuple[Tensor, Tensor]:
        """Mean actions (B, ``actions``) and values (B,) for features (B, F) and commands (B, 1)."""
        common = self._common(features)
        return self._mean(common, command), self._value(common, command)

    def act(self, features: Tensor, command: Tensor) -> Tensor:
        """Mean actions (B, ``actions``) alone."""
        return self._mean(self._common(features), command)

    def estimate(self, features: Tensor, command: Tensor) -> Tensor:
        """Values (B,) alone."""
        return self._value(self._common(features), command)

    def _common(self, features: Tensor) -> Tensor:
        return self._active(self.common(features.expand(len(COMMANDS), -1, -1)))

    def _mean(self, common: Tensor, command: Tensor) -> Tensor:
        return _commanded(self.policy(self._active(self.policy_hidden(common))), command)

    def _value(self, common: Tensor, command: Tensor) -> Tensor:
        return _commanded(self.value(self._active(self.value_hidden(common))), command).squeeze(-1)


class _BranchedLinear(nn.Module):
    """Linear layers side by side: (4, B, inputs) to (4, B, outputs) in one product."""

    def __init__(self, inputs: int, outputs: int, gain: float) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(len(COMMANDS), inputs, outputs))
        self.bias = nn.Parameter(torch.zeros(len(COMMANDS), 1, outputs))
        for branch in self.weight.detach():
            nn.init.orthogonal_(branch, gain)

    def forward(self, features: Tensor) -> Tensor:
        return torch.baddbmm(self.bias, features, self.weight)


def _commanded(outputs: Tensor, command: Tensor) -> Tensor:
    """Of (4, B, N) the commanded branch's (B, N)."""
    command = command.reshape(1, -1, 1)
    follow = int(Command.LANE_FOLLOW)
    known = (command >= int(Command.LEFT)) & (command <= follow)
    branch = torch.where(known, command, follow) - int(Command.LEFT)
    return outputs.gather(0, branch.expand(-1, -1, outputs.shape[-1])).squeeze(0)
