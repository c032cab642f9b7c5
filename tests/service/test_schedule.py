"""Which trial comes next."""

from journey_suite import journeys

from wrongturn_networks import load_suite
from wrongturn_service.episodes.evaluations import Schedule, pair_of, shuffled


def test_the_order_is_the_secrets_alone() -> None:
    trials = load_suite("wrong-command@2").episodes
    one = [trial.id for trial in shuffled(trials, "one")]
    assert one == [trial.id for trial in shuffled(reversed(trials), "one")]
    assert one != [trial.id for trial in shuffled(trials, "two")]
    assert sorted(one) == sorted(trial.id for trial in trials)


def test_no_trial_is_open_beside_its_twin() -> None:
    draw = load_suite("smoke@2").open_draw
    assert [pair_of(trial) for trial in draw.trials] == [pair_of(twin) for twin in draw.twins]
    schedule = Schedule(draw.episodes, "secret")
    opened = []
    while (trial := schedule.take()) is not None:
        opened.append(trial)
    assert len({pair_of(trial) for trial in opened}) == len(opened) == schedule.open
    schedule.finish(opened[0])
    following = schedule.take()
    assert following is not None
    assert pair_of(following) == pair_of(opened[0])
    assert following.id != opened[0].id


def test_journeys_have_no_twins_to_wait_for() -> None:
    trials = journeys()
    # Two tasks may begin at one approach by one seed, which is what names a twin.
    alike = trials[0].model_copy(update={"id": "Town01.one_turn.J3-S.s1"})
    schedule = Schedule((*trials, alike), "secret")
    opened = []
    while (trial := schedule.take()) is not None:
        opened.append(trial.id)
    assert len(opened) == len(set(opened)) == schedule.open == 7


def test_what_came_to_nothing_comes_again_and_what_is_finished_does_not() -> None:
    trials = load_suite("smoke@2").episodes
    finished = {trial.id for trial in trials[:10]}
    schedule = Schedule(trials, "secret", finished)
    first = schedule.take()
    assert first is not None
    assert first.id not in finished
    schedule.put_back(first)
    assert schedule.take() == first
    schedule.finish(first)
    schedule.put_back(first)
    last = schedule.take()
    assert last is not None
    assert last != first
    assert not schedule.finished
    schedule.finish(last)
    assert schedule.finished
