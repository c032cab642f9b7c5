"""The judge: it takes the rows of one episode and decides its outcome."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol import DIRECTIONS, Outcome, Trial
from wrongturn_sim.ego import VEHICLE, Vehicle
from wrongturn_sim.verdict import decide
from wrongturn_sim.verdict.base_judge import FLAGS, NOBODY, VERDICTS, BaseJudge
from wrongturn_sim.verdict.errors import GeometryMismatchError
from wrongturn_sim.verdict.geometry import JudgeGeometry
from wrongturn_sim.verdict.journey import JourneyJudge
from wrongturn_sim.verdict.journey_geometry import JourneyGeometry
from wrongturn_sim.verdict.packing import Floats, numbers_of
from wrongturn_sim.verdict.reaction import reaction_of
from wrongturn_sim.verdict.thresholds import THRESHOLDS, Thresholds

if TYPE_CHECKING:
    from wrongturn_sim.trajectory import Row, Trajectory


class Zone(IntEnum):
    """Where the car is on its way through the junction; standing is timed within one zone."""

    AHEAD = decide.AHEAD
    """The centre never came near the stop line."""
    ENGAGED = decide.NEAR
    """The centre came near the stop line, but was never in the junction's area."""
    INSIDE = decide.INSIDE
    """The centre is in the junction's area."""
    BEYOND = decide.BEYOND
    """The centre was in the junction's area and has left it."""


class Judge(BaseJudge):
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
        super().__init__(np.empty(decide.STANDING_FLOATS), np.empty(decide.STANDING_INTS, np.int64))
        self.geometry = geometry
        self.trial = trial
        self.thresholds = thresholds
        self.vehicle = vehicle
        packed = geometry.packed
        self._floats, self._ints, self._cells = packed.floats, packed.ints, packed.cells
        self._numbers = numbers_of(thresholds, vehicle)
        self._route = int(trial.route)
        decide.begin(self._standing, self._counts)

    @property
    def zone(self) -> Zone:
        """Zone that the car is in."""
        return Zone(int(self._counts[decide.D_ZONE]))

    def observe(self, row: Row) -> Outcome | None:
        """Take the next row.

        Returns:
            The outcome at the row that decides it; None for rows before and after.

        Raises:
            RowError: the row is not finite, or not later than the one before.
        """
        if self.outcome is not None:
            return None
        t, x, y, yaw, v, _, command, _, _, _, _, road_users = row
        users = np.array(road_users, np.float64) if road_users else NOBODY
        found = decide.observe(
            self._floats, self._ints, self._cells, self._numbers, users, self._standing, self._counts, self._route,
            t, x, y, yaw, v, command,
        )  # fmt: skip
        if not found:
            return None  # so it is for nearly every row
        return self._fall(found, t)

    def _conclude(self) -> Outcome:
        return conclude(self._standing, self._counts, self.trial, self.geometry, self.thresholds)


def conclude(
    standing: Floats, counts: NDArray[np.int64], trial: Trial, geometry: JudgeGeometry, thresholds: Thresholds
) -> Outcome:
    """Return the outcome of an episode with a verdict, from its state (``decide.py`` explains the arrays)."""
    t, x, y, _, _, min_ttc, max_deceleration = standing.tolist()
    verdict = VERDICTS[int(counts[decide.D_VERDICT])]
    assert verdict is not None
    direction = int(counts[decide.D_DIRECTION])
    bits = int(counts[decide.D_FLAGS])
    return Outcome(
        verdict=verdict,
        reaction=reaction_of(verdict, x, y, trial, geometry, thresholds),
        flags=tuple(sorted(flag for bit, flag in FLAGS.items() if bits & bit)),
        exit=DIRECTIONS[direction - 1] if direction else None,
        time=t,
        min_ttc=None if math.isinf(min_ttc) else min_ttc,
        max_deceleration=max_deceleration,
    )


def judge_of(
    geometry: JudgeGeometry | JourneyGeometry,
    trial: Trial,
    thresholds: Thresholds = THRESHOLDS,
    vehicle: Vehicle = VEHICLE,
    *,
    strict: bool = False,
) -> Judge | JourneyJudge:
    """Return the judge for a geometry.

    Raises:
        GeometryMismatchError: the geometry does not belong to the trial.
    """
    if isinstance(geometry, JourneyGeometry):
        return JourneyJudge(geometry, trial, thresholds, vehicle, strict=strict)
    return Judge(geometry, trial, thresholds, vehicle)


def judge(
    trajectory: Trajectory,
    geometry: JudgeGeometry | JourneyGeometry,
    thresholds: Thresholds = THRESHOLDS,
    vehicle: Vehicle = VEHICLE,
) -> Outcome:
    """Return the outcome of a recorded episode; it is ``aborted`` if the record ends before a verdict.

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
