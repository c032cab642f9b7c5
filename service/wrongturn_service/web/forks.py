"""What an episode's page says of the episode's forks."""

from collections.abc import Sequence
from typing import NamedTuple

from wrongturn_protocol import Outcome
from wrongturn_protocol.vehicle import DECISION_S
from wrongturn_protocol.vocabulary import Safety
from wrongturn_protocol.words import COMMANDS
from wrongturn_service.storage.finished import FinishedEpisode
from wrongturn_service.web.drives import Moment


class Forks(NamedTuple):
    """The forks of an episode."""

    all: Sequence[FinishedEpisode]
    """By the time of the other command."""
    shown: FinishedEpisode | None
    """The one that the page shows as a car."""
    no_return: Moment | None
    """The point of no return, as far as the forks tell it."""


def told(fork: FinishedEpisode) -> str:
    """Return in words what another command a fork had, and when."""
    other = fork.trial.fork
    if other is None:
        return ""
    command = "the right command" if other.command is None else f"“{COMMANDS[other.command]}”"
    return f"{command} from {other.decision * DECISION_S:.1f} s on"


def forks_of(outcome: Outcome, found: Sequence[FinishedEpisode], chosen: str | None) -> Forks:
    """Return what the forks of an episode with this outcome show; ``chosen`` is the id of one to show.

    Without it, the last one with the right command that ends safely is shown, or else the newest.
    """
    begins = {one.id: one.trial.fork.decision for one in found if one.trial.fork is not None}
    right = [one for one in found if one.trial.fork is not None and one.trial.fork.command is None]
    safe = [one for one in right if one.outcome.verdict.safety is Safety.SAFE]
    last = max(safe, key=lambda one: begins[one.id], default=None)
    shown = next((one for one in found if one.id == chosen), None) or last or (found[-1] if found else None)
    no_return = None
    later = [begins[one.id] for one in right if last is not None and begins[one.id] > begins[last.id]]
    if last is not None and later and outcome.verdict.safety is not Safety.SAFE:
        no_return = _moment(begins[last.id], min(later))
    return Forks(sorted(found, key=lambda one: begins[one.id]), shown, no_return)


def _moment(last: int, later: int) -> Moment:
    at, until = last * DECISION_S, later * DECISION_S
    if later == last + 1:
        said = "The point of no return: the right command still ends safely from here on, and 0.1 s later no more."
    else:
        said = f"The right command still ends safely from here on; the point of no return is before {until:.1f} s."
    return Moment(last, at, said)
