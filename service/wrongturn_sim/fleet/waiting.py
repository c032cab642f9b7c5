"""Cars that stand at a stop line where an ego comes, for training: else it meets too few of them to learn to stop.

They wait as for the right of way: in the ego's own lane, or in the oncoming lane of the street that its way enters.
"""

from wrongturn_judge.compiling import uncounted
from wrongturn_judge.kernels import Array
from wrongturn_sim import guide
from wrongturn_sim.fleet.drivers import STOP, choose_gate, safe_speed
from wrongturn_sim.fleet.ego_ahead import ego_to_line
from wrongturn_sim.fleet.headway import BRAKING, GAP, REACTION
from wrongturn_sim.fleet.meeting import far_away, has_room, is_drawn, put, time_to_line
from wrongturn_sim.fleet.others import FOR, LENGTH, STAYS, WAITS, Others, V, draw, place_car

NEAR = 45.0
"""Distance before the stop line, in metres, at which it is drawn whether a car stands."""
WAITING = 1
"""Column of ``Others.junction``."""
OWN = 0.5
"""Share of these cars that stand in the ego's own lane, where there is room."""
LEAST, SPREAD = 2.0, 6.0
"""In the ego's lane the car stays so many seconds after the ego can have come, and up to so many more."""
MOST = 30.0
"""Elsewhere it stays for at most so many seconds."""


@uncounted
def wait(
    points: Array, along: Array, legs: Array, lengths: Array, others: Others, i: int, progress: Array, places: Array,
    state: Array,
) -> None:  # fmt: skip
    """Let a car stand at the junction ahead of an ego, if this is drawn; once at each junction."""
    leg, gate = progress[guide.P_LEG], progress[guide.P_GATE]
    if not is_drawn(lengths, others, i, progress, places, WAITS, WAITING, NEAR):
        return
    k = far_away(others, i, state)
    if k < 0:
        return
    left = ego_to_line(lengths, progress, places)
    seconds = time_to_line(left) + LEAST + SPREAD * draw(others, i)
    if draw(others, i) < OWN and can_stop(others, i, k, left, state) and stand(legs, lengths, others, i, k, leg):
        others.cars[i, k, STAYS] = seconds
    else:
        back = way_back(legs, legs[leg, guide.L_GATE + guide.GATE_INTS * gate + guide.G_LEG])
        if back < 0 or not stand(legs, lengths, others, i, k, back):
            return
        others.cars[i, k, STAYS], others.ways[i, k, FOR] = MOST, leg
    place_car(points, along, legs, lengths, others.cars[i, k], others.ways[i, k])


@uncounted
def can_stop(others: Others, i: int, k: int, left: float, state: Array) -> bool:
    """Return whether an ego can stop in comfort behind a car at its stop line, ``left`` metres away."""
    gap = left - STOP - others.cars[i, k, LENGTH] - GAP
    return bool(gap > 0.0 and state[3] <= safe_speed(gap, 0.0, BRAKING, REACTION))


@uncounted
def stand(legs: Array, lengths: Array, others: Others, i: int, k: int, leg: int) -> bool:
    """Move a car to a stop line; return False where another car is near."""
    s = lengths[leg, guide.F_LENGTH] - STOP
    if s < others.cars[i, k, LENGTH] or not has_room(others, i, leg, s):
        return False
    put(others, i, k, leg, -1, s)
    choose_gate(legs, others, i, k)
    others.cars[i, k, V] = 0.0
    return True


@uncounted
def way_back(legs: Array, onward: int) -> int:
    """Return the leg that leads out of a street into which a leg leads; -1 if there is none."""
    for leg in range(len(legs)):
        if legs[leg, guide.L_APPROACH] and legs[leg, guide.L_BACK] == onward:
            return leg
    return -1
