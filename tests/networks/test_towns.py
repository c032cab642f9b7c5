"""Towns by name: junctions by type, lanes, what the service shows of them."""

import math
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_networks import Town, UnknownApproachError, UnknownTownError, load_town, town_names
from wrongturn_networks.catalogue import checks, list_towns
from wrongturn_networks.junctions import direction_of
from wrongturn_protocol import DIRECTIONS, PAPER_TYPES, Command, FaultKind, JunctionType

MIRROR = {Command.LEFT: Command.RIGHT, Command.RIGHT: Command.LEFT, Command.STRAIGHT: Command.STRAIGHT}


def test_the_towns_that_there_are() -> None:
    assert town_names() == ("Town01", "Town02", "junctions")


@pytest.mark.parametrize(("name", "junctions", "of_each"), [("Town01", 12, 12), ("Town02", 8, 8)])
def test_every_t_type_is_there_as_often_as_there_are_junctions(name: str, junctions: int, of_each: int) -> None:
    town = load_town(name)
    assert len(town.junctions) == junctions
    assert Counter(a.type for a in town.approaches.values()) == dict.fromkeys(PAPER_TYPES, of_each)


def test_the_small_net_has_all_four_types() -> None:
    counts = Counter(approach.type for approach in load_town("junctions").approaches.values())
    assert counts == {**dict.fromkeys(PAPER_TYPES, 1), JunctionType.CROSS: 4}


def test_junctions_stand_where_the_figures_say() -> None:
    town01, town02 = load_town("Town01"), load_town("Town02")
    assert town01.junctions["J8"].position == (156.1, 271.1)
    assert town02.junctions["J8"].position == (0.0, 115.0)
    # Half a street (4 m lane, 2.5 m sidewalk) beyond the ring's centre lines.
    assert town01.bounds == pytest.approx((-6.5, -6.5, 394.4 + 6.5, 328.6 + 6.5), abs=0.05)
    assert town02.bounds == pytest.approx((-6.5, -6.5, 197.2 + 6.5, 197.2 + 6.5), abs=0.05)


def test_an_approach_is_named_by_the_arm_it_comes_from(town: Town) -> None:
    outward = {"E": (1, 0), "N": (0, 1), "W": (-1, 0), "S": (0, -1)}
    for approach in town.approaches.values():
        junction, arm = approach.id.split("-")
        assert junction == approach.junction
        position = town.junctions[junction].position
        offset = np.subtract(approach.stop_line, position)
        assert np.dot(offset, outward[arm]) > 8
        # Right-hand traffic: two metres right of the street's axis.
        right = (math.sin(approach.heading), -math.cos(approach.heading))
        assert np.dot(offset, right) == pytest.approx(2.0, abs=0.02)


def test_exits_are_in_order_and_turn_the_way_they_say(town: Town) -> None:
    for approach in town.approaches.values():
        assert list(approach.exits) == [d for d in DIRECTIONS if d in approach.type.exits]
        for direction, leaving in approach.exits.items():
            lane = town.lanes[leaving.lane]
            assert leaving.direction is direction
            assert lane.start_junction == approach.junction
            turn = lane.centreline[1] - lane.centreline[0]
            ahead = np.array([math.cos(approach.heading), math.sin(approach.heading)])
            cross = (ahead[0] * turn[1] - ahead[1] * turn[0]) / np.linalg.norm(turn)
            assert cross == pytest.approx({Command.LEFT: 1, Command.RIGHT: -1, Command.STRAIGHT: 0}[direction], abs=0.1)


def test_nobody_is_sent_back_into_his_own_street(town: Town) -> None:
    for approach in town.approaches.values():
        own = town.lanes[approach.lane].opposite
        assert own is not None
        assert all(leaving.lane != own for leaving in approach.exits.values())


def test_lanes_know_their_junctions_and_the_way_back(town: Town) -> None:
    for lane in town.lanes.values():
        assert lane.width == 4.0
        assert lane.length == pytest.approx(lane.polygon.area / lane.width, rel=0.02)
        assert lane.opposite is not None
        back = town.lanes[lane.opposite]
        assert (back.opposite, back.start_junction, back.end_junction) == (
            lane.id,
            lane.end_junction,
            lane.start_junction,
        )
        approach = town.approach_of_lane(lane.id)
        assert (approach is None) == (lane.end_junction is None)
        assert approach is None or approach.lane == lane.id


def test_arrays_cannot_be_changed(town: Town) -> None:
    approach = next(iter(town.approaches.values()))
    lane = town.lanes[approach.lane]
    for line in (lane.centreline, *(leaving.path for leaving in approach.exits.values())):
        assert line.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            line[0, 0] = 1.0


def test_a_town_is_read_once(town: Town) -> None:
    assert load_town(town.name) is town


@pytest.mark.parametrize(
    "name", ["", "town01", "../towns/Town01", "Town01/", "Town01\n", "..", "/etc", "Town01\0", "%2e", None, 1, [], {}]
)
def test_a_name_that_is_none_of_the_towns(name: Any) -> None:
    with pytest.raises(UnknownTownError, match=r"^town: .*Town01, Town02, junctions"):
        load_town(name)


def test_an_unknown_approach_names_the_known() -> None:
    with pytest.raises(UnknownApproachError, match=r"^approach: 'J9-S'.*J1-E"):
        load_town("junctions").approach("J9-S")
    assert load_town("junctions").approach_of_lane("nothing") is None


def test_what_the_service_shows_is_json(town: Town) -> None:
    faults = dict.fromkeys(town.approaches, (FaultKind.OMISSION,))
    detail = town.detail(faults)
    # GeoJSON's tuples come back as lists, so texts are compared.
    assert detail.model_validate_json(detail.model_dump_json()).model_dump_json() == detail.model_dump_json()
    assert {approach.id: approach.faults for approach in detail.approaches} == faults
    assert detail.road["type"] in {"Polygon", "MultiPolygon"}
    assert set(detail.junctions) == set(town.junctions)
    assert town.summary() in list_towns()
    assert sum(town.summary().approaches.values()) == len(town.approaches)


def test_the_doctor_finds_the_towns_and_suites_well() -> None:
    assert all(ok for _, ok, _, _ in checks())


@given(st.floats(-20, 20))
def test_a_turn_mirrored_is_the_mirrored_turn(turn: float) -> None:
    if abs(abs(math.remainder(turn, math.tau)) - math.pi) > 1e-9:  # straight back is both
        assert direction_of(-turn) is MIRROR[direction_of(turn)]


@pytest.mark.parametrize(
    ("degrees", "direction"),
    [
        (46, Command.LEFT),
        (44, Command.STRAIGHT),
        (-44, Command.STRAIGHT),
        (-46, Command.RIGHT),
        (350, Command.STRAIGHT),
    ],
)
def test_45_degrees_part_a_turn_from_straight_on(degrees: float, direction: Command) -> None:
    assert direction_of(math.radians(degrees)) is direction
