"""Command faults: what is done to the command between the route and the agent. One file a fault.

A new fault is one file in this package: a subclass of :class:`~wrongturn_sim.faults.fault.CommandFault` that names
its kind. It is found by being there.
"""

import importlib
import pkgutil

from wrongturn_protocol import FaultKind, Trial
from wrongturn_sim.faults.fault import CommandFault, FaultNotApplicableError

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")

_REGISTRY: dict[FaultKind, type[CommandFault]] = {fault.kind: fault for fault in CommandFault.__subclasses__()}


def available_faults() -> tuple[FaultKind, ...]:
    """The kinds that this version can do, in the vocabulary's order."""
    return tuple(kind for kind in FaultKind if kind in _REGISTRY)


def make_fault(trial: Trial) -> CommandFault:
    """A trial's fault, ready for one episode.

    Raises:
        FaultNotApplicableError: this version has no such fault, or the approach does not admit it.
    """
    found = _REGISTRY.get(trial.fault.kind)
    if found is None:
        raise FaultNotApplicableError(
            f"fault.kind: {trial.fault.kind} is not available yet; take one of {', '.join(available_faults())}",
        )
    return found(trial)


__all__ = ["CommandFault", "FaultNotApplicableError", "available_faults", "make_fault"]
