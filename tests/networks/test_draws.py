"""Draws: what a secret makes of a suite's cells, and that it makes the same everywhere."""

import dataclasses
import hashlib
import hmac
import json
import math
from collections import Counter
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wrongturn_networks import (
    ApproachTooShortError,
    Draw,
    FaultNotApplicableError,
    SecretError,
    UnknownTownError,
    commitment_of,
    draw_journey,
    draw_trial,
    draws,
    load_suite,
    load_town,
    possible_trials,
)
from wrongturn_networks.draws import draw_cells, public_secret
from wrongturn_networks.faults import check_fault
from wrongturn_networks.making import write_suite
from wrongturn_protocol import (
    PAPER_TYPES,
    Cell,
    Command,
    Fault,
    FaultKind,
    JunctionType,
    Task,
    Traffic,
    Trial,
    Weather,
    twin_id,
)

FAULTS = (FaultKind.INFEASIBLE, FaultKind.OMISSION)
GOLDEN_SECRET = "0f" * 32
GOLDEN = "ecd3e0ea2ac2a8993cbf135b349bf1ac804d8e2e93613c8f02b1ea3783d89e5c"
"""SHA-256 of a draw's JSON. It stays the same on every machine and for ever: old evaluations are rebuilt by it."""

secrets = st.text(st.characters(codec="utf-8"), min_size=1) | st.binary(min_size=32, max_size=32).map(bytes.hex)


def sha256_of(draw: Draw) -> str:
    """Return the SHA-256 of a draw's trials and twins as JSON."""
    content = [trial.model_dump(mode="json") for trial in draw.episodes]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def cell(
    town: str, kind: JunctionType = JunctionType.LEFT_RIGHT, fault: FaultKind = FaultKind.INFEASIBLE, **given: Any
) -> Cell:
    """Return a cell."""
    return Cell(town=town, junction_type=kind, fault=Fault(kind=fault), **given)


def paper(secret: str) -> Draw:
    """Return the draw of the paper's sixty cells."""
    return load_suite("wrong-command@3").draw(secret)


def is_sound(trial: Trial) -> None:
    """Check a drawn trial against everything that is promised of it."""
    assert Trial.model_validate_json(trial.model_dump_json()) == trial
    check_fault(trial)
    town = load_town(trial.town)
    approach = town.approach(trial.approach)
    assert trial.junction_type is approach.type
    assert trial.route in approach.exits
    room = town.lanes[approach.lane].length - 3.0
    assert min(22.0, room) - 0.001 <= trial.start.distance <= min(60.0, room) + 0.001
    assert 4.0 <= trial.start.speed <= 9.0
    # At full brakes (8 m/s²) the car stands before it is engaged, 15 m before the stop line.
    assert trial.start.speed**2 / 16 < trial.start.distance - 15.0
    assert abs(trial.start.lateral) <= 0.4
    assert abs(math.degrees(trial.start.yaw)) <= 6.0 + 1e-3
    assert trial.window is not None
    assert 10.0 <= trial.window <= 20.0
    assert 0 <= trial.seed < 2**31
    assert 1.0 <= trial.watch <= 4.0
    assert trial.scenery is not None
    assert trial.journey is None


@given(secret=secrets)
@settings(max_examples=20)
def test_a_draw_keeps_what_it_promises(secret: str) -> None:
    suite, draw = load_suite("wrong-command@3"), paper(secret)
    assert (len(draw.trials), len(draw.twins), len(draw.episodes)) == (60, 60, 120)
    for one, trial, twin in zip(suite.cells, draw.trials, draw.twins, strict=True):
        is_sound(trial)
        is_sound(twin)
        of_the_cell = (one.town, one.junction_type, one.fault, one.weather, one.traffic)
        assert (trial.town, trial.junction_type, trial.fault, trial.weather, trial.traffic) == of_the_cell
        assert twin.is_twin
        same = ("town", "scenery", "approach", "junction_type", "route", "weather", "traffic")
        assert [getattr(twin, name) for name in same] == [getattr(trial, name) for name in same]
        assert twin.start != trial.start
        assert twin.seed != trial.seed
        assert twin.id == trial.twin().id
        assert draw.trial(trial.id) is trial
        assert draw.trial(twin.id) is twin
    assert len({episode.id for episode in draw.episodes}) == 120
    assert len({episode.seed for episode in draw.episodes}) == 120
    assert len({episode.start for episode in draw.episodes}) == 120
    for kind, fault in product(PAPER_TYPES, FAULTS):
        some = [trial for trial in draw.trials if (trial.junction_type, trial.fault.kind) == (kind, fault)]
        assert len({trial.approach for trial in some}) == len(some) == 10
        assert Counter(trial.route for trial in some) == dict.fromkeys(kind.exits, 5)


@given(one=secrets, other=secrets)
@settings(max_examples=20)
def test_two_secrets_give_trials_that_differ_in_every_start(one: str, other: str) -> None:
    if one == other:
        assert paper(one).episodes == paper(other).episodes
        return
    for a, b in zip(paper(one).episodes, paper(other).episodes, strict=True):
        assert a.start != b.start
        assert a.id != b.id


def test_every_approach_route_and_range_is_reached() -> None:
    draws = [paper(f"secret {k}") for k in range(40)]
    trials = [trial for draw in draws for trial in draw.trials]
    town = load_town("Town01")
    assert {(t.approach, t.route) for t in trials} == {
        (name, route)
        for name, approach in town.approaches.items()
        if approach.type in PAPER_TYPES
        for route in approach.exits
    }
    windows = [episode.window or 0.0 for draw in draws for episode in draw.episodes]
    assert min(windows) < 10.1
    assert max(windows) > 19.9
    assert sum(windows) / len(windows) == pytest.approx(15.0, abs=0.2)
    starts = [episode.start for draw in draws for episode in draw.episodes]
    assert max(start.distance for start in starts) > 59.0
    assert min(start.distance for start in starts) < 22.5
    assert min(start.speed for start in starts) < 4.1
    assert max(start.speed for start in starts) > 8.9
    assert Counter(trial.approach for trial in trials).most_common()[-1][1] > 20


def test_equal_cells_beyond_the_approaches_come_again_as_evenly_as_can_be() -> None:
    draw = draw_cells("many@1", [cell("Town01")] * 31, "a secret")
    times = Counter(trial.approach for trial in draw.trials)
    assert len(times) == 12
    assert sorted(times.values()) == [2] * 5 + [3] * 7
    assert sorted(Counter(trial.route for trial in draw.trials).values()) == [15, 16]
    assert len({episode.id for episode in draw.episodes}) == 62


def test_seeds_differ_however_few_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(draws, "SEEDS", 120)
    draw = paper("a secret")
    assert sorted(episode.seed for episode in draw.episodes) == list(range(120))
    assert len({episode.id for episode in draw.episodes}) == 120


def test_a_number_tells_no_other() -> None:
    """What an agent might get to know of a trial says neither its cell nor its side of the pair, nor its turn."""
    several = [paper(f"secret {k}") for k in range(20)]
    for numbers in (
        lambda one: [episode.seed % 120 for episode in one.episodes],
        lambda one: [episode.watch for episode in one.episodes],
        lambda one: [one.episodes.index(episode) for half in draws.halves(one, one.secret) for episode in half],
    ):
        table = np.array([numbers(one) for one in several], float)
        # Of 120 slots in 20 draws, what one shows of its number is chance: 0.05 sqrt(20) of its spread, at most.
        assert abs(np.corrcoef(table.ravel(), np.tile(np.arange(120), 20))[0, 1]) < 0.08
        assert abs(np.corrcoef(table.ravel(), np.tile([0, 1], 1200))[0, 1]) < 0.08
        assert len({tuple(row) for row in table.tolist()}) == 20


def test_one_of_each_pair_comes_first_and_which_one_is_drawn() -> None:
    of_trials = []
    for k in range(40):
        draw = paper(f"secret {k}")
        first, second = draws.halves(draw, f"secret {k}")
        assert sorted(one.id for one in (*first, *second)) == sorted(one.id for one in draw.episodes)
        assert len({twin_id(one) for one in first}) == len(first) == 60
        of_trials.append(sum(not one.is_twin for one in first))
    assert 25 < sum(of_trials) / 40 < 35
    journeys = load_suite("navigation@1").open_draw
    first, second = draws.halves(journeys, "a secret")
    assert (len(first), second) == (400, ())
    assert first != journeys.trials


def test_journeys_have_ways_that_their_seeds_do_not_tell() -> None:
    cells = [Cell(town=town, task=Task.NAVIGATION) for town in ("Town01", "Town02") for _ in range(20)]
    draw = draw_cells("journeys@1", cells, "a secret")
    assert (draw.twins, draw.episodes, len({trial.id for trial in draw.trials})) == ((), draw.trials, 40)
    assert len({trial.seed for trial in draw.trials}) == 40
    for one, trial in zip(cells, draw.trials, strict=True):
        assert (trial.town, trial.journey and trial.journey.task) == (one.town, one.task)
        assert Trial.model_validate_json(trial.model_dump_json()) == trial
        by_its_seed = draw_journey(load_town(trial.town), Task.NAVIGATION, trial.seed)
        assert (by_its_seed.start, by_its_seed.journey) != (trial.start, trial.journey)
    assert len({(trial.town, trial.scenery) for trial in draw.trials}) == 2
    with pytest.raises(ValueError, match=r"cells\[1\]: has no task"):
        draw_cells("mixed@1", [cells[0], cell("Town01")], "a secret")
    for wrong in ({}, {"task": "cruise"}, {"task": "navigation", "fault": {"kind": "omission"}}):
        with pytest.raises(ValueError, match=r"junction_type: a cell has one|task: a journey has a goal"):
            Cell.model_validate({"town": "Town01", **wrong})


def test_conditions_are_the_cells() -> None:
    cells = [
        cell(town, JunctionType.STRAIGHT_LEFT, weather=weather, traffic=Traffic(vehicles=number))
        for number, (town, weather) in enumerate(product(("Town01", "Town02"), (Weather.WET_NOON, Weather.CLEAR_NOON)))
    ]
    draw = draw_cells("some@1", cells, "s")
    for given_cell, trial, twin in zip(cells, draw.trials, draw.twins, strict=True):
        for one in (trial, twin):
            is_sound(one)
            assert (one.town, one.weather, one.traffic) == (given_cell.town, given_cell.weather, given_cell.traffic)


def test_the_same_secret_gives_the_same_trials_for_ever() -> None:
    assert sha256_of(paper(GOLDEN_SECRET)) == GOLDEN


def test_the_open_draw_is_drawn_from_the_suites_id() -> None:
    suite = load_suite("smoke@3")
    assert suite.open_draw.secret == "smoke@3"
    assert suite.open_draw.episodes == suite.draw("smoke@3").episodes == suite.episodes
    assert suite.trials == suite.open_draw.trials
    assert suite.trial(suite.trials[0].id) is suite.trials[0]


def test_public_draws_follow_from_the_suites_id_and_are_no_evaluations() -> None:
    assert public_secret("smoke@3", 1) == "smoke@3"
    second = public_secret("smoke@3", 2)
    told = hmac.digest(b"smoke@3", b"public draw 2", "sha256").hex()
    assert second == f"public {told}"
    assert len({public_secret(suite, draw) for suite in ("smoke@3", "wrong-command@3") for draw in range(1, 11)}) == 20
    with pytest.raises(SecretError, match="draw: is 0; public draws are numbered from 1"):
        public_secret("smoke@3", 0)


def test_a_listed_suite_is_drawn_as_it_is_listed() -> None:
    open_draw = load_suite("smoke@3").open_draw
    suite = dataclasses.replace(load_suite("smoke@3"), cells=(), listed=open_draw.trials)
    draw = suite.draw("whatever")
    assert draw.trials == suite.listed
    assert [twin.start for twin in draw.twins] == [trial.start for trial in suite.listed]
    assert (draw.secret, draw.commitment) == (None, None)
    journeys = load_suite("navigation@1").draw("whatever")
    assert (journeys.twins, journeys.episodes) == ((), journeys.trials)


def test_practice_never_equals_a_trial_of_a_draw() -> None:
    """Practice has the nominal window; its start follows from its seed, and a drawn start from the secret alone."""
    town = load_town("Town01")
    for secret in (load_suite("wrong-command@3").id, *map(str, range(4))):
        for trial in paper(secret).episodes:
            practice = draw_trial(town, trial.approach, trial.fault, trial.seed, route=trial.route)
            assert practice != trial
            assert practice.window is None
            assert practice.start != trial.start
    drawn = {trial.start for secret in range(4) for trial in paper(str(secret)).episodes}
    some = [
        draw_trial(town, name, FaultKind.NONE, seed).start for name in sorted(town.approaches) for seed in range(50)
    ]
    assert drawn.isdisjoint(some)


@pytest.mark.parametrize(("secret", "why"), [("", "is empty"), ("\udc80", "UTF-8")])
def test_a_secret_that_is_none(secret: str, why: str) -> None:
    for using in (paper, commitment_of):
        with pytest.raises(SecretError, match=f"^secret: .*{why}.*; give"):
            using(secret)


def test_a_cell_that_cannot_be_drawn_is_named() -> None:
    with pytest.raises(UnknownTownError, match=r"^cells\[1\]\.town: 'Town99' is not known; there are: .*Town01"):
        draw_cells("some@1", [cell("Town01"), cell("Town99")], "a secret")
    with pytest.raises(ApproachTooShortError, match=r"^cells\[0\]: no approach of type CROSS in Town01 has 20 m"):
        draw_cells("some@1", [cell("Town01", JunctionType.CROSS)], "a secret")


def test_possible_trials_are_all_that_a_draw_can_choose() -> None:
    possible = possible_trials(cell("Town01", JunctionType.STRAIGHT_LEFT))
    assert len({(trial.approach, trial.route) for trial in possible}) == len(possible) == 24
    assert {trial.route for trial in possible} == {Command.LEFT, Command.STRAIGHT}
    for trial in possible:
        is_sound(trial)


@pytest.mark.parametrize(
    ("file", "content", "error", "message"),
    [
        ("x@1.json", [cell("junctions", JunctionType.CROSS)], FaultNotApplicableError, "infeasible needs an approach"),
        ("x@1.json", [cell("nowhere")], UnknownTownError, "'nowhere' is not known"),
        ("x@1.json", [], ValueError, "content: is empty"),
        ("x.json", [cell("Town02")], ValueError, "'x' is no suite's id; name the file NAME@VERSION.json"),
        ("taken@1.json", [cell("Town02")], FileExistsError, "holds another suite, .* give this one a new version"),
    ],
)
def test_what_the_suite_maker_refuses(
    file: str, content: list[Cell], error: type[Exception], message: str, tmp_path: Path
) -> None:
    (tmp_path / "taken@1.json").write_text("another")
    with pytest.raises(error, match=message):
        write_suite(tmp_path / file, "A title", content)
