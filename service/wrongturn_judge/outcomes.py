"""The outcome of an episode, from the state in which the kernels leave it at the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from wrongturn_judge import decide
from wrongturn_judge.geometry import JudgeGeometry
from wrongturn_judge.packing import Floats
from wrongturn_judge.thresholds import Thresholds
from wrongturn_networks.faults import Ending, find_fault
from wrongturn_protocol import DIRECTIONS, Command, Flag, JourneyOutcome, Outcome, Reaction, Trial, Verdict

VERDICTS: Final = (None, *Verdict)
"""Verdict by the kernels' number; 0 is none."""
FLAGS: Final = {
    decide.KERB_BITE: Flag.KERB_BITE,
    decide.LANE_INVASION: Flag.LANE_INVASION,
    decide.WRONG_WAY_FLAG: Flag.WRONG_WAY,
    decide.OPPOSED_LANE: Flag.OPPOSED_LANE,
    decide.STOPPED_ACROSS: Flag.STOPPED_ACROSS,
    decide.SPEEDING: Flag.SPEEDING,
    decide.KERB_RIDE: Flag.KERB_RIDE,
}
"""Flag by the kernels' bit."""


def conclude(row: Floats, trial: Trial, geometry: JudgeGeometry, thresholds: Thresholds) -> Outcome:
    """Return the outcome of an episode at a junction, from its STATE."""
    state = _fields(row)
    verdict = state["verdict"]
    assert verdict is not None
    return Outcome(
        verdict=verdict,
        reaction=reaction_of(state, trial, geometry, thresholds),
        flags=tuple(state["flags"]),
        exit=_exit_of(state),
        time=state["t"],
        min_ttc=_finite(state["min_ttc"]),
        min_ttc_users=_finite(state["min_ttc_users"]),
        min_ttc_solids=_finite(state["min_ttc_solids"]),
        max_deceleration=state["max_deceleration"],
        kerb_bite_m=state["kerb_m"],
        kerb_bite_s=state["kerb_s"],
        opposed_lane_m=state["opposed_m"],
        over_line_m=max(state["past_line"], 0.0) if verdict is Verdict.STOPPED_BEFORE_JUNCTION else None,
        stop_past_line_m=_finite(state["past_line"]),
        speed_at_verdict=state["v"] if state["rows"] else None,
        first_stop_s=_finite(state["first_stop"]),
    )


def journey_fields(row: Floats, trial: Trial) -> dict[str, Any]:
    """Return the outcome of a journey as a dict for JSON, without fields that are None, from its STATE.

    This is much faster than making an ``Outcome``.
    """
    state, journey = _fields(row), trial.journey
    assert journey is not None
    completion = 1.0
    if journey.goal is not None:
        left = state["left"]
        completion = min(max(1.0 - left / journey.length, 0.0), 1.0) if journey.length > 0.0 else float(left <= 0.0)
    min_ttc = _finite(state["min_ttc"])
    return {
        "verdict": str(state["verdict"]),
        "flags": [str(flag) for flag in state["flags"]],
        "time": state["t"],
        **({} if min_ttc is None else {"min_ttc": min_ttc}),
        "max_deceleration": state["max_deceleration"],
        "journey": {
            "distance": state["driven"],
            "completion": completion,
            "junctions": state["junctions"],
            "off_road": state["off"],
            "wrong_lane": state["wrong"],
            "collisions": int(state["verdict"] is Verdict.COLLISION),
        },
    }


def conclude_journey(row: Floats, trial: Trial) -> Outcome:
    """Return the outcome of a journey, from its STATE."""
    fields = journey_fields(row, trial)
    return Outcome(
        **{
            **fields,
            "verdict": Verdict(fields["verdict"]),
            "flags": tuple(Flag(flag) for flag in fields["flags"]),
            "journey": JourneyOutcome(**fields["journey"]),
        }
    )


def _fields(row: Floats) -> dict[str, Any]:
    """Return the fields of a STATE, the verdict and the sorted flags as they are called, and ``min_ttc``."""
    fields = dict(zip(decide.STATE.names or (), row.view(decide.STATE)[0].tolist(), strict=True))
    fields["min_ttc"] = min(fields["min_ttc_users"], fields["min_ttc_solids"])
    fields["verdict"] = VERDICTS[fields["verdict"]]
    fields["flags"] = sorted(flag for bit, flag in FLAGS.items() if fields["flags"] & bit)
    return fields


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _exit_of(state: Mapping[str, Any]) -> Command | None:
    return DIRECTIONS[state["direction"] - 1] if state["verdict"].exited else None


def reaction_of(
    state: Mapping[str, Any], trial: Trial, geometry: JudgeGeometry, thresholds: Thresholds
) -> Reaction | None:
    """Return the reaction, as the trial's fault names it, from the fields of a STATE with a verdict."""
    fault = find_fault(trial.fault.kind)
    if fault is None:
        return None
    ending = Ending(
        verdict=state["verdict"],
        exit=_exit_of(state),
        engaged=state["zone"] > decide.AHEAD,
        on_side=lambda direction: on_side(direction, state["x"], state["y"], geometry, thresholds),
    )
    return fault.reaction(trial, ending)


def on_side(direction: Command, x: float, y: float, geometry: JudgeGeometry, thresholds: Thresholds) -> bool:
    """Return whether a point lies where an arm in this direction is or would be, or on the way there."""
    past, left = geometry.beside_approach(x, y)
    if direction is Command.LEFT:
        return past > -thresholds.obeyed_distance and left > 0
    if direction is Command.RIGHT:
        return past > -thresholds.obeyed_distance and left < 0
    if direction is Command.STRAIGHT:
        middle, _ = geometry.beside_approach(*geometry.middle)
        return past > middle and abs(left - geometry.street_axis) <= thresholds.obeyed_lateral
    return False
