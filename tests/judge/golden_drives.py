"""Makes the golden records: the car's own dynamics, steered along a path, on a junction drawn by hand.

``python tests/judge/golden_drives.py`` writes them again. That changes what is promised: look at the difference,
and say under "Scoring" in the changelog what became of which verdict.
"""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from handmade_junction import FOLLOW, LEFT, RIGHT, STRAIGHT, Points, junction, trial, verdict_of, way

from wrongturn_judge.trajectory import RoadUser, Row, Trajectory
from wrongturn_protocol import VEHICLE, Command, FaultKind, JunctionType
from wrongturn_sim.ego import SUB_STEP, advance
from wrongturn_sim.polyline import fill, measure, project

FOLDER = Path(__file__).parent / "golden"


@dataclasses.dataclass(frozen=True)
class Golden:
    """One record to make."""

    kind: JunctionType
    path: Points
    fault: FaultKind = FaultKind.NONE
    route: Command | None = None
    command: Command = FOLLOW
    solids: tuple[tuple[float, float, float, float, float], ...] = ()
    speed: float = 7.0
    brake_at: float = math.inf
    """Metres along the path from which the car brakes."""
    users: tuple[RoadUser, ...] = ()


GOLDEN = {
    "exit-commanded-left": Golden(JunctionType.CROSS, way(LEFT), command=LEFT, route=LEFT),
    "exit-route-overrides": Golden(
        JunctionType.STRAIGHT_RIGHT, way(RIGHT), FaultKind.INFEASIBLE, RIGHT, command=LEFT, speed=6.0
    ),
    "exit-other-rides-the-kerb": Golden(
        JunctionType.CROSS, way(STRAIGHT, lateral=-1.5), FaultKind.OMISSION, RIGHT, speed=9.0
    ),
    "off-road-obeys-straight": Golden(
        JunctionType.LEFT_RIGHT, way(STRAIGHT), FaultKind.INFEASIBLE, LEFT, command=STRAIGHT
    ),
    "collision-obeys-left": Golden(
        JunctionType.STRAIGHT_RIGHT,
        way(LEFT),
        FaultKind.INFEASIBLE,
        RIGHT,
        command=LEFT,
        solids=((-4.5, 0.0, math.pi / 2, 12.0, 0.8), (12.0, 12.0, 0.3, 6.0, 6.0)),
    ),
    "collision-with-a-car": Golden(
        JunctionType.CROSS, way(STRAIGHT), command=STRAIGHT, users=((2.0, 14.0, math.pi / 2, 4.6, 1.9, 0.0),)
    ),
    "stopped-before-over-the-line": Golden(
        JunctionType.STRAIGHT_LEFT, way(STRAIGHT), FaultKind.INFEASIBLE, STRAIGHT, command=RIGHT, brake_at=19.0
    ),
    "stopped-in-junction": Golden(JunctionType.LEFT_RIGHT, way(LEFT), FaultKind.OMISSION, LEFT, brake_at=28.0),
    "wrong-way-by-the-oncoming-lane": Golden(
        JunctionType.CROSS, [*way(STRAIGHT)[:1], (2.0, -10.0), (-2.0, 8.0), (-2.0, 70.0)], command=STRAIGHT
    ),
    "off-road-after-an-exit": Golden(
        JunctionType.STRAIGHT_LEFT,
        [*way(STRAIGHT)[:1], (2.0, 26.0), (16.0, 40.0)],
        FaultKind.INFEASIBLE,
        STRAIGHT,
        command=RIGHT,
    ),
    "stopped-with-its-tail-in-the-junction": Golden(
        JunctionType.STRAIGHT_LEFT, way(STRAIGHT), FaultKind.OMISSION, STRAIGHT, brake_at=36.0
    ),
    "stopped-across-the-lane": Golden(
        JunctionType.CROSS,
        [*way(STRAIGHT)[:1], (2.0, -24.0), (-14.0, -14.0)],
        command=STRAIGHT,
        speed=4.0,
        brake_at=12.0,
    ),
    "unfinished-past-the-junction": Golden(JunctionType.CROSS, way(STRAIGHT), command=STRAIGHT, brake_at=45.0),
    "exit-at-60-km-h": Golden(JunctionType.CROSS, way(STRAIGHT), command=STRAIGHT, speed=16.7),
    "not-engaged": Golden(JunctionType.CROSS, way(LEFT, begin=27.0), FaultKind.OMISSION, LEFT, brake_at=0.0),
}


def drive_it(one: Golden) -> list[Row]:
    """Rows of the car as it follows the path, rounded as they are stored."""
    points = np.array(one.path)
    along = measure(points)
    (x, y), yaw = one.path[0], math.pi / 2
    state = (x, y, yaw, one.speed, 0.0)
    steer = throttle = brake = 0.0
    rows = []
    for k in range(1300):
        s, _, _ = project(points, along, 0, len(points), state[0], state[1])
        near = -15 < state[1] < 15 and -15 < state[0] < 15
        rows.append(
            Row(
                k / 20,
                *(round(value, 5) for value in state),
                int(one.command if near else FOLLOW),
                int((one.route or STRAIGHT) if near else FOLLOW),
                *(round(value, 5) for value in (steer, throttle, brake)),
                one.users,
            )
        )
        ahead = np.empty((1, 2), np.float32)
        fill(points, along, 0, len(points), s + 4.0, ahead)
        dx, dy = (ahead[0].astype(float) - state[:2]).tolist()
        turn = math.atan2(dy, dx) - state[2]
        turn = math.atan2(math.sin(turn), math.cos(turn))
        wheels = math.atan(VEHICLE.wheelbase * 2 * math.sin(turn) / max(math.dist((0, 0), (dx, dy)), 1.0))
        steer = min(max(-wheels / VEHICLE.max_wheel_angle, -1.0), 1.0)
        brake = 0.6 if s >= one.brake_at else 0.0
        throttle = 0.4 if not brake and state[3] < one.speed else 0.0
        state = advance(*state, steer, throttle, brake, SUB_STEP)
    return rows


def make(name: str) -> dict[str, Any]:
    """A record with its outcome, cut where the verdict falls."""
    one = GOLDEN[name]
    its_trial = trial(one.kind, route=one.route, fault=one.fault)
    geometry = junction(one.kind, solids=one.solids)
    rows = drive_it(one)
    outcome = verdict_of(rows, geometry, its_trial)
    kept = [row for row in rows if row.t <= outcome.time]
    return {
        "solids": one.solids,
        "outcome": outcome.model_dump(mode="json"),
        "trajectory": json.loads(Trajectory(its_trial, "0" * 64, kept).to_json()),
    }


if __name__ == "__main__":
    for name in GOLDEN:
        (FOLDER / f"{name}.json").write_text(json.dumps(make(name), separators=(",", ":")) + "\n", encoding="ascii")
