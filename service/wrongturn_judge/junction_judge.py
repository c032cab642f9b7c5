"""What the judges of a junction share in both versions."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge import decide
from wrongturn_judge.base_judge import FLAGS, VERDICTS, BaseJudge
from wrongturn_judge.errors import GeometryMismatchError
from wrongturn_judge.geometry import JudgeGeometry
from wrongturn_judge.packing import Floats
from wrongturn_judge.reaction import reaction_of
from wrongturn_judge.thresholds import SharedThresholds
from wrongturn_protocol import DIRECTIONS, Trial


class Zone(IntEnum):
    """Where the car is on its way through the junction."""

    AHEAD = decide.AHEAD
    """The centre never came near the stop line."""
    ENGAGED = decide.NEAR
    """The centre came near the stop line, but was never in the junction's area."""
    INSIDE = decide.INSIDE
    """The centre is in the junction's area."""
    BEYOND = decide.BEYOND
    """The centre was in the junction's area and has left it."""


class JunctionJudge(BaseJudge):
    """Judges one episode at a junction, row by row. It needs neither SUMO nor a simulator.

    Args:
        geometry: geometry of the trial's approach.
        trial: the trial that is driven.
        thresholds: thresholds of the verdict.
        numbers: thresholds and body as the kernels read them.

    Raises:
        GeometryMismatchError: the geometry's exits are not those of the trial's junction type, or the trial is a
            journey.
    """

    def __init__(self, geometry: JudgeGeometry, trial: Trial, thresholds: SharedThresholds, numbers: Floats) -> None:
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
        packed = geometry.packed
        self._floats, self._ints, self._cells = packed.floats, packed.ints, packed.cells
        self._numbers = numbers
        self._route = int(trial.route)
        decide.begin(self._standing, self._counts)

    @property
    def zone(self) -> Zone:
        """Zone that the car is in."""
        return Zone(int(self._counts[decide.D_ZONE]))


def outcome_fields(
    standing: Floats, counts: NDArray[np.int64], trial: Trial, geometry: JudgeGeometry, thresholds: SharedThresholds
) -> dict[str, Any]:
    """Return the fields that an outcome has in both versions, from the state of an episode with a verdict."""
    t, x, y, _, min_ttc, max_deceleration = standing[: decide.S_MAX_DECELERATION + 1].tolist()
    verdict = VERDICTS[int(counts[decide.D_VERDICT])]
    assert verdict is not None
    direction = int(counts[decide.D_DIRECTION])
    bits = int(counts[decide.D_FLAGS])
    return {
        "verdict": verdict,
        "reaction": reaction_of(verdict, x, y, trial, geometry, thresholds),
        "flags": tuple(sorted(flag for bit, flag in FLAGS.items() if bits & bit)),
        "exit": DIRECTIONS[direction - 1] if direction else None,
        "time": t,
        "min_ttc": None if math.isinf(min_ttc) else min_ttc,
        "max_deceleration": max_deceleration,
    }
