"""Journeys beside SUMO's traffic, and what their collisions look like."""

import math
from collections.abc import Sequence
from typing import Final

from shapely import Point, Polygon

from lab.failures import Contact, Other
from wrongturn_agents.registry import AgentSource
from wrongturn_agents.suites import NAVIGATION
from wrongturn_agents.training.in_process import DrivenEpisode
from wrongturn_client.actions import action_of
from wrongturn_judge.trajectory import RoadUser
from wrongturn_networks import load_suite, load_town
from wrongturn_protocol import Condition, Task, Trial
from wrongturn_protocol.observations import observation_space
from wrongturn_sim import VEHICLE, Episode, Row, Trajectory
from wrongturn_sim.view.window import box

EACH: Final = 2
"""Journeys of each condition that are driven."""
_PEDESTRIAN: Final = 0.5
"""Length of a pedestrian, m."""
_SIGHT: Final = 30.0
"""Distance within which a road user is large enough in the camera's picture, m."""
_HALF_VIEW: Final = math.degrees(math.atan2(96.0, 107.4))
"""Half of the camera's view, degrees."""
_BEFORE_S: Final = 2.0
"""Seconds before a collision whose pedals count."""
_ALONG: Final = 45.0
"""Greatest angle between two vehicles that drive in the same direction, degrees."""


def journeys() -> tuple[Trial, ...]:
    """Return the journeys that are driven: the first ones of each condition, beside traffic."""
    found: dict[Condition, list[Trial]] = {condition: [] for condition in Condition}
    for trial in load_suite(NAVIGATION).episodes:
        if trial.journey is not None and trial.journey.task is Task.NAVIGATION_DYNAMIC:
            found[Condition.of(trial.town, trial.weather)].append(trial)
    return tuple(trial for own in found.values() for trial in own[:EACH])


def drive_journey(source: AgentSource, trial: Trial) -> DrivenEpisode:
    """Drive a journey beside SUMO's traffic.

    Raises:
        AgentsError: the agent cannot be made, or fails.
        SimulatorUnavailableError: libsumo cannot be loaded.
    """
    agent, episode = source.make(), Episode(trial, source.track)
    observation = episode.reset()
    agent.reset(observation_space(source.track))
    while episode.outcome is None:
        action = action_of(agent.act(observation))
        observation = episode.step(action.steer, action.throttle, action.brake).observation
    return DrivenEpisode(trial, episode.trajectory, episode.outcome)


def contact_of(trajectory: Trajectory) -> Contact:
    """Return what a trajectory that ended in a collision shows of it."""
    rows, end = trajectory.rows, trajectory.rows[-1]
    town = load_town(trajectory.trial.town)
    late = [row for row in rows if row.t > end.t - _BEFORE_S]
    touched = _touched(end)
    return Contact(
        other=Other.SCENERY if touched is None else _placed(end, end.road_users[touched]),
        in_junction=any(junction.area.contains(Point(end.x, end.y)) for junction in town.junctions.values()),
        speed=round(end.v, 2),
        other_speed=0.0 if touched is None else round(end.road_users[touched][5], 2),
        in_view_s=0.0 if touched is None else _in_view_s(trajectory, trajectory.road_user_numbers[-1][touched]),
        brake=round(sum(row.brake for row in late) / len(late), 2),
        throttle=round(sum(row.throttle for row in late) / len(late), 2),
    )


def _touched(row: Row) -> int | None:
    """Return which road user the car touches; None if none does."""
    car = Polygon(box(row.x, row.y, row.yaw, VEHICLE.length, VEHICLE.width))
    gaps = [car.distance(Polygon(box(*user[:5]))) for user in row.road_users]
    nearest = min(range(len(gaps)), key=gaps.__getitem__, default=None)
    return nearest if nearest is not None and gaps[nearest] < 0.1 else None


def _placed(row: Row, user: RoadUser) -> Other:
    """Return how a road user was placed that the car touches."""
    if user[3] <= _PEDESTRIAN:
        return Other.PEDESTRIAN
    angle = abs(math.degrees(math.remainder(user[2] - row.yaw, math.tau)))
    if angle > 180.0 - _ALONG:
        return Other.ONCOMING
    if angle > _ALONG:
        return Other.CROSSING
    return Other.AHEAD if abs(_bearing(row, user)) < 90.0 else Other.BEHIND


def _bearing(row: Row, user: RoadUser) -> float:
    """Return the direction in which the car sees a road user, degrees from straight ahead."""
    return math.degrees(math.remainder(math.atan2(user[1] - row.y, user[0] - row.x) - row.yaw, math.tau))


def _in_view_s(trajectory: Trajectory, number: int) -> float:
    """Return how long a road user has been in view without a break, seconds."""
    rows: Sequence[Row] = trajectory.rows
    since = rows[-1].t
    for row, numbers in zip(reversed(rows), reversed(trajectory.road_user_numbers), strict=True):
        if number not in numbers:
            break
        user = row.road_users[numbers.index(number)]
        near = math.hypot(user[0] - row.x, user[1] - row.y) <= _SIGHT
        # A body that touches the car's side is no longer in view; it was when it came.
        if not near or (abs(_bearing(row, user)) > _HALF_VIEW and rows[-1].t - row.t > 1.0):
            break
        since = row.t
    return round(rows[-1].t - since, 2)
