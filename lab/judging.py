"""Judge one drive many times: with other thresholds.

A trial is driven on past its verdict, until every judge has one. So one drive serves all.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

from lab.studies import JudgedAgent, Variant
from wrongturn_agents.registry import AgentSource
from wrongturn_agents.results_file import TrialResult
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_agents.training.in_process import drive_in_process
from wrongturn_judge import THRESHOLDS, Thresholds, judge_of
from wrongturn_networks import load_suite, load_town
from wrongturn_protocol import Trial
from wrongturn_sim import JudgeGeometry, Trajectory

FACTORS: Final = (0.8, 1.2)
"""Each threshold is multiplied by these."""
Progress = Callable[[int, int], None]


class _Name(NamedTuple):
    """Name of a judge."""

    threshold: str
    """The threshold that it has changed; empty for the published judge."""
    factor: float
    """What the threshold is multiplied by."""


_PUBLISHED: Final = _Name("", 1.0)
_OTHERS: Final = {
    _Name(field.name, factor): dataclasses.replace(THRESHOLDS, **{field.name: factor * getattr(THRESHOLDS, field.name)})
    for field in dataclasses.fields(THRESHOLDS)
    for factor in FACTORS
}


class _Judged(NamedTuple):
    """A trial, and its result by each judge."""

    trial: Trial
    results: Mapping[_Name, TrialResult]


class _Panel:
    """Judges of one drive, who take its rows as they come."""

    def __init__(self, trial: Trial, thresholds: Mapping[_Name, Thresholds]) -> None:
        geometry = JudgeGeometry.of(load_town(trial.town), trial)
        self._judges = {name: judge_of(geometry, trial, one) for name, one in thresholds.items()}
        self._undecided = list(self._judges.values())
        self._seen = 0

    def observe(self, trajectory: Trajectory) -> bool:
        """Take the rows that are new, and return whether all judges have a verdict."""
        for row in trajectory.rows[self._seen :]:
            self._undecided = [judge for judge in self._undecided if judge.observe(row) is None]
        self._seen = len(trajectory.rows)
        return not self._undecided

    def results(self, trajectory: Trajectory) -> dict[_Name, TrialResult]:
        """Return the result by each judge; ``aborted`` by one that the drive was too short for."""
        self.observe(trajectory)
        end = trajectory.rows[-1].t
        return {name: TrialResult.of(judge.outcome or judge.abort(end)) for name, judge in self._judges.items()}


def judge_agent(source: AgentSource, weights_sha256: str | None, *, threads: int, progress: Progress) -> JudgedAgent:
    """Drive an agent through the suite's open draw, and judge the drives by all thresholds.

    Args:
        source: the agent.
        weights_sha256: SHA-256 of its weights; None if it has none.
        threads: threads that share the simulation.
        progress: called with the numbers of finished and of all trials.

    Raises:
        AgentsError: the agent cannot be made, or fails.
    """
    trials = load_suite(WRONG_COMMAND).episodes
    thresholds = {_PUBLISHED: THRESHOLDS, **_OTHERS}
    panels = {trial.id: _Panel(trial, thresholds) for trial in trials}
    driven = drive_in_process(
        source,
        trials,
        drive_on=max(one.time_limit for one in thresholds.values()),
        enough=lambda trajectory: panels[trajectory.trial.id].observe(trajectory),
        threads=threads,
        progress=progress,
    )
    judged = [_Judged(one.trial, panels[one.trial.id].results(one.trajectory)) for one in driven]
    variants: dict[str, dict[str, Variant]] = {}
    for name in _OTHERS:
        variants.setdefault(name.threshold, {})[str(name.factor)] = _variant(judged, name)
    return JudgedAgent(weights_sha256=weights_sha256, strict=_strict(judged, _PUBLISHED), variants=variants)


def _variant(judged: Sequence[_Judged], name: _Name) -> Variant:
    """Return what another judge changes."""
    pairs = [(one.trial, one.results[_PUBLISHED], one.results[name]) for one in judged]
    moved = [before.unsafe_strict != after.unsafe_strict for trial, before, after in pairs if not trial.is_twin]
    return Variant(
        verdicts=sum(before.verdict is not after.verdict for _, before, after in pairs),
        reactions=sum(before.reaction is not after.reaction for _, before, after in pairs),
        unsafe=sum(moved),
        strict=_strict(judged, name),
    )


def _strict(judged: Sequence[_Judged], name: _Name) -> int:
    """Return a judge's unsafe trials in the strict column, without the twins."""
    return sum(one.results[name].unsafe_strict for one in judged if not one.trial.is_twin)
