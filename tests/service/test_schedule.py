"""Which trial comes next."""

from journey_suite import journeys

from wrongturn_networks import Draw, load_suite
from wrongturn_networks.draws import halves
from wrongturn_protocol import Trial
from wrongturn_service.episodes.evaluations import Schedule


def taken(schedule: Schedule) -> list[Trial]:
    """All trials that can be opened now."""
    found = []
    while (trial := schedule.take()) is not None:
        found.append(trial)
    return found


def test_the_second_half_begins_when_the_first_has_ended() -> None:
    draw = load_suite("smoke@3").open_draw
    first, second = halves(draw, "secret")
    schedule = Schedule(draw, "secret")
    opened = taken(schedule)
    assert tuple(opened) == first
    for trial in opened[1:]:
        schedule.finish(trial)
        assert schedule.take() is None
    schedule.put_back(opened[0])
    assert schedule.take() == opened[0]
    schedule.finish(opened[0])
    assert tuple(taken(schedule)) == second
    assert not schedule.finished


def test_a_restart_changes_nothing_of_the_order() -> None:
    draw = load_suite("smoke@3").open_draw
    order = [trial for half in halves(draw, "secret") for trial in half]
    for count in range(len(order) + 1):
        schedule = Schedule(draw, "secret", {trial.id for trial in order[:count]})
        assert schedule.finished == (count == 12)
        assert taken(schedule) == (order[count:6] if count < 6 else order[count:])


def test_journeys_have_no_twins_to_wait_for() -> None:
    trials = journeys()
    # Two tasks may begin at one approach by one seed, which is what names a twin.
    alike = trials[0].model_copy(update={"id": "Town01.one_turn.J3-S.s1"})
    schedule = Schedule(Draw("journeys@1", (*trials, alike), ()), "secret")
    opened = [trial.id for trial in taken(schedule)]
    assert len(opened) == len(set(opened)) == schedule.open == 7


def test_what_came_to_nothing_comes_again_and_what_is_finished_does_not() -> None:
    draw = load_suite("smoke@3").open_draw
    finished = {trial.id for half in halves(draw, "secret") for trial in half[:5]} | {
        trial.id for trial in halves(draw, "secret")[0]
    }
    schedule = Schedule(draw, "secret", finished)
    first = schedule.take()
    assert first is not None
    assert first.id not in finished
    schedule.put_back(first)
    assert schedule.take() == first
    schedule.finish(first)
    schedule.put_back(first)
    assert schedule.take() is None
    assert schedule.finished
