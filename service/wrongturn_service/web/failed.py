"""The failed trial that the first page shows."""

from collections.abc import Iterable
from typing import Final, NamedTuple

from wrongturn_protocol import AgentKind, FaultKind
from wrongturn_service.service import Service
from wrongturn_service.web import words
from wrongturn_service.web.driven import driven_evaluation
from wrongturn_service.web.junction_map import Ground, ground

_KINDS: Final = (AgentKind.REFERENCE, AgentKind.SUBMITTED, AgentKind.BASELINE)
_PAUSE_S: Final = 2.0
"""How long the car rests at the end before the loop begins again."""


class FailedTrial(NamedTuple):
    """An unsafe trial, drawn on a junction map."""

    agent: str
    episode: str
    ground: Ground
    d: str
    """Path of the car's centre, as SVG writes it."""
    end: tuple[float, float]
    seconds: float
    """Length of the loop."""
    title: str
    """What the agent was told and did, in words."""


async def failed_trial(service: Service, suites: Iterable[str]) -> FailedTrial | None:
    """Return an unsafe trial of the first of the suites that has one: of a trained agent, if one was unsafe."""
    for suite in suites:
        board = await service.leaderboards.board(suite)
        unsafe = [
            one for one in board.entries if one.evaluation and one.unsafe_strict.count and one.agent.kind in _KINDS
        ]
        for entry in sorted(unsafe, key=lambda one: _KINDS.index(one.agent.kind)):
            driven = await driven_evaluation(service, str(entry.evaluation))
            paths = {path.episode: path for drawn in driven.maps for path in drawn.paths}
            for trial, _ in sorted(driven.pairs, key=lambda pair: pair.trial.trial.fault.kind is FaultKind.OMISSION):
                path = paths.get(trial.id)
                if path is not None and trial.outcome.verdict.unsafe:
                    told = f"{words.told(trial.trial)} {words.ended(trial.outcome)}"
                    place = ground(frozenset({(trial.trial.town, trial.trial.approach)}))
                    seconds = round(trial.outcome.time + _PAUSE_S, 1)
                    return FailedTrial(entry.agent.name, trial.id, place, path.d, path.end, seconds, told)
    return None
