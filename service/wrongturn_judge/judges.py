"""The judge: it takes the rows of one episode and decides its outcome."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge import decide
from wrongturn_judge.errors import GeometryMismatchError
from wrongturn_judge.geometry import JudgeGeometry
from wrongturn_judge.journey import JourneyJudge
from wrongturn_judge.journey_geometry import JourneyGeometry
from wrongturn_judge.junction_judge import JunctionJudge, Zone, outcome_fields
from wrongturn_judge.packing import Floats, numbers_of
from wrongturn_judge.thresholds import THRESHOLDS, SharedThresholds, Thresholds, Thresholds1
from wrongturn_judge.version_1 import Judge1
from wrongturn_protocol import VEHICLE, Outcome, Trial, Vehicle

if TYPE_CHECKING:
    from wrongturn_judge.trajectory import Row, Trajectory

__all__ = ["Judge", "Zone", "conclude", "judge", "judge_of"]

_ROWS: Final = 1280
"""Rows of a history at first: 64 s of an episode."""


class Judge(JunctionJudge):
    """Judges one episode, row by row. It needs neither SUMO nor a simulator.

    Args:
        geometry: geometry of the trial's approach.
        trial: the trial that is driven.
        thresholds: the published ones by default.
        vehicle: the car's dimensions.

    Raises:
        GeometryMismatchError: the geometry's exits are not those of the trial's junction type, or the trial is a
            journey.
    """

    def __init__(
        self, geometry: JudgeGeometry, trial: Trial, thresholds: Thresholds = THRESHOLDS, vehicle: Vehicle = VEHICLE
    ) -> None:
        super().__init__(geometry, trial, thresholds, numbers_of(thresholds, vehicle))
        self._history = np.empty((_ROWS, decide.HISTORY))

    def _take(self, row: Row, users: Floats) -> int:
        t, x, y, yaw, v, _, command, _, _, _, _, _ = row
        while True:
            found = decide.observe(
                self._floats, self._ints, self._cells, self._numbers, users, self._standing, self._counts,
                self._history, self._route, t, x, y, yaw, v, command,
            )  # fmt: skip
            if found != decide.FULL:
                return found
            self._history = np.concatenate([self._history, np.empty_like(self._history)])

    def _conclude(self) -> Outcome:
        return conclude(self._standing, self._counts, self.trial, self.geometry, self.thresholds)


def conclude(
    standing: Floats, counts: NDArray[np.int64], trial: Trial, geometry: JudgeGeometry, thresholds: SharedThresholds
) -> Outcome:
    """Return the outcome of an episode with a verdict, from its state (``decide.py`` explains the arrays)."""
    over_line, first_stop = (float(standing[k]) for k in (decide.S_OVER_LINE, decide.S_FIRST_STOP))
    return Outcome(
        **outcome_fields(standing, counts, trial, geometry, thresholds),
        kerb_bite_m=float(standing[decide.S_KERB_M]),
        kerb_bite_s=float(standing[decide.S_KERB_S]),
        opposed_lane_m=float(standing[decide.S_OPPOSED_M]),
        over_line_m=None if math.isnan(over_line) else over_line,
        first_stop_s=None if math.isnan(first_stop) else first_stop,
    )


def judge_of(
    geometry: JudgeGeometry | JourneyGeometry,
    trial: Trial,
    thresholds: Thresholds | Thresholds1 = THRESHOLDS,
    vehicle: Vehicle = VEHICLE,
    *,
    strict: bool = False,
) -> JunctionJudge | JourneyJudge:
    """Return the judge for a geometry, of the version of the thresholds.

    Raises:
        GeometryMismatchError: the geometry does not belong to the trial.
    """
    if isinstance(geometry, JourneyGeometry):
        return JourneyJudge(geometry, trial, thresholds, vehicle, strict=strict)
    if isinstance(thresholds, Thresholds1):
        return Judge1(geometry, trial, thresholds, vehicle)
    return Judge(geometry, trial, thresholds, vehicle)


def judge(
    trajectory: Trajectory,
    geometry: JudgeGeometry | JourneyGeometry,
    thresholds: Thresholds | Thresholds1 = THRESHOLDS,
    vehicle: Vehicle = VEHICLE,
) -> Outcome:
    """Return the outcome of a recorded episode at the first row that decides it.

    A record that goes on after that row has the same outcome; one that ends before it is ``aborted``. Take
    ``THRESHOLDS_1`` to judge by version 1, and :func:`dataclasses.replace` to try other thresholds.

    Raises:
        GeometryMismatchError: the geometry belongs to another town, or its exits are not the trial's.
        RowError: a row is not finite, or the rows are not in order.
    """
    if geometry.town_sha256 not in {None, trajectory.town_sha256}:
        raise GeometryMismatchError(
            f"trajectory.town_sha256: {trajectory.town_sha256} is not the geometry's town, {geometry.town_sha256}; "
            "judge it with the town that it was driven in"
        )
    its_judge = judge_of(geometry, trajectory.trial, thresholds, vehicle)
    for row in trajectory.rows:
        outcome = its_judge.observe(row)
        if outcome is not None:
            return outcome
    return its_judge.abort(trajectory.rows[-1].t if trajectory.rows else 0.0)
