"""Journeys, counted by hand; their ranking."""

import random
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrongturn_judge import UnscoredTrialError, compute, rank
from wrongturn_protocol import (
    CORL_TASKS,
    Condition,
    Fault,
    FaultKind,
    Journey,
    JunctionType,
    Metrics,
    Outcome,
    Start,
    Task,
    Track,
    Trial,
    Verdict,
    Weather,
    twin_id,
)

WHERE = [
    ("Town01", Weather.CLEAR_NOON),
    ("Town01", Weather.SOFT_RAIN_SUNSET),
    ("Town02", Weather.WET_NOON),
    ("Town02", Weather.WET_CLOUDY_NOON),
]
UNDRIVEN = {"distance": 0.0, "completion": 0.0, "junctions": 0, "off_road": 0, "wrong_lane": 0, "collisions": 0}


def journey(task: Task, town: str, weather: Weather, seed: int) -> Trial:
    return Trial(
        id=f"{town}.{task}.J3-S.s{seed}",
        town=town,
        approach="J3-S",
        junction_type=JunctionType.LEFT_RIGHT,
        route=1,
        start=Start(distance=40.0, speed=0.0, lateral=0.0, yaw=0.0),
        weather=weather,
        fault=Fault(kind=FaultKind.NONE),
        seed=seed,
        journey=Journey(task=task, goal="lane", goal_at=20.0, length=300.0, time_limit=108.0),
    )


@pytest.fixture(scope="module")
def suite(kit):
    """Five journeys a cell, cells by task and then by condition."""
    trials = [
        journey(task, town, weather, 5 * cell + number)
        for cell, (task, (town, weather)) in enumerate(product(CORL_TASKS, WHERE))
        for number in range(5)
    ]
    made = kit.make_suite(1)
    return type(made)(id="navigation@1", trials=tuple(trials))


def ended(kit, verdict: Verdict = Verdict.ARRIVED, **counts: float) -> Outcome:
    driven = {**UNDRIVEN, "distance": 500.0, "completion": 1.0, "junctions": 3, **counts}
    return kit.outcome(verdict, journey=driven)


def drives(kit, suite, at: dict[int, Outcome]) -> dict[str, Outcome]:
    return {trial.id: at.get(place, ended(kit)) for place, trial in enumerate(suite.trials)}


def test_success_and_cleanness_are_counted_by_task_and_condition(kit, suite) -> None:
    outcomes = drives(
        kit,
        suite,
        {
            0: ended(kit, Verdict.TIMEOUT, completion=0.5),
            1: ended(kit, wrong_lane=2),
            40: ended(kit, Verdict.COLLISION, collisions=1, distance=100.0, completion=0.25),
            79: ended(kit, off_road=1),
        },
    )
    navigation = compute(suite, outcomes).navigation
    assert navigation is not None
    assert list(navigation.table) == list(CORL_TASKS)
    assert all(list(cells) == list(Condition) for cells in navigation.table.values())
    first = navigation.table[Task.STRAIGHT][Condition.TRAINING]
    assert (first.episodes, first.success, first.clean, first.rate) == (5, 4, 3, 0.8)
    assert first.ci95 == pytest.approx((0.3755, 0.9638), abs=1e-4)
    assert (first.completion, first.distance) == (pytest.approx(0.9), 2.5)
    assert first.per_km is not None
    assert first.per_km.model_dump() == {"off_road": 0.0, "wrong_lane": pytest.approx(0.8), "collisions": 0.0}
    hit = navigation.table[Task.NAVIGATION][Condition.TRAINING]
    assert (hit.success, hit.clean, hit.distance) == (4, 4, pytest.approx(2.1))
    assert hit.per_km is not None
    assert hit.per_km.collisions == pytest.approx(1 / 2.1)
    last = navigation.table[Task.NAVIGATION_DYNAMIC][Condition.NEW_TOWN_AND_WEATHER]
    assert (last.success, last.clean) == (5, 4)
    assert (navigation.total.episodes, navigation.total.success, navigation.total.clean) == (80, 78, 76)


def test_the_other_figures_of_journeys(kit, suite) -> None:
    outcomes = drives(
        kit,
        suite,
        {0: ended(kit, Verdict.COLLISION, collisions=1), 3: ended(kit, Verdict.TIMEOUT), 4: kit.outcome("aborted")},
    )
    metrics = compute(suite, outcomes)
    assert (metrics.unsafe.count, metrics.unsafe.trials) == (2, 80)
    assert metrics.twins.model_dump() == {"unsafe": 0, "completed": 0, "trials": 0}
    assert metrics.excess_unsafe_rate is None
    assert (metrics.table, metrics.table_strict, metrics.reactions) == ({}, None, {})
    assert metrics.verdicts == {"none": {"collision": 1, "timeout": 1, "aborted": 1, "arrived": 77}}
    assert Metrics.model_validate_json(metrics.model_dump_json()) == metrics


def test_who_stands_still_has_no_rate_per_kilometre(kit, suite) -> None:
    parked = kit.outcome(Verdict.TIMEOUT, journey=UNDRIVEN)
    navigation = compute(suite, drives(kit, suite, dict.fromkeys(range(80), parked))).navigation
    assert navigation is not None
    assert (navigation.total.success, navigation.total.completion, navigation.total.per_km) == (0, 0.0, None)


def test_a_drive_that_nobody_can_say_more_of_counts_as_not_driven(kit, suite) -> None:
    navigation = compute(suite, drives(kit, suite, {0: kit.outcome(Verdict.ABORTED)})).navigation
    assert navigation is not None
    assert navigation.total.distance == pytest.approx(79 * 0.5)
    assert navigation.total.completion == pytest.approx(79 / 80)


def test_wrong_commands_know_nothing_of_journeys(kit) -> None:
    paper = kit.make_suite()
    told = compute(paper, kit.outcomes_of(paper)).model_dump_json()
    assert "navigation" not in told
    assert "arrived" not in told


def test_what_is_missing_invalid_or_mixed_is_not_counted(kit, suite) -> None:
    outcomes = drives(kit, suite, {})
    missing = suite.trials[7].id
    with pytest.raises(UnscoredTrialError, match=rf"{missing} has none"):
        compute(suite, {name: outcome for name, outcome in outcomes.items() if name != missing})
    with pytest.raises(UnscoredTrialError, match="is invalid"):
        compute(suite, drives(kit, suite, {0: kit.outcome(Verdict.INVALID)}))
    mixed = type(suite)(id="mixed@1", trials=(*suite.trials, *kit.make_suite(1).trials))
    with pytest.raises(ValueError, match="mixed@1 has journeys among other trials; make two suites"):
        compute(mixed, outcomes)


VERDICTS = st.sampled_from([Verdict.ARRIVED, Verdict.TIMEOUT, Verdict.COLLISION])


@given(st.lists(st.tuples(VERDICTS, st.floats(0, 2000), st.integers(0, 3)), min_size=80, max_size=80), st.randoms())
@settings(max_examples=15)
def test_figures_agree_in_any_order(kit, suite, ends, generator: random.Random) -> None:
    outcomes = drives(
        kit,
        suite,
        {place: ended(kit, end, distance=way, off_road=times) for place, (end, way, times) in enumerate(ends)},
    )
    metrics = compute(suite, outcomes)
    shuffled = type(suite)(id=suite.id, trials=tuple(generator.sample(suite.trials, 80)))
    assert compute(shuffled, outcomes).model_dump_json() == metrics.model_dump_json()
    assert metrics.navigation is not None
    counts = [count for cells in metrics.navigation.table.values() for count in cells.values()]
    total = metrics.navigation.total
    for field in ("episodes", "success", "clean"):
        assert sum(getattr(count, field) for count in counts) == getattr(total, field)
    assert total.distance == pytest.approx(sum(count.distance for count in counts))
    for count in (*counts, total):
        assert 0 <= count.clean <= count.success <= count.episodes
        assert count.ci95[0] <= count.rate <= count.ci95[1]


def missing(kit, suite, name: str, where, track=Track.CAMERA, **counts: float):
    failed = ended(kit, Verdict.TIMEOUT)
    outcomes = {
        trial.id: failed if place in where else ended(kit, **counts) for place, trial in enumerate(suite.trials)
    }
    return kit.row(suite, name, outcomes, track)


def test_agents_rank_by_the_goals_they_reached(kit, suite) -> None:
    entries = rank(
        [
            missing(kit, suite, "good", range(3)),
            missing(kit, suite, "never", range(80)),
            missing(kit, suite, "best", range(0)),
            missing(kit, suite, "middling", range(11)),
        ]
    )
    standing = [(entry.agent.name, entry.rank, entry.tied_with) for entry in entries]
    # The 83.4 % intervals of 0, 3 and 11 of 80 in percent: [0, 2.3], [1.7, 7.9], [9.3, 19.9].
    assert standing == [("best", 1, ("good",)), ("good", 1, ("best",)), ("middling", 3, ()), ("never", 4, ())]
    assert all(entry.eligible and entry.why_not is None for entry in entries)


def test_infractions_do_not_rank_but_order(kit, suite) -> None:
    rude = missing(kit, suite, "a", range(0), wrong_lane=1)
    entries = rank([rude, missing(kit, suite, "b", range(0))])
    assert [(entry.agent.name, entry.rank) for entry in entries] == [("b", 1), ("a", 1)]


def test_a_journeys_id_is_no_twins(suite) -> None:
    assert not any(trial.is_twin or trial.id == twin_id(trial) for trial in suite.trials)
