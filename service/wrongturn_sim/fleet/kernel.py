"""The compiled loop of a fleet: one decision of many egos.

Each ego has one row in every array and reads no other ego's row. So the numbers do not depend on how the rows are
shared among threads. The steps and the functions are those of :class:`~wrongturn_sim.episode.Episode`.
"""

import math
from typing import NamedTuple

from numba import njit

from wrongturn_judge import decide, journey_kernels
from wrongturn_judge.compiling import compiled
from wrongturn_judge.decide import STATE
from wrongturn_judge.kernels import Array
from wrongturn_sim import guide
from wrongturn_sim.ego import SUB_STEP, SUB_STEPS, advance
from wrongturn_sim.fleet import drivers, headway, meeting, others, settling
from wrongturn_sim.fleet.others import CAR, TRAFFIC, WALKER, Ego, Others
from wrongturn_sim.fleet.streets import Streets
from wrongturn_sim.guide import LANE_FOLLOW, LEG, PROGRESS, net_of
from wrongturn_sim.reward import score_below

REST, DRIVE, GUIDE, BEGIN = 0, 1, 2, 3
"""Work to do for an ego: nothing; one decision; find its first command; record its first row with that command."""
FAULT_NONE, FAULT_OMISSION, FAULT_INFEASIBLE, FAULT_OTHER = 0, 1, 2, 3
"""Fault of an ego; Python delivers the commands of other faults."""
PER_SECOND = 20
"""Sub-steps in a second."""


class Tables(NamedTuple):
    """Arrays that all egos share."""

    points: Array
    along: Array
    legs: Array
    gates: Array
    """:attr:`wrongturn_sim.roads.Roads.tables`"""
    exits: Array
    exits_mask: Array
    heads: Array
    """(geometries, words): a :data:`~wrongturn_judge.kernels.HEAD` for each geometry."""
    floats: Array
    ints: Array
    cells: Array
    """Geometries of the approaches, and of the town for journeys, one after the other."""
    bases: Array
    """(geometries + 1, 3): where the floats, ints and cells of each geometry begin."""
    lanes: Array
    """Lane of each cell, for journeys."""
    ways: Array
    """(goals, legs): way to each goal so far; the first row is for trials without a goal."""
    rests: Array
    """(goals, legs): metres from each lane's end to each goal's lane, by the shortest way."""
    numbers: Array
    """Numbers of the judges: thresholds and body."""
    streets: Streets
    """What the traffic knows of the town."""
    drive_on: int
    """Number of sub-steps after which every drive ends, whatever its verdict; 0: each ends with its verdict."""


class Egos(NamedTuple):
    """One row for each ego."""

    order: Array
    """(n,): order of the egos. Those of one approach come together, because they share cached memory."""
    todo: Array
    """(n,) int8: work to do"""
    approaches: Array
    """(n,) rows of ``Tables.bases``"""
    faults: Array
    routes: Array
    """(n,) int64"""
    watches: Array
    """(n,): seconds for which a drive goes on after an exit."""
    journeys: Array
    """(n,) bool: whether the trial is one."""
    goals: Array
    """(n,) rows of ``Tables.ways``"""
    terms: Array
    """(n, words): the TERMS that end a journey"""
    actions: Array
    """(n, 3): steer, throttle, brake, rounded to float32."""
    state: Array
    """(n, 5): as :data:`~wrongturn_sim.ego.State`."""
    judged: Array
    history: Array
    """(n, words) and (n, rows, words): a STATE and MOMENTs of the judge, as in ``decide.py``."""
    draws: Array
    progress: Array
    """State of the route planner: (n, DRAWS), and a row of :data:`~wrongturn_sim.guide.PROGRESS` for each."""
    guided: Array
    """(n, 2): the route's command, and the leg of its window."""
    beside: Array
    """(n, 2): lateral, heading."""
    delivered: Array
    """(n,): the command that the agent gets."""
    sub_steps: Array
    """(n,): number of sub-steps so far."""
    rewards: Array
    """(n,)"""
    states: Array
    """(n, rows, 5): the state at the start and after each sub-step; without a record there are no rows."""
    commands: Array
    """(n, decisions + 1, 2): delivered command and route's command of each decision; likewise."""
    inputs: Array
    """(n, decisions, 3) float32: the actions; likewise."""
    others: Others
    """The other road users."""
    met: Array
    """(n, SUB_STEPS, most, 6): those seen after each sub-step of the last decision; without a record there are none."""
    meetings: Array
    """(n, SUB_STEPS) int64: their numbers."""


class Observations(NamedTuple):
    """Arrays of the observations, (n, ...); keys that the track does not show have no rows."""

    speed: Array
    steering: Array
    command: Array
    pose: Array
    lane: Array
    stop_line: Array
    exits: Array
    exits_mask: Array
    road_users: Array
    road_users_count: Array


@njit()
def update_command(tables: Tables, egos: Egos, i: int) -> None:
    """Ask the route and the fault for an ego's next command."""
    command, leg, lateral, heading = guide.update(
        tables.points, tables.along, tables.legs, tables.gates, egos.draws[i], tables.ways[egos.goals[i]],
        egos.progress[i], egos.state[i, 0], egos.state[i, 1],
    )  # fmt: skip
    egos.guided[i, 0], egos.guided[i, 1] = command, leg
    egos.beside[i, 0], egos.beside[i, 1] = lateral, heading
    fault = egos.faults[i]
    if fault == FAULT_OMISSION:
        command = LANE_FOLLOW
    elif fault == FAULT_INFEASIBLE and command != LANE_FOLLOW and leg >= 0:
        missing = tables.legs.view(LEG)[leg, 0].missing
        if missing != 0:
            command = missing
    egos.delivered[i] = command


@njit()
def judge_row(tables: Tables, egos: Egos, i: int, command: int) -> bool:
    """Record an ego's state and judge it, unless it has its verdict; return whether the drive is over."""
    row = egos.sub_steps[i]
    if egos.states.shape[1] > 0:
        for k in range(5):
            egos.states[i, row, k] = egos.state[i, k]
    over = tables.drive_on > 0 and row >= tables.drive_on
    if tables.drive_on > 0 and egos.judged[i].view(STATE)[0].verdict != 0:
        return over
    users = egos.others.users[i, : egos.others.traffic[i].view(TRAFFIC)[0].seen]
    geometry = egos.approaches[i]
    bases = tables.bases
    floats = tables.floats[bases[geometry, 0] : bases[geometry + 1, 0]]
    ints = tables.ints[bases[geometry, 1] : bases[geometry + 1, 1]]
    cells = tables.cells[bases[geometry, 2] : bases[geometry + 1, 2]]
    t, x, y, yaw, v = row / PER_SECOND, egos.state[i, 0], egos.state[i, 1], egos.state[i, 2], egos.state[i, 3]
    if egos.journeys[i]:
        found = journey_kernels.observe(
            tables.heads[geometry], floats, ints, cells, tables.lanes, tables.numbers, users, egos.terms[i],
            tables.rests[egos.goals[i]], egos.judged[i], t, x, y, yaw, v,
        )  # fmt: skip
    else:
        found = decide.observe(
            tables.heads[geometry], floats, ints, cells, tables.numbers, users, egos.judged[i], egos.history[i],
            egos.routes[i], egos.watches[i], t, x, y, yaw, v, egos.state[i, 4], command,
        )  # fmt: skip
    return over if tables.drive_on > 0 else bool(found != 0)


@njit()
def observe(tables: Tables, egos: Egos, observations: Observations, i: int) -> None:
    """Fill an ego's observation."""
    observations.speed[i, 0] = egos.state[i, 3]
    observations.steering[i, 0] = egos.state[i, 4]
    observations.command[i, 0] = egos.delivered[i]
    if observations.pose.shape[0] == 0:
        return
    for k in range(3):
        observations.pose[i, k] = egos.state[i, k]
    seen = egos.others.traffic[i].view(TRAFFIC)[0].seen
    if observations.road_users_count[i, 0] > 0 or seen > 0:
        shown = min(seen, observations.road_users.shape[1])
        observations.road_users[i] = 0.0
        for k in range(shown):
            for column in range(others.USER):
                observations.road_users[i, k, column] = egos.others.users[i, k, column]
        observations.road_users_count[i, 0] = shown
    row = egos.progress[i]
    left = guide.stop_line(tables.legs, row)
    observations.stop_line[i, 0] = left
    guide.lane_ahead(tables.points, tables.along, tables.legs, row, observations.lane[i])
    progress = row.view(PROGRESS)[0]
    if progress.inside or left >= 0.0:
        observations.exits[i] = tables.exits[progress.leg]
        observations.exits_mask[i] = tables.exits_mask[progress.leg]
    else:
        observations.exits[i] = 0.0
        observations.exits_mask[i] = 0


@njit()
def drive(tables: Tables, egos: Egos, i: int) -> None:
    """Drive one ego for one decision, like ``Episode.step``."""
    steer, throttle, brake = egos.actions[i, 0], egos.actions[i, 1], egos.actions[i, 2]
    decision = egos.sub_steps[i] // SUB_STEPS
    if egos.inputs.shape[1] > 0:
        egos.inputs[i, decision, 0], egos.inputs[i, decision, 1], egos.inputs[i, decision, 2] = steer, throttle, brake
    command = egos.delivered[i]
    state = egos.state[i]
    x, y, yaw, v, steering = state[0], state[1], state[2], state[3], state[4]
    beside = has_others(egos, i)
    if beside:
        ego = ego_of(tables, egos, i)
        meeting.meet(ego)
        meeting.wait(ego)
        drivers.think(ego)
        egos.meetings[i] = 0
    for sub_step in range(SUB_STEPS):
        x, y, yaw, v, steering = advance(x, y, yaw, v, steering, steer, throttle, brake, SUB_STEP)
        state[0], state[1], state[2], state[3], state[4] = x, y, yaw, v, steering
        egos.sub_steps[i] += 1
        if beside:
            if ego.traffic[0].permitted < headway.WAITING:
                # Who waits for others does not stand: training ends no drive for that.
                egos.judged[i].view(STATE)[0].slow_since = math.nan
            drivers.move(ego, SUB_STEP)
            others.look(ego)
            note_meeting(egos, i, sub_step)
        if judge_row(tables, egos, i, command):
            break
    update_command(tables, egos, i)
    turning = egos.guided[i, 0] != LANE_FOLLOW
    permitted = math.inf
    if beside:
        permitted = headway.permit(ego)
        ego.traffic[0].permitted = permitted
    egos.rewards[i] = score_below(permitted, v, yaw, turning, egos.beside[i, 0], egos.beside[i, 1])


@njit()
def has_others(egos: Egos, i: int) -> bool:
    """Return whether an ego has other road users."""
    traffic = egos.others.traffic[i].view(TRAFFIC)[0]
    return bool(traffic.vehicles + traffic.pedestrians > 0)


@njit()
def ego_of(tables: Tables, egos: Egos, i: int) -> Ego:
    """Return what an ego's road users mind."""
    others = egos.others
    return Ego(
        tables.streets, net_of(tables.points, tables.along, tables.legs, tables.gates),
        others.traffic[i].view(TRAFFIC), others.cars[i].view(CAR)[:, 0], others.walkers[i].view(WALKER)[:, 0],
        others.users[i], others.pictures[i], others.near[i], others.way[i],
        egos.progress[i].view(PROGRESS), egos.state[i],
    )  # fmt: skip


@njit()
def note_meeting(egos: Egos, i: int, sub_step: int) -> None:
    """Keep the road users that an ego sees, for its record."""
    if egos.met.shape[2] > 0:
        seen = egos.others.traffic[i].view(TRAFFIC)[0].seen
        egos.meetings[i, sub_step] = seen
        for k in range(seen):
            egos.met[i, sub_step, k] = egos.others.users[i, k]


@njit()
def begin_beside(tables: Tables, egos: Egos, i: int) -> None:
    """Place the road users of an ego that begins a trial."""
    traffic = egos.others.traffic[i].view(TRAFFIC)[0]
    traffic.seen, traffic.permitted = 0, math.inf
    if has_others(egos, i):
        ego = ego_of(tables, egos, i)
        settling.settle(ego)
        others.look(ego)
        note_meeting(egos, i, 0)
        traffic.permitted = headway.permit(ego)


@njit()
def keep_commands(egos: Egos, i: int) -> None:
    """Record the commands of an ego's next decision."""
    if egos.commands.shape[1] == 0:
        return
    decision = (egos.sub_steps[i] + SUB_STEPS - 1) // SUB_STEPS  # a verdict can end a decision half-way
    egos.commands[i, decision, 0], egos.commands[i, decision, 1] = egos.delivered[i], egos.guided[i, 0]


@compiled(nogil=True)
def run(tables: Tables, egos: Egos, observations: Observations, first: int, end: int) -> None:
    """Do the work of the egos from ``first`` to before ``end`` in the order."""
    for k in range(first, end):
        i = egos.order[k]
        todo = egos.todo[i]
        if todo == DRIVE:
            drive(tables, egos, i)
            keep_commands(egos, i)
            observe(tables, egos, observations, i)
        elif todo == GUIDE:
            decide.begin(egos.judged[i])
            egos.sub_steps[i] = 0
            egos.rewards[i] = 0.0
            update_command(tables, egos, i)
            begin_beside(tables, egos, i)
        elif todo == BEGIN:
            keep_commands(egos, i)
            judge_row(tables, egos, i, egos.delivered[i])
            observe(tables, egos, observations, i)
