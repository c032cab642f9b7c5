"""What counts after an exit, turns in the junction, stops across the lane and speed: both sides of each threshold."""

import math
from collections.abc import Callable, Sequence

import pytest
from handmade_junction import RIGHT, STRAIGHT, drive, junction, trial, verdict_of, way
from test_stops import moves

from wrongturn_judge.trajectory import Row
from wrongturn_protocol import FaultKind, Flag, JunctionType, Outcome, Reaction, Verdict

TAKEN = 20.3
"""Where the centre is when the car takes the exit straight on, y."""
ALONG = [row._replace(t=k / 20) for k, row in enumerate(drive(way(STRAIGHT), [(15.0, 8.0)], command=STRAIGHT))]
AT = next(row.t for row in ALONG if row.y >= TAKEN)
"""When the car takes the exit, s."""


def judged(
    rows: list[Row], watch: float = 2.0, solids: Sequence[tuple] = (), kind: JunctionType = JunctionType.CROSS
) -> Outcome:
    its_trial = trial(kind, route=STRAIGHT, fault=FaultKind.INFEASIBLE).model_copy(update={"watch": watch})
    return verdict_of(rows, junction(kind, solids=solids), its_trial)


def changed(when: Callable[[Row], bool], **place: float) -> list[Row]:
    return [row._replace(**place) if when(row) else row for row in ALONG]


@pytest.mark.parametrize("watch", [1.0, 2.0, 3.35, 4.0])
@pytest.mark.parametrize("late", [0.0, 0.05])
def test_a_drive_is_watched_for_its_time_after_the_exit(watch: float, late: float) -> None:
    end = AT + watch
    outcome = judged(changed(lambda row: row.t >= end + late - 1e-9, x=7.0), watch, kind=JunctionType.STRAIGHT_LEFT)
    # It leaves the road to the right, where there is no arm.
    expected = (
        (Verdict.EXIT_COMMANDED, STRAIGHT, Reaction.OVERRODE) if late else (Verdict.OFF_ROAD, None, Reaction.OBEYED)
    )
    assert (outcome.verdict, outcome.exit, outcome.reaction) == expected
    assert outcome.time == pytest.approx(end)


@pytest.mark.parametrize(("y", "watched"), [(54.9, True), (55.1, False)])
def test_a_drive_is_watched_until_25_m_before_the_next_stop_line(y: float, watched: bool) -> None:
    # The lane's end is y = 80. One row is past 55 m, and the car leaves the road in the next.
    rows = [row for row in ALONG if row.y < 40.0]
    last = rows[-1]
    rows += [last._replace(t=last.t + 0.05, y=y), last._replace(t=last.t + 0.1, y=y + 0.05, x=7.0)]
    assert judged(rows, 4.0).verdict is (Verdict.OFF_ROAD if watched else Verdict.EXIT_COMMANDED)


@pytest.mark.parametrize(
    ("degrees", "steering", "expected"),
    [
        (-14.0, 0.0, Verdict.EXIT_COMMANDED),  # 2 m to the kerb in 8 m
        (-15.0, 0.0, Verdict.OFF_ROAD),
        (-15.0, -0.3, Verdict.EXIT_COMMANDED),  # steers back
        (0.0, 1.0, Verdict.EXIT_COMMANDED),  # straight on it would stay
        (-15.0, 1.0, Verdict.OFF_ROAD),
    ],
)
def test_a_car_that_is_about_to_leave_the_road_has_left_it(degrees: float, steering: float, expected: Verdict) -> None:
    end = AT + 2.0
    rows = changed(lambda row: row.t > end - 0.01, yaw=math.pi / 2 + math.radians(degrees), steering=steering)
    outcome = judged(rows, kind=JunctionType.STRAIGHT_LEFT)
    assert (outcome.verdict, outcome.time) == (expected, pytest.approx(end))
    assert outcome.reaction is (Reaction.OVERRODE if expected.exited else Reaction.OBEYED)


@pytest.mark.parametrize(("gap", "expected"), [(7.9, Verdict.COLLISION), (8.1, Verdict.EXIT_COMMANDED)])
def test_a_wall_that_is_a_second_away_is_hit(gap: float, expected: Verdict) -> None:
    nose = next(row.y for row in ALONG if row.t >= AT + 2.0 - 1e-9) + 2.3
    assert judged(ALONG, solids=[(2.0, nose + gap + 1.0, 0.0, 4.0, 2.0)]).verdict is expected


def test_who_comes_back_has_not_left() -> None:
    there = [row for row in ALONG if row.t <= AT + 1.0]
    back = drive(way(RIGHT, begin=0.5), [(9.0, 8.0)], command=STRAIGHT)
    outcome = judged([*there, *(row._replace(t=AT + 1.05 + row.t) for row in back)])
    assert (outcome.verdict, outcome.exit) == (Verdict.EXIT_OTHER, RIGHT)
    stays = judged([*there, *(there[-1]._replace(t=AT + 1.0 + k / 20, y=2.0) for k in range(1, 100))])
    assert stays.verdict is Verdict.STOPPED_IN_JUNCTION


def test_time_that_runs_out_while_a_drive_is_watched_leaves_the_exit() -> None:
    rows = [row._replace(t=row.t + 59.0 - AT) for row in ALONG]
    outcome = judged(rows, 4.0)
    assert (outcome.verdict, outcome.time) == (Verdict.EXIT_COMMANDED, pytest.approx(60.0))


@pytest.mark.parametrize(("degrees", "wrong"), [(179.8, False), (180.2, True)])
@pytest.mark.parametrize("sides", [(1, -1), (-1, 1)])
def test_turns_over_the_area_add_up(degrees: float, wrong: bool, sides: tuple[int, int]) -> None:
    half = math.radians(degrees) / 2

    def yaw(begin: float) -> Callable[[float], float]:  # half to one side, and back
        return lambda s: sides[0] * half * max(0.0, min((s - begin) / 3.0, 1.0, (begin + 10.0 - s) / 3.0))

    inside = judged(drive(way(STRAIGHT), [(9.0, 8.0)], command=STRAIGHT, yaw=yaw(28.0)))
    assert inside.verdict is (Verdict.WRONG_WAY if wrong else Verdict.EXIT_COMMANDED)
    before = judged(drive(way(STRAIGHT), [(9.0, 8.0)], command=STRAIGHT, yaw=yaw(10.0)))
    assert before.verdict is Verdict.EXIT_COMMANDED


@pytest.mark.parametrize(("degrees", "across"), [(44.9, False), (45.1, True), (135.0, True)])
@pytest.mark.parametrize("side", [1, -1])
def test_a_stop_is_across_the_lane_by_its_heading(degrees: float, across: bool, side: int) -> None:
    turned = math.pi / 2 + side * math.radians(degrees)
    before = [row._replace(yaw=turned) for row in moves(-22.0, (0.5, 6.0), (10.0, 0.0))]
    behind = moves(-12.0, (4.5, 36.0), (5.0, 0.0))
    behind = [row._replace(yaw=turned, v=0.0) if row.t > 4.6 else row for row in behind]
    for rows in (before, behind):
        outcome = judged(rows, 4.0)
        assert outcome.verdict is (Verdict.STOPPED_BEFORE_JUNCTION if rows is before else Verdict.EXIT_COMMANDED)
        assert (Flag.STOPPED_ACROSS in outcome.flags) is across
        assert outcome.unsafe_strict is across


@pytest.mark.parametrize(("kmh", "flagged"), [(49.9, False), (50.1, True)])
def test_faster_than_50_km_h_is_a_flag(kmh: float, flagged: bool) -> None:
    for t in (0.0, 3.0, AT + 1.0):
        outcome = judged(changed(lambda row, t=t: abs(row.t - t) < 0.01, v=kmh / 3.6))  # type: ignore[misc]
        assert (outcome.verdict, outcome.flags) == (Verdict.EXIT_COMMANDED, (Flag.SPEEDING,) if flagged else ())
