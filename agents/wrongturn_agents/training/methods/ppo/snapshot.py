"""A copy of the state before an update, so that the update can be undone."""

from typing import Any

import torch
from torch import Tensor, nn


class Snapshot:
    """A copy of a module's weights and statistics, and of its optimiser's state, on the device.

    Its memory is allocated once. Weights that are never trained are not copied.
    """

    def __init__(self, module: nn.Module, optimizer: torch.optim.Optimizer) -> None:
        self._optimizer = optimizer
        self._live = [parameter.data for parameter in module.parameters() if parameter.requires_grad]
        self._live += list(module.buffers())
        self._kept = [tensor.clone() for tensor in self._live]
        self._moments: dict[Any, dict[str, Any]] = {}
        self.take()

    @torch.no_grad()
    def take(self) -> None:
        """Copy the current state."""
        for kept, live in zip(self._kept, self._live, strict=True):
            kept.copy_(live)
        state = self._optimizer.state
        for parameter in [known for known in self._moments if known not in state]:
            del self._moments[parameter]
        for parameter, values in state.items():
            _put(values, self._moments.setdefault(parameter, {}))

    @torch.no_grad()
    def restore(self) -> None:
        """Put the last copied state back."""
        for kept, live in zip(self._kept, self._live, strict=True):
            live.copy_(kept)
        state = self._optimizer.state
        for parameter in [known for known in state if known not in self._moments]:
            del state[parameter]  # its first step came after the copy
        for parameter, values in self._moments.items():
            _put(values, state[parameter])


def _put(values: dict[str, Any], there: dict[str, Any]) -> None:
    for name, value in values.items():
        if not isinstance(value, Tensor):
            there[name] = value
        elif name in there:
            there[name].copy_(value)
        else:
            there[name] = value.clone()
