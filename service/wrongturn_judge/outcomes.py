"""The outcome of an episode, from the state in which the kernels leave it at the verdict."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge import decide, journey_kernels
from wrongturn_judge.geometry import JudgeGeometry
from wrongturn_judge.packing import Floats
from wrongturn_judge.reaction import reaction_of
from wrongturn_judge.thresholds import Thresholds
from wrongturn_protocol import DIRECTIONS, Flag, JourneyOutcome, Outcome, Trial, Verdict

VERDICTS: Final = (None, *Verdict)
"""Verdict by the kernels' number; 0 is none."""
FLAGS: Final = {
    decide.KERB_BITE: Flag.KERB_BITE,
    decide.LANE_INVASION: Flag.LANE_INVASION,
    decide.WRONG_WAY_FLAG: Flag.WRONG_WAY,
    decide.OPPOSED_LANE: Flag.OPPOSED_LANE,
}
"""Flag by the kernels' bit."""


def conclude(
    standing: Floats, counts: NDArray[np.int64], trial: Trial, geometry: JudgeGeometry, thresholds: Thresholds
) -> Outcome:
    """Return the outcome of an episode at a junction. ``decide.py`` explains the arrays."""
    t, x, y, _, min_ttc, max_deceleration = standing[: decide.S_MAX_DECELERATION + 1].tolist()
    over_line, first_stop = (float(standing[k]) for k in (decide.S_OVER_LINE, decide.S_FIRST_STOP))
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
        kerb_bite_m=float(standing[decide.S_KERB_M]),
        kerb_bite_s=float(standing[decide.S_KERB_S]),
        opposed_lane_m=float(standing[decide.S_OPPOSED_M]),
        over_line_m=None if math.isnan(over_line) else over_line,
        first_stop_s=None if math.isnan(first_stop) else first_stop,
    )


def journey_fields(standing: Floats, counts: NDArray[np.int64], trial: Trial) -> dict[str, Any]:
    """Return the outcome of a journey as a dict for JSON, without fields that are None.

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
    """Return the outcome of a journey, from its state."""
    fields = journey_fields(standing, counts, trial)
    return Outcome(
        **{
            **fields,
            "verdict": Verdict(fields["verdict"]),
            "flags": tuple(Flag(flag) for flag in fields["flags"]),
            "journey": JourneyOutcome(**fields["journey"]),
        }
    )
