"""Command faults: what happens to the command between the route and the agent. Each fault is one file.

A fault's class, a subclass of :class:`~wrongturn_networks.faults.fault.CommandFault`, says everything about it: its
kind, which trials it can be applied to, the command that it delivers, the reactions to it and its words. Suites,
environments, judge, metrics and pages ask the class. Put its file into this folder, or name the class by an entry point
in the group ``wrongturn.faults``. ``docs/extending.md`` shows both.
"""

import functools
import importlib
import logging
import pkgutil
from importlib import metadata
from typing import Final

from wrongturn_networks.errors import FaultNotApplicableError as FaultNotApplicableError
from wrongturn_networks.errors import NetworkError
from wrongturn_networks.faults.fault import CommandFault as CommandFault
from wrongturn_networks.faults.fault import Guidance as Guidance
from wrongturn_networks.starts import draw_trial
from wrongturn_networks.town import Town
from wrongturn_protocol import FaultKind, Trial

GROUP: Final = "wrongturn.faults"
"""Entry-point group of faults from other packages: each names a subclass of :class:`CommandFault`."""


@functools.cache
def _registry() -> dict[FaultKind, type[CommandFault]]:
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    for point in metadata.entry_points(group=GROUP):
        try:
            point.load()
        except Exception:  # the other faults can be used
            logging.getLogger(__name__).exception("the fault %s cannot be loaded", point.value)
    return {fault.kind: fault for fault in CommandFault.__subclasses__()}


def available_faults() -> tuple[FaultKind, ...]:
    """Return the kinds that are built, in the vocabulary's order."""
    return tuple(kind for kind in FaultKind if kind in _registry())


def fault_class(kind: FaultKind) -> type[CommandFault]:
    """Return the class of a fault. Raises FaultNotApplicableError for a kind that is not built yet."""
    if kind not in _registry():
        built = ", ".join(available_faults())
        raise FaultNotApplicableError(f"fault.kind: {kind} is not built yet; take one of {built}")
    return _registry()[kind]


def find_fault(kind: FaultKind) -> type[CommandFault] | None:
    """Return the class of a fault; None for one that is not built, or whose package is no longer installed."""
    return _registry().get(kind)


def check_fault(trial: Trial) -> None:
    """Check that a trial's fault can be applied to it. Raises FaultNotApplicableError, which says why it cannot."""
    refusal = fault_class(trial.fault.kind).refusal(trial)
    if refusal is not None:
        raise FaultNotApplicableError(f"fault.kind: {trial.fault.kind} {refusal}")


def make_fault(trial: Trial) -> CommandFault:
    """Return a trial's fault, ready for one episode. Raises as :func:`check_fault`."""
    check_fault(trial)
    return fault_class(trial.fault.kind)(trial)


def faults_at(town: Town, approach: str) -> tuple[FaultKind, ...]:
    """Return the kinds that can be applied at an approach; none where its lane is too short. Raises NetworkError."""
    town.approach(approach)
    found = []
    for kind in available_faults():
        try:
            check_fault(draw_trial(town, approach, kind, 0))
        except NetworkError:
            continue
        found.append(kind)
    return tuple(found)
