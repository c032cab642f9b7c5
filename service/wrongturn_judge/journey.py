"""The judge of journeys: it takes the rows of one drive across the town and decides its outcome."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge import decide, journey_kernels
from wrongturn_judge.base_judge import FLAGS, VERDICTS, BaseJudge
from wrongturn_judge.errors import GeometryMismatchError
from wrongturn_judge.journey_geometry import JourneyGeometry
from wrongturn_judge.packing import CLOCK_TOLERANCE, Floats, numbers_of
from wrongturn_judge.thresholds import THRESHOLDS, SharedThresholds
from wrongturn_protocol import VEHICLE, JourneyOutcome, Outcome, Trial, Vehicle, Verdict

if TYPE_CHECKING:
    from wrongturn_judge.trajectory import Row

_NO_REST: Final = np.empty(0)


@dataclasses.dataclass(frozen=True)
class JourneyThresholds:
    """Thresholds of journeys besides those of every verdict; only training uses those of ``strict``."""

    stop_speed: float = 0.3
    """Strict: a slower car stands, m/s."""
    wrong_way_time: float = 1.0
    """Strict: the drive ends when the centre was in an oncoming lane for this long without interruption, s."""
    stand_time: float = 5.0
    """Strict: the drive ends when the car stood for this long without interruption, s."""
    back_time: float = 1.0
    """A car that leaves its road or lane is counted again after it was back for this long, s."""


JOURNEY_THRESHOLDS: Final = JourneyThresholds()
"""The published thresholds."""


def journey_numbers(thresholds: SharedThresholds, vehicle: Vehicle, limits: JourneyThresholds) -> Floats:
    """Return thresholds and body as the kernels read them."""
    numbers = np.zeros(journey_kernels.JOURNEY_NUMBERS)
    ours = numbers_of(thresholds, vehicle)
    numbers[: len(ours)] = ours
    numbers[journey_kernels.N_STOP_SPEED] = limits.stop_speed
    numbers[journey_kernels.N_WRONG_WAY_TIME] = limits.wrong_way_time - CLOCK_TOLERANCE
    numbers[journey_kernels.N_STAND_TIME] = limits.stand_time - CLOCK_TOLERANCE
    numbers[journey_kernels.N_BACK_TIME] = limits.back_time - CLOCK_TOLERANCE
    numbers.setflags(write=False)
    return numbers


def terms_of(geometry: JourneyGeometry, trial: Trial, *, strict: bool) -> tuple[float, float, float, float]:
    """Return what ends a journey, in the kernels' order.

    Raises:
        GeometryMismatchError: the trial is not a journey, or its goal is not in the town.
    """
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


class JourneyJudge(BaseJudge):
    """Judges one journey, row by row, as :class:`~wrongturn_judge.judges.Judge` judges one junction.

    Args:
        geometry: geometry of the trial's town.
        trial: the journey that is driven.
        thresholds: the published ones by default.
        vehicle: the car's dimensions.
        strict: for training: leaving the road or the lane, and standing, end the drive.
        limits: the published ones by default.

    Raises:
        GeometryMismatchError: the trial is not a journey, or its goal is not in the town.
    """

    def __init__(
        self,
        geometry: JourneyGeometry,
        trial: Trial,
        thresholds: SharedThresholds = THRESHOLDS,
        vehicle: Vehicle = VEHICLE,
        *,
        strict: bool = False,
        limits: JourneyThresholds = JOURNEY_THRESHOLDS,
    ) -> None:
        super().__init__(np.empty(journey_kernels.JOURNEY_FLOATS), np.empty(journey_kernels.JOURNEY_INTS, np.int64))
        self.geometry = geometry
        self.trial = trial
        self.strict = strict
        packed = geometry.packed
        self._arrays = (packed.floats, packed.ints, packed.cells, geometry.lanes)
        self._numbers = journey_numbers(thresholds, vehicle, limits)
        self._terms = np.array(terms_of(geometry, trial, strict=strict))
        goal = trial.journey.goal if trial.journey is not None else None
        self._rest = geometry.rest(goal) if goal is not None else _NO_REST
        journey_kernels.begin(self._standing, self._counts)

    def _take(self, row: Row, users: Floats) -> int:
        found: int = journey_kernels.observe(
            *self._arrays, self._numbers, users, self._terms, self._rest, self._standing, self._counts, *row[:5]
        )
        return found

    def _conclude(self) -> Outcome:
        return conclude_journey(self._standing, self._counts, self.trial)


def outcome_fields(standing: Floats, counts: NDArray[np.int64], trial: Trial) -> dict[str, Any]:
    """Return the outcome of a journey with a verdict as a dict for JSON, without fields that are None.

    This is much faster than making an ``Outcome``. ``journey_kernels.py`` explains the arrays.
    """
    numbers, whole = standing.tolist(), counts.tolist()
    verdict = VERDICTS[whole[decide.D_VERDICT]]
    journey = trial.journey
    assert verdict is not None
    assert journey is not None
    bits = whole[decide.D_FLAGS]
    completion = 1.0
    if journey.goal is not None:
        left = numbers[journey_kernels.J_LEFT]
        completion = min(max(1.0 - left / journey.length, 0.0), 1.0) if journey.length > 0.0 else float(left <= 0.0)
    outcome: dict[str, Any] = {
        "verdict": str(verdict),
        "flags": sorted(str(flag) for bit, flag in FLAGS.items() if bits & bit),
        "time": numbers[decide.S_T],
    }
    if not math.isinf(numbers[decide.S_MIN_TTC]):
        outcome["min_ttc"] = numbers[decide.S_MIN_TTC]
    outcome["max_deceleration"] = numbers[decide.S_MAX_DECELERATION]
    outcome["journey"] = {
        "distance": numbers[journey_kernels.J_DISTANCE],
        "completion": completion,
        "junctions": whole[journey_kernels.J_JUNCTIONS],
        "off_road": whole[journey_kernels.J_OFF],
        "wrong_lane": whole[journey_kernels.J_WRONG],
        "collisions": int(verdict is Verdict.COLLISION),
    }
    return outcome


def conclude_journey(standing: Floats, counts: NDArray[np.int64], trial: Trial) -> Outcome:
    """Return the outcome of a journey with a verdict, from its state."""
    fields = outcome_fields(standing, counts, trial)
    return Outcome(
        verdict=Verdict(fields["verdict"]),
        flags=tuple(sorted(flag for flag in FLAGS.values() if flag in fields["flags"])),
        time=fields["time"],
        min_ttc=fields.get("min_ttc"),
        max_deceleration=fields["max_deceleration"],
        journey=JourneyOutcome(**fields["journey"]),
    )
