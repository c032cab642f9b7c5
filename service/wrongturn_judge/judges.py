"""The judges: they take the rows of one episode, at a junction or across the town, and decide its outcome."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Final

import numpy as np

from wrongturn_judge import decide, journey_kernels
from wrongturn_judge.compiling import words
from wrongturn_judge.errors import GeometryMismatchError, RowError
from wrongturn_judge.geometry import JourneyGeometry, JudgeGeometry
from wrongturn_judge.outcomes import conclude, conclude_journey
from wrongturn_judge.packing import CLOCK_TOLERANCE, Floats, numbers_of
from wrongturn_judge.thresholds import THRESHOLDS, Thresholds
from wrongturn_judge.trajectory import Row, Trajectory
from wrongturn_protocol import VEHICLE, Outcome, Trial, Vehicle

_NOBODY: Final = np.empty((0, 6))
_NO_REST: Final = np.empty(0)
_ROWS: Final = 1280
"""Rows of a history at first: 64 s of an episode."""


class EpisodeJudge(ABC):
    """The state of one episode's judgement, and its outcome once there is one."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial
        self._row = np.empty(words(decide.STATE))
        self._state: Any = self._row.view(decide.STATE)[0]
        decide.begin(self._row)
        self.outcome: Outcome | None = None
        """The outcome; None before there is a verdict."""
        self.ran_out = False
        """Whether the episode ended because its time ran out."""

    def observe(self, row: Row) -> Outcome | None:
        """Take the next row, and return the outcome at the row that decides it; None for rows before and after.

        Raises RowError if the row is not finite, or not later than the one before.
        """
        if self.outcome is not None:
            return None
        found = self._take(row, np.array(row.road_users, np.float64) if row.road_users else _NOBODY)
        if not found:
            return None  # so it is for nearly every row
        if found == decide.NOT_LATER:
            raise RowError(f"t: {row.t} s is not after the row before, {self._state.t} s; give the rows in order")
        if found < 0:
            raise RowError(f"row at t = {row.t} s: x, y, yaw, v or steering is not finite; give numbers")
        return self._close()

    def abort(self, t: float) -> Outcome:
        """End the episode because the agent gave up or stayed away.

        Returns:
            The outcome ``aborted`` at ``t``, or the earlier outcome of an episode that had ended.
        """
        if self.outcome is None:
            self._state.t, self._state.verdict = t, decide.ABORTED
            return self._close()
        return self.outcome

    def _close(self) -> Outcome:
        self.ran_out = bool(self._state.ran_out)
        self.outcome = self._conclude()
        return self.outcome

    @abstractmethod
    def _take(self, row: Row, users: Floats) -> int:
        """Give a row to the kernel, and return its result."""

    @abstractmethod
    def _conclude(self) -> Outcome:
        """Return the outcome, from the state."""


class Judge(EpisodeJudge):
    """Judges one episode at a junction, row by row. It needs neither SUMO nor a simulator.

    ``car`` is the body that is judged; the benchmark's by default.

    Raises GeometryMismatchError if the geometry's exits are not those of the junction type, or the trial is a journey.
    """

    def __init__(
        self, geometry: JudgeGeometry, trial: Trial, thresholds: Thresholds = THRESHOLDS, car: Vehicle = VEHICLE
    ) -> None:
        if trial.journey is not None:
            raise GeometryMismatchError(
                f"geometry: it is of one junction, but trial {trial.id} is a journey; take JourneyGeometry.of(town)"
            )
        if frozenset(geometry.exits) != trial.junction_type.exits:
            names = ", ".join(direction.name for direction in geometry.exits)
            raise GeometryMismatchError(
                f"geometry: it has the exits {names}, but trial {trial.id} is of type {trial.junction_type}; "
                "take it from JudgeGeometry.of(town, trial)"
            )
        super().__init__(trial)
        self.geometry = geometry
        self.thresholds = thresholds
        self._arrays = (*geometry.packed.arrays, numbers_of(thresholds, car=car))
        self._history = np.empty((_ROWS, words(decide.MOMENT)))
        self._route = int(trial.route)
        self._watch = trial.watch - CLOCK_TOLERANCE

    def _take(self, row: Row, users: Floats) -> int:
        t, x, y, yaw, v, steering, command, _, _, _, _, _ = row
        while True:
            found = decide.observe(
                *self._arrays, users, self._row, self._history, self._route, self._watch, t, x, y, yaw, v, steering,
                command,
            )  # fmt: skip
            if found != decide.FULL:
                return found
            self._history = np.concatenate([self._history, np.empty_like(self._history)])

    @property
    def seconds_more(self) -> float:
        """How many more seconds decide the episode, if the car drives on as it does or goes on standing."""
        state, limits = self._state, self.thresholds
        ends = [limits.time_limit, *([state.exit_t + self.trial.watch] if state.exit else [])]
        waits_since = self._history.view(decide.MOMENT)[state.wait, 0].t
        if state.zone <= decide.NEAR and state.t - waits_since >= limits.rest_time:
            ends.append(waits_since + limits.wait_time)
        return float(min(ends) - state.t)

    def _conclude(self) -> Outcome:
        return conclude(self._row, self.trial, self.geometry, self.thresholds)


class JourneyJudge(EpisodeJudge):
    """Judges one journey, row by row, as :class:`Judge` judges one junction.

    ``strict`` is for training: leaving the road or the lane, and standing, end the drive. Raises GeometryMismatchError
    if the trial is not a journey, or its goal is not in the town.
    """

    def __init__(
        self, geometry: JourneyGeometry, trial: Trial, thresholds: Thresholds = THRESHOLDS, *, strict: bool = False
    ) -> None:
        super().__init__(trial)
        self.geometry = geometry
        self.strict = strict
        self._arrays = (*geometry.packed.arrays, geometry.lanes, numbers_of(thresholds))
        terms = np.array(terms_of(geometry, trial, strict=strict))
        goal = trial.journey.goal if trial.journey is not None else None
        self._goal = (terms, geometry.rest(goal) if goal is not None else _NO_REST)

    def _take(self, row: Row, users: Floats) -> int:
        return journey_kernels.observe(*self._arrays, users, *self._goal, self._row, *row[:5])

    def _conclude(self) -> Outcome:
        return conclude_journey(self._row, self.trial)


def terms_of(geometry: JourneyGeometry, trial: Trial, *, strict: bool) -> tuple[float, float, float, float]:
    """Return what ends a journey, as ``journey_kernels.TERMS``. Raises GeometryMismatchError as JourneyJudge."""
    journey = trial.journey
    if journey is None:
        raise GeometryMismatchError(f"trial {trial.id} is not a journey; judge it by JudgeGeometry.of(town, trial)")
    goal = -1
    if journey.goal is not None:
        found = geometry.rows.get(journey.goal)
        if found is None or journey.goal_at > geometry.town.lanes[journey.goal].length:
            raise GeometryMismatchError(
                f"journey.goal: {geometry.town.name} has no lane {journey.goal} with a place {journey.goal_at:.1f} m "
                "along it; take a trial of this town"
            )
        goal = found
    return journey.time_limit - CLOCK_TOLERANCE, float(goal), journey.goal_at, float(strict)


def judge_of(
    geometry: JudgeGeometry | JourneyGeometry,
    trial: Trial,
    thresholds: Thresholds = THRESHOLDS,
    *,
    strict: bool = False,
) -> Judge | JourneyJudge:
    """Return the judge for a geometry. Raises GeometryMismatchError if it does not belong to the trial."""
    if isinstance(geometry, JourneyGeometry):
        return JourneyJudge(geometry, trial, thresholds, strict=strict)
    return Judge(geometry, trial, thresholds)


def judge(
    trajectory: Trajectory, geometry: JudgeGeometry | JourneyGeometry, thresholds: Thresholds = THRESHOLDS
) -> Outcome:
    """Return the outcome of a recorded episode at the first row that decides it.

    A record that goes on after that row has the same outcome; one that ends before it is ``aborted``.

    Raises:
        GeometryMismatchError: the geometry belongs to another town, or its exits are not the trial's.
        RowError: a row is not finite, or the rows are not in order.
    """
    if geometry.town_sha256 not in {None, trajectory.town_sha256}:
        raise GeometryMismatchError(
            f"trajectory.town_sha256: {trajectory.town_sha256} is not the geometry's town, {geometry.town_sha256}; "
            "judge it with the town that it was driven in"
        )
    its_judge = judge_of(geometry, trajectory.trial, thresholds)
    for row in trajectory.rows:
        outcome = its_judge.observe(row)
        if outcome is not None:
            return outcome
    return its_judge.abort(trajectory.rows[-1].t if trajectory.rows else 0.0)
