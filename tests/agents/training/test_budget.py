import pytest

from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.errors import TrainingError


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


def test_whichever_is_further_on_counts():
    clock = Clock()
    budget = Budget(1000, 10.0, clock=clock)
    budget.reserve = 0.0
    assert budget.fraction(250) == 0.25
    assert Budget(10**9, 10.0, used=270.0, clock=clock).fraction(0) == 0.5  # a resumed run; a minute is kept
    clock.now += 300.0
    assert budget.fraction(250) == 0.5
    assert not budget.over(999)
    assert budget.over(1000)
    clock.now += 300.0
    assert budget.over(0)


def test_the_last_evaluation_is_within_the_minutes():
    clock = Clock()
    budget = Budget(None, 1.0, clock=clock)
    budget.reserve = 12.0
    clock.now += 48.0
    assert budget.over()
    assert not budget.out_of_time()
    clock.now += 11.0
    assert budget.out_of_time()


def test_the_schedule_begins_with_learning():
    clock = Clock()
    budget = Budget(None, 2.0, clock=clock)
    budget.reserve = 20.0
    clock.now += 60.0  # compiling, pretraining
    budget.begun = budget.used
    assert budget.fraction(0) == 0.0
    clock.now += 20.0
    assert budget.fraction(0) == 0.5
    clock.now += 20.0
    assert budget.over()


@pytest.mark.parametrize(
    ("steps", "minutes", "field"), [(None, None, "steps"), (0, None, "steps"), (5, -1.0, "minutes")]
)
def test_a_run_must_end(steps, minutes, field):
    with pytest.raises(TrainingError, match=field):
        Budget(steps, minutes)
