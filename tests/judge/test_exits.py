"""Leaving the junction: by which exit, how far, and on whose word; or the wrong way."""

import math

import pytest
from handmade_junction import FOLLOW, LEFT, RIGHT, STRAIGHT, arc, drive, junction, trial, verdict_of, way
from shapely import box

from wrongturn_protocol import DIRECTIONS, Command, Verdict

CROSS = junction()
WAYS = {STRAIGHT: 41.0, LEFT: 25.0 + 5 * math.pi, RIGHT: 25.0 + 3 * math.pi}
"""Metres from the start to each exit line."""


def verdict(rows: list, **wanted: object) -> Verdict:
    return verdict_of(rows, CROSS, trial(**wanted)).verdict


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("route", DIRECTIONS)
@pytest.mark.parametrize("command", [*DIRECTIONS, FOLLOW, Command.VOID])
def test_an_exit_counts_by_the_command_first_then_by_the_route(
    direction: Command, route: Command, command: Command
) -> None:
    outcome = verdict_of(drive(way(direction), [(9.0, 8.0)], command=command), CROSS, trial(route=route))
    if command is direction:
        assert outcome.verdict is Verdict.EXIT_COMMANDED
    elif route is direction:
        assert outcome.verdict is Verdict.EXIT_ROUTE
    else:
        assert outcome.verdict is Verdict.EXIT_OTHER
    assert outcome.exit is direction
    assert outcome.flags == ()


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize(("rear", "reached"), [(9.0, False), (9.99, False), (10.01, True), (12.0, True)])
def test_the_rear_bumper_must_be_ten_metres_past_the_exit_line(direction: Command, rear: float, reached: bool) -> None:
    path = way(direction, begin=25.0, out=rear + 2.3)
    rows = drive(path, [((WAYS[direction] + rear + 2.3) / 8.0 - 0.025, 8.0)], command=direction)
    # The last row stands at the path's very end, where the drive stays until the time is up.
    x, y = path[-1]
    rows = [row for row in rows if row.t < rows[-1].t]
    rest = [rows[-1]._replace(t=rows[-1].t + 0.05 * k, x=x, y=y, v=0.0) for k in range(1, 1300)]
    outcome = verdict_of([*rows, *rest], CROSS, trial())
    assert outcome.verdict is (Verdict.EXIT_COMMANDED if reached else Verdict.UNFINISHED)


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("degrees", "reached"), [(0, True), (20, True), (29.9, True), (30.1, False), (60, False)])
def test_the_heading_must_be_within_thirty_degrees(
    direction: Command, side: int, degrees: float, reached: bool
) -> None:
    turned = math.radians(degrees) * side
    begin = WAYS[direction] + 6.0  # until it is 20 m from the area
    rows = drive(
        way(direction), [(12.0, 8.0)], command=direction, yaw=lambda s: turned if begin < s < begin + 15.0 else 0.0
    )
    outcome = verdict_of(rows, CROSS, trial())
    assert outcome.verdict is (Verdict.EXIT_COMMANDED if reached else Verdict.WRONG_WAY)


@pytest.mark.parametrize(
    ("lateral", "reached"), [(0.0, True), (1.0, True), (1.99, True), (2.01, False), (4.0, False), (-1.0, True)]
)
def test_the_centre_must_be_in_the_exit_s_lane(lateral: float, reached: bool) -> None:
    outcome = verdict_of(drive(way(STRAIGHT, lateral=lateral), [(12.0, 8.0)], command=STRAIGHT), CROSS, trial())
    assert outcome.verdict is (Verdict.EXIT_COMMANDED if reached else Verdict.WRONG_WAY)


@pytest.mark.parametrize("told", [LEFT, RIGHT])
@pytest.mark.parametrize(
    ("until", "counts"), [(0.0, True), (4.0, True), (4.7, True), (5.3, False), (6.0, False), (9.0, False)]
)
def test_the_last_direction_up_to_five_metres_past_the_exit_line_counts(
    told: Command, until: float, counts: bool
) -> None:
    # The rows are 0.4 m apart; the one that ends past 5 m still carries what was delivered before them.
    def command(s: float) -> int:
        return STRAIGHT if s > WAYS[STRAIGHT] + until + 0.4 else told

    outcome = verdict_of(drive(way(STRAIGHT), [(9.0, 8.0)], command=command), CROSS, trial(route=told))
    assert outcome.verdict is (Verdict.EXIT_COMMANDED if counts else Verdict.EXIT_OTHER)


def test_lane_follow_after_a_direction_does_not_take_it_back() -> None:
    rows = drive(way(STRAIGHT), [(9.0, 8.0)], command=lambda s: STRAIGHT if 10 < s < 20 else FOLLOW)
    assert verdict(rows, route=LEFT) is Verdict.EXIT_COMMANDED
    rows = drive(way(STRAIGHT), [(9.0, 8.0)], command=lambda s: Command.VOID if s > 20 else STRAIGHT)
    assert verdict(rows, route=LEFT) is Verdict.EXIT_COMMANDED


def test_turned_round_into_the_own_arm_is_the_wrong_way() -> None:
    round_about = [(2.0, -30.0), *arc(2.0, -6.0, math.pi / 2, 2.0, math.pi), (-2.0, -60.0)]
    outcome = verdict_of(drive(round_about, [(20.0, 4.0)], command=LEFT), CROSS, trial())
    assert outcome.verdict is Verdict.WRONG_WAY
    assert outcome.exit is None


@pytest.mark.parametrize(("distance", "wrong"), [(15.0, False), (19.9, False), (20.1, True), (25.0, True)])
def test_the_wrong_way_is_more_than_twenty_metres_from_the_junction(distance: float, wrong: bool) -> None:
    rows = drive(way(STRAIGHT, lateral=4.0), [(5.0, 8.0)])
    held = [rows[-1]._replace(t=5.0 + 0.05 * k, y=8.0 + distance, yaw=-math.pi / 2) for k in range(1200)]
    outcome = verdict_of([*rows, *held], CROSS, trial())
    assert outcome.verdict is (Verdict.WRONG_WAY if wrong else Verdict.UNFINISHED)


@pytest.mark.parametrize(
    ("begins", "expected"), [(12.0, Verdict.WRONG_WAY), (20.0, Verdict.WRONG_WAY), (20.9, Verdict.EXIT_COMMANDED)]
)
def test_another_junction_before_the_exit_is_reached_is_the_wrong_way(begins: float, expected: Verdict) -> None:
    # The exit is reached with the centre at y = 20.3; rows are 0.4 m apart.
    geometry = junction(other_areas=[box(-4, begins, 4, begins + 8.0), box(50, 50, 60, 60)])
    outcome = verdict_of(drive(way(STRAIGHT), [(9.0, 8.0)], command=STRAIGHT), geometry, trial())
    assert outcome.verdict is expected


def test_another_junction_is_nothing_to_a_car_that_was_not_in_its_own() -> None:
    geometry = junction(other_areas=[box(-4, -30, 4, -20)])
    outcome = verdict_of(drive(way(STRAIGHT), [(9.0, 8.0)], command=STRAIGHT), geometry, trial())
    assert outcome.verdict is Verdict.EXIT_COMMANDED


def test_back_in_the_lane_before_twenty_metres_is_an_exit() -> None:
    path = [(2.0, -33.0), (2.0, -8.0), (-2.0, 4.0), (-2.0, 12.0), (2.0, 22.0), (2.0, 60.0)]
    outcome = verdict_of(drive(path, [(12.0, 8.0)], command=STRAIGHT), CROSS, trial())
    assert outcome.verdict is Verdict.EXIT_COMMANDED
    assert outcome.flags == ()
    assert 0.0 < (outcome.opposed_lane_m or 0.0) < 10.0


def test_an_exit_at_the_instant_of_twenty_metres_is_an_exit() -> None:
    rows = drive(way(STRAIGHT, lateral=4.0), [(5.0, 8.0)], command=STRAIGHT)
    last = rows[-1]
    path = [*rows, last._replace(t=5.0, y=27.9)]
    path += [last._replace(t=5.05 + k / 20, x=2.0, y=28.1 + 0.4 * k) for k in range(50)]
    assert verdict(path) is Verdict.EXIT_COMMANDED


def test_no_exit_without_the_junction() -> None:
    rows = [row._replace(y=row.y + 60.0) for row in drive(way(STRAIGHT), [(3.0, 8.0)], command=STRAIGHT)]
    assert verdict(rows) is Verdict.ABORTED
