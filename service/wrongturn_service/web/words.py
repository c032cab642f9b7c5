"""Words for people: what verdicts, reactions, faults and junction types mean, and how a trial ended."""

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from typing import Final

from wrongturn_networks.faults import find_fault
from wrongturn_protocol import Command, Fault, FaultKind, Flag, JunctionType, Outcome, Reaction, Safety, Trial, Verdict
from wrongturn_protocol.standing_rows import INTERVALS, LEVEL_HEADS
from wrongturn_protocol.words import COMMANDS, EXITS, ending, name

_TABLES: Final = tomllib.loads((files("wrongturn_service.web") / "words.toml").read_text("utf-8"))
VERDICTS: Final = {Verdict(one): meaning for one, meaning in _TABLES["verdicts"].items()}
FLAGS: Final = {Flag(one): meaning for one, meaning in _TABLES["flags"].items()}
REACTIONS: Final = {Reaction(one): meaning for one, meaning in _TABLES["reactions"].items()}
JUNCTION_TYPES: Final = {JunctionType(one): meaning for one, meaning in _TABLES["junction_types"].items()}

__all__ = ["COMMANDS", "EXITS", "INTERVALS", "LEVEL_HEADS", "ending", "name"]
_TURNS: Final = {Command.LEFT: "turned left", Command.RIGHT: "turned right", Command.STRAIGHT: "went straight on"}
_AS: Final = {
    Verdict.EXIT_COMMANDED: "as the command said",
    Verdict.EXIT_ROUTE: "as its route goes",
    Verdict.EXIT_OTHER: "which neither the command nor the route named",
}

SIDES: Final[Mapping[Safety, str]] = {Safety.SAFE: "safe", Safety.UNSAFE: "unsafe", Safety.NEITHER: "neither"}
"""What an outcome counts as. The words are also classes of the style sheet."""


def side(outcome: Outcome) -> Safety:
    """Return what an outcome counts as in the strict column, which ranks."""
    return Safety.UNSAFE if outcome.unsafe_strict else outcome.verdict.safety


def counted(outcome: Outcome) -> str:
    """Return what an outcome counts as, in both columns."""
    if outcome.unsafe_strict and not outcome.verdict.unsafe:
        return "unsafe in the strict column only"
    return SIDES[side(outcome)]


def told(trial: Trial) -> str:
    """Return what the agent was told at the junction, as a sentence."""
    if trial.journey is not None:
        return "The command always named the way to the goal."
    built = find_fault(trial.fault.kind)
    return fault(trial.fault.kind) if built is None else built.told(trial, COMMANDS.__getitem__)


def fault(kind: str, given: Fault | None = None) -> str:
    """Return what a fault does to the command, and the given dose; its name for one that is not built."""
    built = find_fault(FaultKind(kind)) if kind in set(FaultKind) else None
    if built is None:
        return f"The fault {name(kind)}."
    return built.words + (built.measured(given) if given is not None and given.dose is not None else "")


def ended(outcome: Outcome) -> str:
    """Return how an episode ended, as one or more sentences."""
    verdict = outcome.verdict
    sentences = [VERDICTS[verdict]]
    if outcome.exit is not None and verdict.exited:
        sentences = [f"The car {_TURNS[outcome.exit]}, {_AS[verdict]}."]
    if not verdict.unsafe_strict:
        sentences += [FLAGS[flag] for flag in outcome.flags if flag in FLAGS]
    if verdict not in {Verdict.ABORTED, Verdict.INVALID}:
        sentences.append(f"Verdict after {outcome.time:.1f} s.")
    return " ".join(sentences)
