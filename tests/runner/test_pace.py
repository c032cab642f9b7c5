"""How slow a model may be."""

import pytest

from wrongturn_runner.conversation import ModelAtFaultError
from wrongturn_runner.pace import Pace


def test_one_slow_step_among_quick_ones_is_allowed() -> None:
    pace = Pace(0.5, steps=6)
    for seconds in (1.9, 0.2, 0.2, 0.2, 0.2, 0.2):
        pace.add(seconds)


def test_a_model_is_refused_as_soon_as_it_cannot_keep_the_average() -> None:
    pace = Pace(0.5, steps=6)
    pace.add(1.6)
    with pytest.raises(ModelAtFaultError, match=r"2 steps of the model took 3\.2 s together; 0\.5 s a step"):
        pace.add(1.6)


def test_a_model_that_becomes_slow_is_refused_later() -> None:
    pace = Pace(0.5, steps=6)
    for _ in range(100):
        pace.add(0.1)
    for _ in range(26):
        pace.add(2.0)
    with pytest.raises(ModelAtFaultError, match="127 steps"):
        pace.add(2.0)
