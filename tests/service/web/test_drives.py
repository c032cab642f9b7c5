"""The moments of a drive that an episode's page lists."""

import gzip
import math

import orjson
import pytest

from wrongturn_judge.trajectory import Row, Trajectory
from wrongturn_networks import draw_trial, load_town
from wrongturn_protocol import Command, FaultKind, Outcome, Verdict
from wrongturn_service.web import drives
from wrongturn_service.web.drives import Moment, moments

TOWN = load_town("Town01")
TRIAL = draw_trial(TOWN, "J3-S", FaultKind.NONE, 0)
AFAR = (-1000.0, -1000.0)
LEFT, RIGHT = Command.LEFT, Command.RIGHT


def drive(places: list[tuple[float, float]], told: list[Command], route: Command = LEFT) -> Trajectory:
    """A drive through these places, one for each decision; ``told`` are the commands for the time after them."""
    rows = [Row(0.0, *places[0], 0.0, 5.0, 0.0, told[0], route, 0.0, 0.0, 0.0)]
    for number, (place, command) in enumerate(zip(places[1:], told, strict=True)):
        rows += [Row(0.05 * (2 * number + i), *place, 0.0, 5.0, 0.0, command, route, 0.0, 0.0, 0.0) for i in (1, 2)]
    return Trajectory(TRIAL, TOWN.sha256, rows)


def listed(trajectory: Trajectory, first_stop_s: float | None = None) -> list[Moment]:
    end = trajectory.rows[-1].t
    outcome = Outcome(verdict=Verdict.TIMEOUT, time=end, max_deceleration=0, first_stop_s=first_stop_s)
    return moments(trajectory, outcome, TOWN)


def test_a_drive_in_which_nothing_happens_has_a_start_and_a_verdict() -> None:
    start, verdict = listed(drive([AFAR] * 5, [LEFT] * 4))
    assert (start.decision, start.t, start.verdict) == (0, 0.0, False)
    assert "18 km/h" in start.text
    assert "as on the route" in start.text
    assert (verdict.decision, verdict.t, verdict.verdict) == (4, pytest.approx(0.4), True)


def test_a_command_changes_at_the_decision_that_it_follows() -> None:
    start, wrong, right, _ = listed(drive([AFAR] * 6, [LEFT, LEFT, RIGHT, LEFT, LEFT]))
    assert "but the route" not in start.text
    assert (wrong.decision, wrong.t) == (2, pytest.approx(0.2))
    assert "but the route says" in wrong.text
    assert right.decision == 3
    assert "as on the route" in right.text


def test_junctions_are_entered_and_left() -> None:
    junction = next(iter(TOWN.junctions.values()))
    inside = junction.area.representative_point()
    found = listed(drive([AFAR, AFAR, (inside.x, inside.y), (inside.x, inside.y), AFAR], [LEFT] * 4))
    assert [(moment.decision, moment.text) for moment in found[1:-1]] == [
        (2, f"Enters the junction {junction.id}."),
        (4, f"Leaves the junction {junction.id}."),
    ]


@pytest.mark.parametrize(("first_stop_s", "decision"), [(0.0, 0), (0.15, 2), (0.2, 2), (99.0, 4)])
def test_a_stand_is_told_at_a_decision_of_the_drive(first_stop_s: float, decision: int) -> None:
    found = listed(drive([AFAR] * 5, [LEFT] * 4), first_stop_s)
    assert [moment.decision for moment in found if moment.text == "Begins to stand."] == [decision]


@pytest.mark.parametrize("changes", [99, 100, 101, 250])
def test_of_many_changes_the_first_hundred_are_listed_and_the_verdict(changes: int) -> None:
    told = [(LEFT, RIGHT)[number % 2] for number in range(changes + 1)]
    found = listed(drive([AFAR] * (changes + 2), told))
    shown = found[1:-1]
    assert [moment.decision for moment in shown[:100]] == list(range(1, min(changes, 100) + 1))
    said = [moment.text for moment in shown[100:]]
    assert said == ([f"{changes - 100} more changes are not listed."] if changes > 100 else [])
    assert found[-1].verdict
    assert [moment.t for moment in found] == sorted(moment.t for moment in found)


def test_the_map_gets_the_ends_of_boards() -> None:
    trial = draw_trial(TOWN, "J3-S", FaultKind.PROHIBITED, 0)
    for one, boards in ((TRIAL, False), (trial, True)):
        shown = orjson.loads(gzip.decompress(drives.drive(Trajectory(one, "", drive([AFAR] * 2, [LEFT]).rows))))
        assert ("boards" in shown) == boards
    x, y, x2, y2 = shown["boards"]
    assert 6.0 < math.dist((x, y), (x2, y2)) < 8.0  # between the middles of the outermost
