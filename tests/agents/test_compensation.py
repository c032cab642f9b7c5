"""A car that does as its driver steers gets what its driver asks for; another car gets what makes up for it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_agents.compensation import MEMORY, compensated


def driven(steers, gain, lag):
    memory, wheels = np.zeros((1, MEMORY), np.float32), [0.0] * (lag + 1)
    for steer in steers:
        asked, seen = np.float32([[steer, 0.5, 0.0]]), np.float32([[wheels[-1 - lag]]])
        got, memory = compensated(np, asked, seen, np.float32([[8.0]]), memory)
        wheels.append(wheels[-1] + np.clip(np.clip(gain * got[0, 0], -1.0, 1.0) - wheels[-1], -0.2, 0.2))
        yield asked[0], got[0]


@given(st.floats(1e-6, 1.0), st.floats(0.9, 1.0), st.floats(0.1, 30.0))
def test_a_car_that_answers_as_told_gets_the_same_action(size, kept, period):
    steers = [size * kept**t * np.cos(t / period) for t in range(300)]
    assert all((asked == got).all() for asked, got in driven(steers, 1.0, 0))


@given(st.integers(1, 20), st.floats(1.2, 12.0))
def test_a_delay_is_not_taken_for_wheels_that_turn_too_little(lag, period):
    steers = [0.1 * np.sin(t / period) for t in range(250)]
    assert all(asked[0] == got[0] for asked, got in driven(steers, 1.0, lag))


@pytest.mark.parametrize(("gain", "lag"), [(0.6, 0), (1.4, 0), (0.6, 3), (1.0, 15)])
def test_gain_and_lag_are_made_up_for(gain, lag):
    *_, (asked, got) = driven((0.3 * np.sin(t / 9.0) + 0.02 * (-1) ** t for t in range(60)), gain, lag)
    assert gain * got[0] == pytest.approx(asked[0], abs=0.01)
    assert got[1] == (0.0 if lag > 3 else 0.5)
