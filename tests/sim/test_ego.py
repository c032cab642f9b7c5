import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_protocol import VEHICLE
from wrongturn_sim.ego import SUB_STEP, advance

FINITE = {"allow_nan": False, "allow_infinity": False}
states = st.tuples(
    st.floats(-500, 500, **FINITE),
    st.floats(-500, 500, **FINITE),
    st.floats(-math.pi, math.pi, **FINITE),
    st.floats(0, 22, **FINITE),
    st.floats(-1, 1, **FINITE),
)
actions = st.tuples(
    st.floats(-1, 1, width=32, **FINITE), st.floats(0, 1, width=32, **FINITE), st.floats(0, 1, width=32, **FINITE)
)


def settle(state, action, seconds):
    for _ in range(round(seconds / SUB_STEP)):
        state = advance(*state, *action, SUB_STEP)
    return state


@given(states, actions)
def test_compiled_and_plain_python_give_the_same_bits(state, action):
    assert advance(*state, *action, SUB_STEP) == advance.py_func(*state, *action, SUB_STEP)


@given(states, actions)
def test_limits_hold_from_any_state(state, action):
    x, y, yaw, v, steering = advance(*state, *action, SUB_STEP)
    assert 0.0 <= v <= VEHICLE.max_speed
    assert -1.0 <= steering <= 1.0
    assert abs(steering - state[4]) <= VEHICLE.steering_slew * SUB_STEP + 1e-12
    assert -math.pi <= yaw <= math.pi
    turned = abs(math.remainder(yaw - state[2], math.tau))
    assert v * turned / SUB_STEP <= VEHICLE.grip + 1e-6
    # The centre lies 1.45 m ahead of the rear axle and swings out by no more than the car turns.
    moved = math.sqrt((x - state[0]) ** 2 + (y - state[1]) ** 2)
    assert moved <= v * SUB_STEP + VEHICLE.rear_axle * turned + 1e-9


@given(states, actions)
def test_a_mirrored_action_gives_the_mirrored_way(state, action):
    x, y, yaw, v, steering = state
    steer, throttle, brake = action
    one = advance(x, y, yaw, v, steering, steer, throttle, brake, SUB_STEP)
    other = advance(x, -y, -yaw, v, -steering, -steer, throttle, brake, SUB_STEP)
    assert other == pytest.approx((one[0], -one[1], -one[2], one[3], -one[4]), abs=1e-9)


def test_steer_left_is_negative_and_turns_counter_clockwise():
    *_, yaw, _v, steering = settle((0.0, 0.0, 0.0, 5.0, 0.0), (-1.0, 0.3, 0.0), 1.0)
    assert steering == -1.0
    assert yaw > 0.5


def test_the_steering_takes_half_a_second_from_straight_to_full():
    state = (0.0, 0.0, 0.0, 5.0, 0.0)
    state = settle(state, (1.0, 0.0, 0.0), 0.45)
    assert state[4] == pytest.approx(0.9)
    assert settle(state, (1.0, 0.0, 0.0), 0.05)[4] == pytest.approx(1.0)


def test_the_rear_axle_turns_on_the_circle_of_the_wheelbase():
    state = settle((0.0, 0.0, 0.0, 2.0, 1.0), (1.0, 0.0, 0.0), 0.05)
    radius = VEHICLE.wheelbase / math.tan(VEHICLE.max_wheel_angle)
    assert abs(state[2]) == pytest.approx(state[3] * SUB_STEP / radius)


def test_full_throttle_from_standing():
    *_, v, _ = settle((0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 1.0)
    assert v == pytest.approx(3.5 - 0.15, abs=0.03)


def test_any_brake_shuts_the_throttle():
    braked = settle((0.0, 0.0, 0.0, 10.0, 0.0), (0.0, 0.0, 0.5), 1.0)
    both = settle((0.0, 0.0, 0.0, 10.0, 0.0), (0.0, 1.0, 0.5), 1.0)
    assert both == braked
    assert braked[3] == pytest.approx(10.0 - 4.0 - 0.15 - 0.08, abs=0.03)


def test_a_braked_car_stands_and_does_not_go_back():
    state = settle((3.0, 4.0, 1.0, 1.0, 0.2), (0.0, 0.0, 1.0), 1.0)
    assert state[3] == 0.0
    assert settle(state, (1.0, 0.0, 1.0), 1.0)[:3] == pytest.approx(state[:3], abs=1e-12)


def test_drag_slows_a_rolling_car_and_a_little_throttle_does_not_start_it():
    assert settle((0.0, 0.0, 0.0, 10.0, 0.0), (0.0, 0.0, 0.0), 1.0)[3] == pytest.approx(9.75, abs=0.01)
    assert settle((0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.04, 0.0), 1.0)[3] == 0.0


def test_a_fast_car_runs_wide_at_the_limit_of_grip():
    state = advance(0.0, 0.0, 0.0, 15.0, 1.0, 1.0, 0.0, 0.0, SUB_STEP)
    assert state[3] * -state[2] / SUB_STEP == pytest.approx(VEHICLE.grip)
