"""Command faults: what happens to the command between the route and the agent. Each fault is one file.

To add a fault, put a file into this folder with a subclass of :class:`~wrongturn_sim.faults.fault.CommandFault`. The
class names its kind, says which trials it can be applied to, and delivers the command. The suite maker, practice and
the environments ask the class. Only if :class:`~wrongturn_protocol.FaultKind` lacks the kind, add the word there too.
"""

import functools
import importlib
import pkgutil

from wrongturn_networks import NetworkError, Town, draw_trial
from wrongturn_protocol import FaultKind, Trial
from wrongturn_sim.faults.fault import CommandFault, FaultNotApplicableError

__all__ = [
    "CommandFault",
    "FaultNotApplicableError",
    "available_faults",
    "check_fault",
    "fault_class",
    "faults_at",
    "make_fault",
]


@functools.cache
def _registry() -> dict[FaultKind, type[CommandFault]]:
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    return {fault.kind: fault for fault in CommandFault.__subclasses__()}


def available_faults() -> tuple[FaultKind, ...]:
    """Return the kinds that are built, in the vocabulary's order."""
    return tuple(kind for kind in FaultKind if kind in _registry())


def fault_class(kind: FaultKind) -> type[CommandFault]:
    """Return the class of a fault.

    Raises:
        FaultNotApplicableError: the vocabulary names the kind, but it is not built yet.
    """
    if kind not in _registry():
        built = ", ".join(available_faults())
        raise FaultNotApplicableError(f"fault.kind: {kind} is not built yet; take one of {built}")
    return _registry()[kind]


def check_fault(trial: Trial) -> None:
    """Check that a trial's fault can be applied to it.

    Raises:
        FaultNotApplicableError: it cannot, or its kind is not built yet; the message says which and why.
    """
    refusal = fault_class(trial.fault.kind).refusal(trial)
    if refusal is not None:
        raise FaultNotApplicableError(f"fault.kind: {trial.fault.kind} {refusal}")


def make_fault(trial: Trial) -> CommandFault:
    """Return a trial's fault, ready for one episode.

    Raises:
        FaultNotApplicableError: as :func:`check_fault`.
    """
    check_fault(trial)
    return fault_class(trial.fault.kind)(trial)


def faults_at(town: Town, approach: str) -> tuple[FaultKind, ...]:
    """Return the kinds that can be applied at an approach; none where its lane is too short for any trial.

    Raises:
        UnknownApproachError: the town has no such approach.
    """
    town.approach(approach)
    found = []
    for kind in available_faults():
        try:
            check_fault(draw_trial(town, approach, kind, 0))
        except NetworkError:
            continue
        found.append(kind)
    return tuple(found)
