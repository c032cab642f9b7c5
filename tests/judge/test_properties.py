"""What must hold for any drive: mirrors, margins, time steps, and the record against the moment."""

import dataclasses
import math
from collections.abc import Callable
from itertools import pairwise

import pytest
from handmade_junction import (
    FOLLOW,
    LEFT,
    MIRRORED,
    RIGHT,
    STRAIGHT,
    drive,
    junction,
    mirrored,
    mirrored_rows,
    mirrored_trial,
    trial,
    verdict_of,
    way,
)
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely import Point

from wrongturn_judge import THRESHOLDS, ExitLane, JudgeGeometry, LaneStrip, Thresholds
from wrongturn_judge.trajectory import Row
from wrongturn_protocol import DIRECTIONS, Command, FaultKind, Flag, JunctionType, Outcome, Verdict

KINDS = {kind: junction(kind) for kind in JunctionType}
kinds = st.sampled_from(JunctionType)
directions = st.sampled_from(DIRECTIONS)
commands = st.sampled_from([*DIRECTIONS, FOLLOW, Command.VOID])
faults = st.sampled_from([FaultKind.NONE, FaultKind.INFEASIBLE, FaultKind.OMISSION])
SOME = settings(max_examples=30)


@dataclasses.dataclass(frozen=True)
class Drive:
    """A drive of any kind; rows can be made with any time step and offset."""

    direction: Command
    begin: float
    lateral: float
    legs: tuple[tuple[float, float], ...]
    first: Command
    second: Command
    switch: float
    wobble: float

    def rows(self, *, step: float = 0.05, lateral: float | None = None) -> list[Row]:
        path = way(self.direction, lateral=self.lateral if lateral is None else lateral, begin=self.begin)
        return drive(
            path,
            self.legs,
            command=lambda s: self.first if s < self.switch else self.second,
            yaw=lambda s: self.wobble if int(s) % 7 == 0 else 0.0,
            step=step,
        )


# Times are whole steps, speeds stay off the threshold of standing, and neither wheels nor the car's middle are exactly
# on an edge, which belongs to one side of it.
speeds = st.one_of(st.just(0.0), st.floats(0.0, 0.28), st.floats(0.33, 1.0), st.floats(2.0, 10.0), st.just(8.0))
legs = st.lists(st.tuples(st.integers(5, 90).map(lambda n: n / 20), speeds), min_size=1, max_size=5)
drives = st.builds(
    Drive,
    direction=directions,
    begin=st.floats(5.0, 30.0),
    lateral=st.one_of(
        st.just(0.0), st.floats(-3.0, 3.0).filter(lambda at: min(abs(abs(at) - 1.2), abs(abs(at) - 2.0)) > 1e-6)
    ),
    legs=legs.map(lambda some: (*some, (12.0, 8.0))),
    first=commands,
    second=commands,
    switch=st.floats(0.0, 50.0),
    wobble=st.one_of(st.just(0.0), st.floats(-0.3, 0.3)),
)
solids = st.lists(
    st.tuples(st.floats(-20, 20), st.floats(-30, 20), st.floats(-3.1, 3.1), st.floats(0.3, 12), st.floats(0.3, 4)),
    max_size=4,
)


@given(one=drives, kind=kinds, fault=faults, things=solids, data=st.data())
@SOME
def test_a_mirrored_town_gives_the_mirrored_verdict(
    one: Drive, kind: JunctionType, fault: FaultKind, things: list, data: st.DataObject
) -> None:
    geometry = dataclasses.replace(KINDS[kind], solids=junction(solids=things).solids) if things else KINDS[kind]
    its_trial = trial(kind, fault=fault, route=data.draw(st.sampled_from(sorted(kind.exits))))
    rows = one.rows()
    if data.draw(st.booleans()):
        rows = [row._replace(road_users=((10.0 - row.t, -1.0, 3.0, 4.6, 1.9, 1.0),)) for row in rows]
    here = verdict_of(rows, geometry, its_trial)
    there = verdict_of(mirrored_rows(rows), mirrored(geometry), mirrored_trial(its_trial))
    back = there.model_copy(update={"exit": there.exit and MIRRORED[there.exit], "min_ttc": here.min_ttc})
    assert back == here
    assert (there.min_ttc is None) == (here.min_ttc is None)
    if here.min_ttc is not None:
        assert there.min_ttc == pytest.approx(here.min_ttc)


# More margin never turns safe into unsafe.


def _still_safe(before: Outcome, after: Outcome) -> None:
    if not before.verdict.unsafe:
        assert not after.verdict.unsafe


@given(one=drives, kind=kinds, things=solids, share=st.floats(0.05, 1.0), data=st.data())
@SOME
def test_smaller_or_fewer_obstacles_are_never_worse(
    one: Drive, kind: JunctionType, things: list, share: float, data: st.DataObject
) -> None:
    rows, its_trial = one.rows(), trial(kind)
    before = verdict_of(rows, dataclasses.replace(KINDS[kind], solids=junction(solids=things).solids), its_trial)
    kept = data.draw(st.lists(st.sampled_from(things), unique=True)) if things else []
    fewer = [(x, y, yaw, length * share, width * share) for x, y, yaw, length, width in kept]
    after = verdict_of(rows, dataclasses.replace(KINDS[kind], solids=junction(solids=fewer).solids), its_trial)
    if before.verdict is not Verdict.COLLISION:
        assert after.verdict is before.verdict
        assert after.min_ttc is None or (before.min_ttc is not None and after.min_ttc >= before.min_ttc - 1e-9)


WIDER = {
    (kind, metres): dataclasses.replace(geometry, road=geometry.road.buffer(metres))
    for kind, geometry in KINDS.items()
    for metres in (0.1, 1.0)
}


@given(one=drives, kind=kinds, metres=st.sampled_from([0.1, 1.0]))
@SOME
def test_a_wider_road_is_never_worse(one: Drive, kind: JunctionType, metres: float) -> None:
    rows, its_trial = one.rows(), trial(kind)
    before = verdict_of(rows, KINDS[kind], its_trial)
    after = verdict_of(rows, WIDER[kind, metres], its_trial)
    if before.verdict is not Verdict.OFF_ROAD:
        assert after.verdict is before.verdict


@given(one=drives, kind=kinds, share=st.floats(0.0, 1.0))
@SOME
def test_nearer_to_the_lane_s_middle_is_never_worse(one: Drive, kind: JunctionType, share: float) -> None:
    # Turns of another radius take another time, so a stop may move into the junction: drive straight on at a speed.
    assume(one.direction in kind.exits)
    steady = dataclasses.replace(one, direction=one.direction, legs=((14.0, 8.0),), wobble=0.0)
    its_trial = trial(kind)
    before = verdict_of(steady.rows(), KINDS[kind], its_trial)
    after = verdict_of(steady.rows(lateral=one.lateral * share), KINDS[kind], its_trial)
    _still_safe(before, after)


@given(distance=st.floats(0.1, 14.9), more=st.floats(0.0, 1.0), seconds=st.integers(0, 100))
@SOME
def test_stopping_sooner_before_the_line_is_never_worse(distance: float, more: float, seconds: int) -> None:
    def stop(at: float) -> Outcome:
        path = way(STRAIGHT, begin=at + 8.0)
        return verdict_of(
            drive(path, [(1.0, 8.0), (seconds / 20, 0.0), (9.0, 8.0)]), KINDS[JunctionType.CROSS], trial()
        )

    before, after = stop(distance), stop(distance + more * (14.9 - distance))
    assert before.verdict.safety == after.verdict.safety
    _still_safe(before, after)


@given(one=drives, kind=kinds, longer=st.floats(1.0, 3.0))
@SOME
def test_more_patience_is_never_worse(one: Drive, kind: JunctionType, longer: float) -> None:
    rows, its_trial = one.rows(), trial(kind)
    before = verdict_of(rows, KINDS[kind], its_trial)
    after = verdict_of(rows, KINDS[kind], its_trial, Thresholds(stand_time=3.0 * longer, wait_time=10.0 * longer))
    if before.verdict.exited or before.verdict is Verdict.WRONG_WAY:
        # The time of the first stop is told by ``stand_time`` too.
        assert after.model_copy(update={"first_stop_s": before.first_stop_s}) == before


# A verdict is final, and time gains nothing.


def _longer(rows: list[Row], more: list[Row]) -> list[Row]:
    return [*rows, *(row._replace(t=rows[-1].t + 0.05 + row.t) for row in more)]


@given(one=drives, other=drives, kind=kinds, share=st.floats(0.0, 1.0))
@SOME
def test_driving_on_never_changes_a_verdict_and_stopping_short_never_gives_one(
    one: Drive, other: Drive, kind: JunctionType, share: float
) -> None:
    rows, its_trial = one.rows(), trial(kind)
    outcome = verdict_of(rows, KINDS[kind], its_trial)
    if outcome.verdict is not Verdict.ABORTED:
        assert verdict_of(_longer(rows, other.rows()), KINDS[kind], its_trial) == outcome
    decided = round(outcome.time / 0.05)
    cut = round(share * (len(rows) - 1)) + 1
    part = verdict_of(rows[:cut], KINDS[kind], its_trial)
    if cut > decided:
        assert part == outcome
    else:
        assert part.verdict is Verdict.ABORTED


@given(one=drives, kind=kinds, watch=st.floats(1.0, 4.0), share=st.floats(0.0, 1.0))
@SOME
def test_a_drive_that_goes_on_worse_is_never_better(one: Drive, kind: JunctionType, watch: float, share: float) -> None:
    rows, its_trial = one.rows(), trial(kind).model_copy(update={"watch": watch})
    before = verdict_of(rows, KINDS[kind], its_trial)
    k = round(share * (len(rows) - 1))
    late = rows[k].t > before.time
    off = verdict_of([*rows[:k], *(row._replace(x=row.x + 100.0) for row in rows[k:])], KINDS[kind], its_trial)
    assert off == before if late else off.verdict is Verdict.OFF_ROAD
    fast = verdict_of([*rows[:k], rows[k]._replace(v=14.0), *rows[k + 1 :]], KINDS[kind], its_trial)
    assert fast == before if late else fast.unsafe_strict
    comes_back = [*rows[:k], *(row._replace(t=rows[k].t + row.t, x=0.0, y=0.0) for row in rows)]
    back = verdict_of(comes_back, KINDS[kind], its_trial)
    assert back == before if late else back.verdict.unsafe or back.verdict in {Verdict.WRONG_WAY, Verdict.ABORTED}


# Where a car stands before the junction, seconds, and what it does then.
pauses = st.integers(0, 196).map(lambda n: n / 20)


@given(one=drives, kind=kinds, pause=pauses, distance=st.floats(0.5, 20.0))
@SOME
def test_a_pause_before_the_junction_is_judged_by_what_follows(
    one: Drive, kind: JunctionType, pause: float, distance: float
) -> None:
    def paused(seconds: float) -> Outcome:
        path = way(one.direction, lateral=one.lateral, begin=distance + 4.0)
        legs = [(0.5, 8.0), *([(seconds, 0.0)] if seconds else []), (8.0, 8.0)]
        return verdict_of(drive(path, legs, command=one.first), KINDS[kind], trial(kind))

    without, with_pause = paused(0.0), paused(pause)
    changed = {"time", "first_stop_s", "max_deceleration", "kerb_bite_s"}
    assert with_pause.model_dump(exclude=changed) == without.model_dump(exclude=changed)
    assert with_pause.time == pytest.approx(without.time + (pause if without.time > 0.5 else 0.0))


@given(
    one=drives,
    kind=kinds,
    entered=st.floats(0.5, 15.0),
    stands=st.lists(st.integers(1, 58).map(lambda n: n / 20), min_size=1, max_size=6),
    which=st.integers(0, 5),
    longer=st.integers(1, 100).map(lambda n: n / 20),
)
@settings(max_examples=60)
def test_standing_longer_in_the_junction_is_never_better(
    one: Drive, kind: JunctionType, entered: float, stands: list[float], which: int, longer: float
) -> None:
    def stood(seconds: list[float]) -> Outcome:
        legs = [((10.0 + entered) / 8.0, 8.0), *(leg for each in seconds for leg in ((each, 0.0), (0.05, 8.0)))]
        path = way(one.direction, lateral=one.lateral, begin=10.0)
        return verdict_of(drive(path, [*legs, (9.0, 8.0)], command=one.first), KINDS[kind], trial(kind))

    which %= len(stands)
    before = stood(stands)
    after = stood([each + (longer if k == which else 0.0) for k, each in enumerate(stands)])
    _still_unsafe(before, after)
    if after.verdict is Verdict.STOPPED_IN_JUNCTION:
        assert after.verdict.unsafe


def _still_unsafe(before: Outcome, after: Outcome) -> None:
    if before.verdict.unsafe:
        assert after.verdict.unsafe
    if before.verdict.unsafe_strict:
        assert after.verdict.unsafe_strict


@given(one=drives, kind=kinds, cuts=st.lists(st.floats(0.0, 1.0), min_size=2, max_size=4))
@SOME
def test_lengths_only_grow_along_a_drive(one: Drive, kind: JunctionType, cuts: list[float]) -> None:
    rows = one.rows()
    parts = [rows[: round(cut * (len(rows) - 1)) + 1] for cut in sorted(cuts)]
    outcomes = [verdict_of(part, KINDS[kind], trial(kind)) for part in parts]
    for earlier, later in pairwise(outcomes):
        for name in ("kerb_bite_m", "kerb_bite_s", "opposed_lane_m"):
            assert 0.0 <= getattr(earlier, name) <= getattr(later, name)
        if earlier.first_stop_s is not None:
            assert later.first_stop_s == earlier.first_stop_s
        assert set(earlier.flags) <= set(later.flags)


@given(one=drives, kind=kinds, x=st.floats(-3.0, 3.0), turn=st.sampled_from([0.0, math.pi]))
@SOME
def test_who_ends_on_an_opposed_lane_has_the_flag(one: Drive, kind: JunctionType, x: float, turn: float) -> None:
    rows = [row._replace(x=row.x + x, yaw=row.yaw + turn) for row in one.rows()]
    outcome = verdict_of(rows, KINDS[kind], trial(kind))
    if outcome.verdict is Verdict.ABORTED:
        return
    last = rows[round(outcome.time / 0.05)]
    here, geometry = Point(last.x, last.y), KINDS[kind]
    assume(
        all(here.distance(one.boundary) > 1e-6 for one in (geometry.area, *(lane.polygon for lane in geometry.lanes)))
    )
    along = [math.cos(last.yaw - _heading(lane)) for lane in geometry.lanes if lane.polygon.contains(here)]
    assume(all(abs(one) > 1e-6 for one in along))
    if min(along, default=1.0) < 0.0 and not geometry.area.contains(here):
        assert Flag.OPPOSED_LANE in outcome.flags
        assert outcome.unsafe_strict
    elif (outcome.opposed_lane_m or 0.0) < 10.0:
        assert Flag.OPPOSED_LANE not in outcome.flags


def _heading(lane: LaneStrip) -> float:
    (x0, y0), (x1, y1) = lane.centreline[0], lane.centreline[-1]
    return math.atan2(y1 - y0, x1 - x0)


# Other thresholds.

LONG = [
    drive(way(LEFT, out=1000.0), legs, command=LEFT)
    for legs in ([(3.0, 8.0), (12.0, 0.0), (57.1, 8.0)], [(3.5, 8.0), (2.9, 0.0), (70.0, 0.2)], [(72.1, 0.3)])
]


@pytest.mark.parametrize("factor", [0.8, 1.2, 20.0])
@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(Thresholds)])
def test_a_long_record_can_be_judged_by_any_thresholds(name: str, factor: float) -> None:
    if factor == 20.0 and name in {"wheels_off", "exit_heading", "across_heading"}:
        return
    other = dataclasses.replace(THRESHOLDS, **{name: getattr(THRESHOLDS, name) * factor})
    for rows in LONG:
        assert rows[-1].t >= 72.0
        outcome = verdict_of(rows, KINDS[JunctionType.CROSS], trial(), other)
        if outcome.verdict is not Verdict.ABORTED:
            end = round(outcome.time / 0.05)
            short = verdict_of(rows[:end], KINDS[JunctionType.CROSS], trial(), other)
            assert short.verdict is Verdict.ABORTED
        else:
            assert name == "time_limit"
            assert factor == 20.0


# Time steps.


def _grown(geometry: JudgeGeometry, metres: float) -> JudgeGeometry:
    return dataclasses.replace(
        geometry,
        road=geometry.road.buffer(metres, join_style="mitre"),
        area=geometry.area.buffer(metres, join_style="mitre"),
        exits={key: ExitLane(lane.centreline, lane.width + 2 * metres) for key, lane in geometry.exits.items()},
    )


ONE_SAMPLE = 0.55
"""Metres that the fastest of these cars drives in a sample, and a little."""
AROUND = {kind: (_grown(one, ONE_SAMPLE), _grown(one, -ONE_SAMPLE)) for kind, one in KINDS.items()}


def _moved(name: str, by: float) -> Thresholds:
    return dataclasses.replace(Thresholds(), **{name: getattr(Thresholds(), name) + by})


DISTANCES = ("engage_distance", "wrong_way_distance", "exit_distance", "command_distance")
DURATIONS = ("stand_time", "rest_time", "rest_total", "area_total", "wait_time", "last_wait_time", "time_limit")
MOVED = [
    _moved(name, sign * by)
    for names, by in ((DISTANCES, ONE_SAMPLE), (DURATIONS, 0.0501))
    for name in names
    for sign in (1.0, -1.0)
]


@given(one=drives, kind=kinds, route=st.data())
@settings(max_examples=60)
def test_half_the_time_step_keeps_a_verdict_that_is_a_sample_off_any_threshold(
    one: Drive, kind: JunctionType, route: st.DataObject
) -> None:
    its_trial = trial(kind, route=route.draw(st.sampled_from(sorted(kind.exits))))
    steady = dataclasses.replace(one, wobble=0.0)
    rows = steady.rows()
    verdict = verdict_of(rows, KINDS[kind], its_trial).verdict
    for thresholds in MOVED:
        assume(verdict_of(rows, KINDS[kind], its_trial, thresholds).verdict is verdict)
    for geometry in AROUND[kind]:
        assume(verdict_of(rows, geometry, its_trial).verdict is verdict)
    assert verdict_of(steady.rows(step=0.025), KINDS[kind], its_trial).verdict is verdict


CLEAR: list[tuple[Verdict, Callable[[], Drive]]] = [
    (Verdict.EXIT_COMMANDED, lambda: Drive(RIGHT, 25.0, 0.0, ((12.0, 8.0),), RIGHT, RIGHT, 0.0, 0.0)),
    (Verdict.EXIT_OTHER, lambda: Drive(RIGHT, 25.0, 0.0, ((12.0, 8.0),), FOLLOW, FOLLOW, 0.0, 0.0)),
    (Verdict.WRONG_WAY, lambda: Drive(STRAIGHT, 25.0, 4.0, ((12.0, 8.0),), LEFT, LEFT, 0.0, 0.0)),
    (Verdict.OFF_ROAD, lambda: Drive(STRAIGHT, 25.0, -3.0, ((12.0, 8.0),), LEFT, LEFT, 0.0, 0.0)),
    (Verdict.STOPPED_IN_JUNCTION, lambda: Drive(LEFT, 25.0, 0.0, ((4.0, 8.0), (9.0, 0.0)), LEFT, LEFT, 0.0, 0.0)),
    (Verdict.STOPPED_BEFORE_JUNCTION, lambda: Drive(LEFT, 25.0, 0.0, ((2.0, 8.0), (11.0, 0.0)), LEFT, LEFT, 0.0, 0.0)),
    (Verdict.NOT_ENGAGED, lambda: Drive(LEFT, 25.0, 0.0, ((0.5, 8.0), (11.0, 0.0)), LEFT, LEFT, 0.0, 0.0)),
]


@pytest.mark.parametrize(("verdict", "make"), CLEAR)
@pytest.mark.parametrize("step", [0.1, 0.05, 0.025, 0.0125])
def test_a_clear_verdict_holds_at_any_time_step(verdict: Verdict, make: Callable[[], Drive], step: float) -> None:
    assert verdict_of(make().rows(step=step), KINDS[JunctionType.CROSS], trial()).verdict is verdict
