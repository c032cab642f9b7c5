"""The failed trial that the first page shows."""

import re
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np

from wrongturn_protocol import AgentKind, FaultKind
from wrongturn_service.service import Service
from wrongturn_service.web import words
from wrongturn_service.web.driven import driven_evaluation
from wrongturn_service.web.junction_map import BOTTOM, Ground, ground

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
    begin: float
    """Share of the path's length that lies below the map. The loop begins there."""
    seconds: float
    """Length of the loop."""
    driven: float
    """Share of the loop in which the car drives. Then it rests."""
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
                    begin = _below(path.d)
                    drive = trial.outcome.time * (1 - begin)
                    loop = (begin, round(drive + _PAUSE_S, 1), round(drive / (drive + _PAUSE_S), 3))
                    return FailedTrial(entry.agent.name, trial.id, place, path.d, path.end, *loop, told)
    return None


def _below(d: str) -> float:
    """Return the share of a path's length that lies before its first point on the map."""
    points = np.array(re.findall(r"-?[\d.]+", d), float).reshape(-1, 2)
    length = np.concatenate(([0.0], np.hypot(*np.diff(points, axis=0).T).cumsum()))
    on_map = int(np.argmax(points[:, 1] <= BOTTOM))
    return round(float(length[on_map] / max(length[-1], 1e-6)), 3)
