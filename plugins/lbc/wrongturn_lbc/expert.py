"""The rule expert: where a driver who knows the route would be in the next seconds.

It drives as the baselines do (pure pursuit, at a speed that bends and other road users allow), in arrays of many cars.
"""

import math
from typing import Final, NamedTuple

import torch
from torch import Tensor

from wrongturn_agents.baselines import Manner
from wrongturn_agents.models.birdview import seen_from_car
from wrongturn_agents.models.waypoints import APART, COUNT
from wrongturn_protocol.vehicle import DECISION_S, VEHICLE

MANNER: Final = Manner(cruise=9.7)
"""The paper's 35 km/h on an open street; the rest as the baselines."""
_SLEW: Final = 2.0
"""Greatest change of the steering in a second."""
_POINTS: Final = 60
_CLOSER: Final = 1.0
"""The expert stands this much nearer to others than where nobody may drive, metres, so that it never stands sooner."""
_LEAST: Final = 1e-3


class Situation(NamedTuple):
    """What the expert knows of each car."""

    path: Tensor
    """(n, 60, 2): points of the way to drive, about 1 m apart: forward and left of the car, metres."""
    speed: Tensor
    """(n,) m/s"""
    steering: Tensor
    """(n,): as last applied."""
    free: Tensor
    """(n,): way that other road users leave free, metres."""


def situation(
    pose: Tensor, lane: Tensor, stop_line: Tensor, exits: Tensor, turn: Tensor, speed: Tensor, steering: Tensor,
    permitted: Tensor,
) -> Situation:  # fmt: skip
    """Return what the expert knows, from arrays of the privileged observation, (n, ...) each, and the simulation.

    ``turn`` (n,) int64 is the direction of the route at the next junction, 0 where there is none; ``permitted`` (n,)
    the speed that other road users permit, m/s.
    """
    route = exits.gather(1, (turn - 1).clamp(0, 2).view(-1, 1, 1, 1).expand(-1, 1, *exits.shape[2:]))[:, 0]
    knows = (turn > 0) & (route.abs().sum((1, 2)) > 0.0)
    # The lane has a point each metre up to the stop line; from there the exit goes on.
    left = torch.where(stop_line[:, 0] < 0.0, torch.zeros_like(stop_line[:, 0]), stop_line[:, 0])
    count = torch.where(knows, left.ceil().long(), torch.full_like(turn, _POINTS))[:, None]
    numbers = torch.arange(_POINTS, device=lane.device).expand(len(lane), -1)
    beyond = route.gather(1, (numbers - count).clamp(0)[..., None].expand(-1, -1, 2))
    path = torch.where((numbers < count)[..., None], lane, beyond)
    cap = permitted.clamp(max=30.0).to(speed.dtype)
    free = cap.square() / (2.0 * MANNER.braking) + _CLOSER
    free = torch.where(permitted.isfinite(), free, torch.full_like(cap, math.inf))
    return Situation(seen_from_car(path, pose.float()), speed[:, 0], steering[:, 0], free)


def plan(known: Situation) -> Tensor:
    """Return the expert's waypoints, (n, 5, 2): forward and left of the car, metres.

    The expert's driving is simulated for 2.5 s, by the car's own equations. Other road users stay where they are.
    """
    path = known.path
    segments = path[:, 1:] - path[:, :-1]
    lengths = segments.square().sum(2).sqrt().clamp_min(_LEAST)
    along = torch.cat([torch.zeros_like(lengths[:, :1]), lengths.cumsum(1)], 1)
    bends = _bends(segments, lengths)
    limits = (MANNER.lateral / bends.clamp_min(1e-6)).clamp(max=900.0)
    half = 0.5 * VEHICLE.wheelbase
    x, y, yaw, driven = (torch.zeros_like(known.speed) for _ in range(4))
    speed, steering = known.speed, known.steering
    found = []
    for step in range(round(COUNT * APART / DECISION_S)):
        rear = torch.stack([x - half * yaw.cos(), y - half * yaw.sin()], 1)
        here = _project(path, segments, lengths, along, rear)
        wanted = _speed(here + half, along, limits, (known.free - driven).clamp_min(0.0))
        pull = MANNER.gain * (wanted - speed)
        pull = torch.where(wanted < 0.5, torch.full_like(pull, -VEHICLE.braking), pull).clamp(
            -VEHICLE.braking, VEHICLE.acceleration
        )
        steer = _pursue(path, along, here, rear, yaw, speed)
        steering = steering + (steer - steering).clamp(-_SLEW * DECISION_S, _SLEW * DECISION_S)
        speed = (speed + pull * DECISION_S).clamp_min(0.0)
        yaw = yaw + speed * DECISION_S * torch.tan(-steering * VEHICLE.max_wheel_angle) / VEHICLE.wheelbase
        forward = speed * DECISION_S + half
        x, y = rear[:, 0] + forward * yaw.cos(), rear[:, 1] + forward * yaw.sin()
        driven = driven + speed * DECISION_S
        if (step + 1) % round(APART / DECISION_S) == 0:
            found.append(torch.stack([x, y], 1))
    return torch.stack(found, 1)


def _bends(segments: Tensor, lengths: Tensor) -> Tensor:
    """Return the curvature at the points of paths, measured over about 4 m, (n, 59), 1/m."""
    headings = torch.atan2(segments[..., 1], segments[..., 0])
    turns = headings[:, 4:] - headings[:, :-4]
    turned = torch.atan2(turns.sin(), turns.cos()).abs()
    over = (0.5 * (lengths[:, 4:] + lengths[:, :-4]) + lengths.unfold(1, 3, 1)[:, 1:-1].sum(2)).clamp_min(1.0)
    return torch.nn.functional.pad(turned / over, (2, 2))


def _project(path: Tensor, segments: Tensor, lengths: Tensor, along: Tensor, place: Tensor) -> Tensor:
    """Return the distance along paths of their points nearest to places (n, 2); less than 0 behind the first."""
    offset = place[:, None] - path[:, :-1]
    share = (offset * segments).sum(2) / lengths
    # A car's rear axle lies behind the first point of its lane.
    share = torch.cat([share[:, :1].clamp(max=lengths[:, :1]), share[:, 1:].clamp_min(0.0).minimum(lengths[:, 1:])], 1)
    miss = offset - share[..., None] * segments / lengths[..., None]
    nearest = miss.square().sum(2).argmin(1, keepdim=True)
    return (along[:, :-1] + share).gather(1, nearest)[:, 0]


def _speed(here: Tensor, along: Tensor, limits: Tensor, free: Tensor) -> Tensor:
    """Return the greatest speed that bends and road users ahead allow, (n,), m/s."""
    ahead = along[:, :-1] - here[:, None]
    squares = limits + 2.0 * MANNER.braking * ahead.clamp_min(0.0)
    least = torch.where(ahead > -2.0, squares, torch.full_like(squares, 900.0)).amin(1)
    return least.minimum(2.0 * MANNER.braking * free).sqrt().clamp(max=MANNER.cruise)


def _pursue(path: Tensor, along: Tensor, here: Tensor, rear: Tensor, yaw: Tensor, speed: Tensor) -> Tensor:
    """Return the steering by pure pursuit from the rear axle, (n,)."""
    least, seconds, greatest = MANNER.look_ahead
    goal = here + (seconds * speed).clamp(least, greatest)
    after = torch.searchsorted(along.contiguous(), goal[:, None].contiguous()).clamp(1, along.shape[1] - 1)
    begin, end = along.gather(1, after - 1), along.gather(1, after)
    share = (goal[:, None] - begin) / (end - begin).clamp_min(_LEAST)
    points = [path.gather(1, index[..., None].expand(-1, -1, 2))[:, 0] for index in (after - 1, after)]
    to_goal = points[0] + share * (points[1] - points[0]) - rear
    left = to_goal[:, 1] * yaw.cos() - to_goal[:, 0] * yaw.sin()
    wheel = torch.atan(2.0 * VEHICLE.wheelbase * left / to_goal.square().sum(1).clamp_min(1.0))
    return (-wheel / VEHICLE.max_wheel_angle).clamp(-1.0, 1.0)
