"""Faults: what happens to the command between the route and the agent. Each fault is one file.

:mod:`wrongturn_networks.disturbances` has faults of another sort, which leave the command right.

A fault's class, a subclass of :class:`~wrongturn_networks.faults.fault.CommandFault`, says everything about it: its
kind, which trials it can be applied to, the command that it delivers, the reactions to it and its words. Suites,
environments, judge, metrics and pages ask the class. Put its file into this folder, or name the class by an entry point
in the group ``wrongturn.faults``. ``docs/extending.md`` shows both.
"""

import functools
import importlib
import pkgutil
from typing import Any, Final

from wrongturn_faults.rules import Guidance as Guidance
from wrongturn_faults.rules import Passage as Passage
from wrongturn_networks import disturbances
from wrongturn_networks.errors import FaultNotApplicableError as FaultNotApplicableError
from wrongturn_networks.errors import NetworkError
from wrongturn_networks.faults.fault import CommandFault as CommandFault
from wrongturn_networks.faults.fault import Dose as Dose
from wrongturn_networks.faults.fault import Ending as Ending
from wrongturn_networks.faults.fault import WrongDirection as WrongDirection
from wrongturn_networks.shelf import take_installed
from wrongturn_networks.starts import draw_trial
from wrongturn_networks.town import Town
from wrongturn_protocol import Command, FaultKind, Reaction, Trial

GROUP: Final = "wrongturn.faults"
"""Entry-point group of faults from other packages: each names a subclass of :class:`CommandFault`."""


class _Registry:
    """All faults, those of this folder first. Each process reads them once."""

    def __init__(self) -> None:
        self.built: dict[FaultKind, type[CommandFault]] = {}
        for package in (__name__, disturbances.__name__):
            for module in pkgutil.iter_modules(importlib.import_module(package).__path__):
                of = importlib.import_module(f"{package}.{module.name}")
                here = [one for one in vars(of).values() if getattr(one, "__module__", "") == of.__name__]
                self.built |= {one.kind: one for one in here if isinstance(one, type) and hasattr(one, "kind")}
        self.left_out = take_installed(GROUP, self._take)

    def _take(self, name: str, fault: Any) -> None:
        if not (isinstance(fault, type) and issubclass(fault, CommandFault)):
            raise TypeError("is no subclass of CommandFault")
        missing = [one for one in ("kind", "guide_word", "words") if not hasattr(fault, one)]
        missing += sorted(getattr(fault, "__abstractmethods__", ()))
        missing += ["deliver"] if fault.deliver is CommandFault.deliver else []
        if missing:
            raise TypeError(f"has no {' and no '.join(missing)}; see CommandFault")
        if name not in tuple(FaultKind) or fault.kind != name:
            raise ValueError(f"is of the kind {fault.kind}; an entry point has the name of its kind, one of FaultKind")
        if strange := sorted(set(fault.reactions) - set(Reaction)):
            raise ValueError(f"reactions: {strange[0]!r} is none of Reaction")
        if fault.kind in self.built:
            raise ValueError(f"there is another {name}; remove one of the two packages")
        self.built[fault.kind] = fault


@functools.cache
def _registry() -> _Registry:
    return _Registry()


def left_out_faults() -> dict[str, str]:
    """Return why faults of other packages cannot be used, by the names of their entry points."""
    return _registry().left_out


def available_faults() -> tuple[FaultKind, ...]:
    """Return the kinds that are built, in the vocabulary's order."""
    return tuple(kind for kind in FaultKind if kind in _registry().built)


def fault_class(kind: FaultKind) -> type[CommandFault]:
    """Return the class of a fault. Raises FaultNotApplicableError for a kind that is not installed."""
    if kind not in _registry().built:
        built = ", ".join(available_faults())
        raise FaultNotApplicableError(f"fault.kind: {kind} is not installed; take one of {built}")
    return _registry().built[kind]


def find_fault(kind: FaultKind) -> type[CommandFault] | None:
    """Return the class of a fault; None for one that is not built, or whose package is no longer installed."""
    return _registry().built.get(kind)


def check_fault(trial: Trial) -> None:
    """Check that a trial's fault can be applied to it. Raises FaultNotApplicableError, which says why it cannot."""
    fault, built = trial.fault, fault_class(trial.fault.kind)
    for name, dose, value in (("dose", built.dose, fault.dose), ("period", built.period, fault.period)):
        if value is not None and dose is None:
            raise FaultNotApplicableError(f"fault.{name}: {fault.kind} has none; leave it out")
        wrong = dose.refusal(name, value) if dose is not None else None
        if wrong is not None:
            raise FaultNotApplicableError(wrong)
    refusal = built.refusal(trial)
    if refusal is not None:
        raise FaultNotApplicableError(f"fault.kind: {fault.kind} {refusal}")


def make_fault(trial: Trial) -> CommandFault:
    """Return a trial's fault, ready for one episode. Raises as :func:`check_fault`."""
    check_fault(trial)
    return fault_class(trial.fault.kind)(trial)


def closed_exit(trial: Trial) -> Command | None:
    """Return the exit whose street a trial's fault closes by boards; None for none."""
    built = find_fault(trial.fault.kind)
    return built.closed(trial) if built is not None else None


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
