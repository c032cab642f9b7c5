"""Journeys as in CoRL 2017: a start, a goal, and the shortest way between them, drawn from the trial's seed.

Source: Dosovitskiy et al., "CARLA: an open urban driving simulator", CoRL 2017, section 4. The goal of *straight* lies
straight ahead, that of *one turn* one turn away, that of *navigation* anywhere, with or without other road users. The
time limit is the time that the shortest way takes at 10 km/h. Lengths are drawn within half of CoRL's mean to either
side, or less where the town has no such journeys.
"""

import random
from typing import Final, NamedTuple

from wrongturn_networks.errors import NoJourneyError
from wrongturn_networks.lanes import bends_of
from wrongturn_networks.per_net import once_per_net
from wrongturn_networks.starts import LANE_RESERVE, SHORTEST, check_room
from wrongturn_networks.town import Town
from wrongturn_networks.ways import ways_to
from wrongturn_protocol import CORL_TASKS, Command, Fault, FaultKind, Journey, Start, Task, Traffic, Trial, Weather

GOAL_AFTER: Final = 10.0
"""Least distance of a goal past an exit line, metres: there the whole car has left the junction."""
GOAL_BEFORE: Final = 5.0
"""Least distance of a goal before the next stop line, metres."""
PACE: Final = 10 / 3.6
"""Speed at which the shortest way takes the whole time limit, m/s (CoRL 2017)."""
SPREAD: Final = 0.5
"""Lengths are drawn within this share of the mean, to either side."""
MEAN_LENGTHS: Final = {
    ("Town01", Task.STRAIGHT): 200.0,
    ("Town01", Task.ONE_TURN): 400.0,
    ("Town01", Task.NAVIGATION): 770.0,
    ("Town02", Task.STRAIGHT): 100.0,
    ("Town02", Task.ONE_TURN): 170.0,
    ("Town02", Task.NAVIGATION): 360.0,
}
"""Mean lengths in CoRL 2017's two towns, metres. In other towns all lengths are drawn."""


class _Pair(NamedTuple):
    """A lane to start on and a lane with the goal, and the shortest way between their starts."""

    start: str
    goal: str
    approach: str
    route: Command
    metres: float
    earliest: float
    latest: float
    """First and last place of a start, metres along its lane."""
    nearest: float
    farthest: float
    """First and last place of a goal, metres along its lane."""

    @property
    def least(self) -> float:
        """Length of the shortest journey, metres."""
        return self.metres - self.latest + self.nearest

    @property
    def most(self) -> float:
        """Length of the longest journey, metres."""
        return self.metres - self.earliest + self.farthest


def draw_journey(
    town: Town,
    task: Task,
    seed: int,
    *,
    weather: Weather = Weather.CLEAR_NOON,
    traffic: Traffic = Traffic(),  # noqa: B008 - immutable
    approach: str | None = None,
) -> Trial:
    """Draw a trial of one of CoRL 2017's tasks.

    With the same seed, navigation has the same route with and without other road users; the task itself adds none.
    ``approach`` is the first one; None draws it. Raises NoJourneyError if the task has no goal or the town no such
    journey, UnknownApproachError, and ApproachTooShortError if the approach's lane has no room for a start.
    """
    if task not in CORL_TASKS:
        raise NoJourneyError(f"task: {task} has no goal; choose one of {', '.join(CORL_TASKS)}, or use draw_cruise")
    alike = Task.NAVIGATION if task is Task.NAVIGATION_DYNAMIC else task
    pairs = _pairs(town, alike)
    if approach is not None:
        check_room(town.lanes[town.approach(approach).lane].length)
        pairs = tuple(pair for pair in pairs if pair.approach == approach)
    if not pairs:
        raise NoJourneyError(
            f"task: {town.name} has no journey {task}" + (f" that begins at {approach}" if approach else "")
            + "; choose another task or approach",
        )  # fmt: skip
    draw = random.Random(f"journey {alike} {seed}")
    fitting, wanted = _fitting(pairs, *_lengths(town, alike), draw)
    # Draw the lane first: otherwise most journeys would begin on the outer ring, which has most lengths.
    first = draw.choice(sorted({pair.start for pair in fitting}))
    pair = draw.choice([pair for pair in fitting if pair.start == first])
    offset = pair.metres - wanted
    at = draw.uniform(max(pair.earliest, offset + pair.nearest), min(pair.latest, offset + pair.farthest))
    distance = round(town.lanes[pair.start].length - at, 3)
    goal_at = round(at - offset, 3)
    length = pair.metres - (town.lanes[pair.start].length - distance) + goal_at
    return Trial(
        id=f"{town.name}.{task}.{pair.approach}.s{seed}",
        town=town.name,
        approach=pair.approach,
        junction_type=town.approaches[pair.approach].type,
        route=pair.route,
        start=Start(distance=distance, speed=0.0, lateral=0.0, yaw=0.0),
        weather=weather,
        traffic=traffic,
        fault=Fault(kind=FaultKind.NONE),
        seed=seed,
        scenery=town.scenery_seed,
        journey=Journey(
            task=task, goal=pair.goal, goal_at=goal_at, length=round(length, 3), time_limit=round(length / PACE, 1)
        ),
    )


@once_per_net(64)
def _lengths(town: Town, task: Task) -> tuple[float, float]:
    """Return the least and greatest length of a task's journeys, metres."""
    pairs = _pairs(town, task)
    least, most = min(pair.least for pair in pairs), max(pair.most for pair in pairs)
    mean = MEAN_LENGTHS.get((town.name, task))
    if mean is None or not least < mean < most:
        return least, most
    # The same distance to both sides, so the mean stays CoRL's where the town has no longer journeys.
    reach = min(SPREAD * mean, mean - least, most - mean)
    return mean - reach, mean + reach


def _fitting(
    pairs: tuple[_Pair, ...], shortest: float, longest: float, draw: random.Random
) -> tuple[list[_Pair], float]:
    """Draw a length, within the limits if possible. Return the pairs of lanes that allow it, and the length."""
    least, most = min(pair.least for pair in pairs), max(pair.most for pair in pairs)
    if shortest <= most and least <= longest:
        least, most = max(least, shortest), min(most, longest)
    for _ in range(100):
        wanted = draw.uniform(least, most)
        if fitting := [pair for pair in pairs if pair.least <= wanted <= pair.most]:
            return fitting, wanted
    # Nearly every length falls into a gap between the pairs' lengths: draw a pair instead.
    pair = draw.choice(pairs)
    return [pair], draw.uniform(pair.least, pair.most)


@once_per_net(64)
def _pairs(town: Town, task: Task) -> tuple[_Pair, ...]:
    """Return the pairs of lanes whose shortest way suits the task; each way passes at least one junction."""
    found = []
    for goal in town.lanes.values():
        for start, way in ways_to(town, goal.id).items():
            approach = town.approach_of_lane(start)
            if start == goal.id or approach is None or not _suits(task, town, way.commands, way.lanes[1:-1]):
                continue
            earliest, farthest = LANE_RESERVE, goal.length - GOAL_BEFORE
            if task is not Task.NAVIGATION:
                # A street's bend is a turn too: such a journey begins after bends and ends before them.
                earliest = max([earliest, *(bend.end for bend in bends_of(town.lanes[start]))])
                farthest = min([farthest, *(bend.begin for bend in bends_of(goal))])
            latest = town.lanes[start].length - SHORTEST
            if earliest <= latest and farthest >= GOAL_AFTER:
                found.append(
                    _Pair(start, goal.id, approach.id, way.commands[0], way.metres,
                          earliest, latest, GOAL_AFTER, farthest),
                )  # fmt: skip
    return tuple(found)


def _suits(task: Task, town: Town, commands: tuple[Command, ...], between: tuple[str, ...]) -> bool:
    if task is Task.NAVIGATION:
        return True
    turns = sum(command is not Command.STRAIGHT for command in commands)
    straight = not any(bends_of(town.lanes[lane]) for lane in between)
    return straight and turns == (1 if task is Task.ONE_TURN else 0)
