"""Messages let nothing in that they should not."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from wrongturn_protocol import (
    DIRECTIONS,
    Action,
    Command,
    Fault,
    FaultKind,
    Journey,
    JunctionType,
    Start,
    Task,
    Trial,
    twin_id,
)
from wrongturn_protocol.actions import three_numbers

MIDDLE = {"steer": 0.0, "throttle": 0.5, "brake": 0.5}


@pytest.mark.parametrize("field", MIDDLE)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1.0000001, -1.0000001, None, "left", [0.1]])
def test_actions_out_of_range_are_refused(field: str, value: Any) -> None:
    with pytest.raises(ValidationError, match=field):
        Action.model_validate({**MIDDLE, field: value})


@given(steer=st.floats(-1, 1), throttle=st.floats(0, 1), brake=st.floats(0, 1))
def test_actions_in_range_pass(steer: float, throttle: float, brake: float) -> None:
    action = Action(steer=steer, throttle=throttle, brake=brake)
    assert Action.model_validate_json(action.model_dump_json()) == action


def test_an_action_is_made_by_position_too() -> None:
    assert Action(0.1, 0.4, 0.0) == Action(0.1, throttle=0.4, brake=0.0) == Action(steer=0.1, throttle=0.4, brake=0.0)
    with pytest.raises(ValueError, match=r"^action.brake is missing; give a number from 0 to 1$"):
        Action(0.1, 0.4)  # type: ignore[call-arg]
    with pytest.raises(ValueError, match=r"^action.throttle is 4.0; give a number from 0 to 1$"):
        Action(0.1, 4.0, 0.0)
    with pytest.raises(ValueError, match=r"^action.throtle: there is no such field; .*\. Did you mean throttle\?$"):
        Action(0, throtle=1, brake=0)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="4 values are given; give steer, throttle, brake"):
        Action(0.1, 0.4, 0.0, 1.0)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="steer"):
        Action(0.1, 0.4, steer=0.0)  # type: ignore[call-arg, misc]


def test_numpy_takes_an_action_for_an_array() -> None:
    action = Action(0.1, 0.4, 0.0)
    assert np.asarray(action).dtype == np.float32
    assert np.asarray([action, action], np.float64).tolist() == [[0.1, 0.4, 0.0]] * 2


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ((0.1, 0.4), r"shape \(2,\)"),
        ([[0.1, 0.4, 0.0]], r"shape \(1, 3\)"),
        ("left", "'left' is not three numbers"),
        (("0.1", "0.4", "0"), "three numbers"),
        ([[0.1], [0.4, 0.0], 0.0], "three numbers"),
        ({"steer": 0.1}, "three numbers"),
        (None, "three numbers"),
        ((None, 0.4, 0.0), "three numbers"),
        ((0.1j, 0.4, 0.0), "three numbers"),
    ],
)
def test_what_is_not_three_numbers_is_named(given: Any, named: str) -> None:
    with pytest.raises(LookupError, match=named):
        three_numbers(given, LookupError)


@st.composite
def trials(draw: st.DrawFn) -> Trial:
    kind = draw(st.sampled_from(JunctionType))
    return Trial(
        id="x",
        town="Town01",
        approach="J1-S",
        junction_type=kind,
        route=draw(st.sampled_from(sorted(kind.exits))),
        start=Start(distance=25, speed=8, lateral=0, yaw=0),
        fault=Fault(kind=draw(st.sampled_from(FaultKind))),
        seed=draw(st.integers(0, 2**63 - 1)),
    )


@given(trials())
def test_a_twin_is_the_same_trial_without_its_fault(trial: Trial) -> None:
    twin = trial.twin()
    assert twin.is_twin
    assert twin.id == twin_id(trial)
    assert twin.twin() == twin
    assert twin.model_copy(update={"id": trial.id, "fault": trial.fault}) == trial
    assert Trial.model_validate_json(trial.model_dump_json()) == trial


@given(trials(), st.sampled_from([*DIRECTIONS, Command.VOID, Command.LANE_FOLLOW]))
def test_a_route_takes_an_exit_that_exists(trial: Trial, route: Command) -> None:
    values = {**trial.model_dump(), "route": route}
    if route in trial.junction_type.exits:
        assert Trial.model_validate(values).route is route
    else:
        with pytest.raises(ValidationError, match="route"):
            Trial.model_validate(values)


JOURNEY = Journey(task=Task.STRAIGHT, goal="lane_0", goal_at=12.0, length=150.0, time_limit=54.0)


@given(trials())
def test_what_is_no_journey_says_nothing_of_journeys(trial: Trial) -> None:
    assert "journey" not in trial.model_dump()
    assert "journey" not in trial.model_dump_json()
    journey = trial.model_copy(update={"journey": JOURNEY, "fault": Fault(kind=FaultKind.NONE)})
    assert not journey.is_twin
    assert Trial.model_validate_json(journey.model_dump_json()) == journey


@pytest.mark.parametrize(("task", "goal"), [("navigation", None), ("cruise", "lane_0")])
def test_a_cruise_alone_has_no_goal(task: str, goal: str | None) -> None:
    with pytest.raises(ValidationError, match="goal: a"):
        Journey.model_validate({"task": task, "goal": goal, "time_limit": 1.0})
