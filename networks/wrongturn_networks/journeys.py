"""Journeys by CoRL 2017's recipe: a start, a goal, and the shortest way between them, drawn from the trial's seed.

Dosovitskiy et al., "CARLA: an open urban driving simulator", CoRL 2017, section 4: *straight* has its goal straight
ahead, *one turn* one turn away, *navigation* anywhere, with other road users or without; a journey may take the time
that its shortest way takes at 10 km/h. The lengths of a task's journeys spread about CoRL's means by half of them to
either side, or by less where the town has no longer ones.
"""

import random
from functools import lru_cache
from typing import Final, NamedTuple

from wrongturn_networks.bends import bends_of
from wrongturn_networks.errors import ApproachTooShortError, NoJourneyError
from wrongturn_networks.starts import LANE_RESERVE, SHORTEST
from wrongturn_networks.town import Town
from wrongturn_networks.ways import ways_to
from wrongturn_protocol import (
    CORL_TASKS,
    Command,
    Fault,
    FaultKind,
    Journey,
    Start,
    Task,
    Traffic,
    Trial,
    Weather,
)

GOAL_AFTER: Final = 10.0
"""A goal lies at least this far past an exit line, metres: there a car has left the junction with its whole length."""
GOAL_BEFORE: Final = 5.0
"""And at least this far before the next stop line."""
PACE: Final = 10 / 3.6
"""The speed at which the shortest way uses up the time limit, m/s (CoRL 2017)."""
SPREAD: Final = 0.5
"""Lengths are drawn within this share of the mean to either side of it."""
MEAN_LENGTHS: Final = {
    ("Town01", Task.STRAIGHT): 200.0,
    ("Town01", Task.ONE_TURN): 400.0,
    ("Town01", Task.NAVIGATION): 770.0,
    ("Town02", Task.STRAIGHT): 100.0,
    ("Town02", Task.ONE_TURN): 170.0,
    ("Town02", Task.NAVIGATION): 360.0,
}
"""CoRL 2017's, metres, of its two towns. In other towns every length is drawn that there is."""


class _Pair(NamedTuple):
    """A lane to start on and one with the goal, and the shortest way between their begins."""

    start: str
    goal: str
    approach: str
    route: Command
    metres: float
    earliest: float
    """First and last place of a start along its lane, metres."""
    latest: float
    nearest: float
    """First and last place of a goal along its lane, metres."""
    farthest: float

    @property
    def least(self) -> float:
        """The shortest journey, metres."""
        return self.metres - self.latest + self.nearest

    @property
    def most(self) -> float:
        """The longest journey, metres."""
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
    """A trial of one of CoRL 2017's tasks; with the same seed navigation is the same with other road users or without.

    Args:
        town: where.
        task: one of the four with a goal.
        seed: of the trial.
        weather: of the trial.
        traffic: other road users; none come by the task alone.
        approach: the first junction's arm; drawn where it is None.

    Raises:
        NoJourneyError: it is no task with a goal, or the town has none of it there.
        UnknownApproachError: the town has no such approach.
        ApproachTooShortError: the approach's lane has no room for a start.
    """
    if task not in CORL_TASKS:
        raise NoJourneyError(f"task: {task} has no goal; choose one of {', '.join(CORL_TASKS)}, or use draw_cruise")
    alike = Task.NAVIGATION if task is Task.NAVIGATION_DYNAMIC else task
    pairs = _pairs(town, alike)
    if approach is not None:
        length = town.lanes[town.approach(approach).lane].length
        if length < LANE_RESERVE + SHORTEST:
            raise ApproachTooShortError(
                f"approach: its lane is {length:.1f} m long and a start needs {SHORTEST + LANE_RESERVE:.0f} m; "
                "choose another approach",
            )
        pairs = tuple(pair for pair in pairs if pair.approach == approach)
    if not pairs:
        raise NoJourneyError(
            f"task: {town.name} has no journey {task}" + (f" that begins at {approach}" if approach else "")
            + "; choose another task or approach",
        )  # fmt: skip
    draw = random.Random(f"journey {alike} {seed}")
    fitting, wanted = _fitting(pairs, *_lengths(town, alike), draw)
    # Approaches in equal numbers: by length alone most journeys would begin on the outer ring.
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
        journey=Journey(
            task=task,
            goal=pair.goal,
            goal_at=goal_at,
            length=round(length, 3),
            time_limit=round(length / PACE, 1),
        ),
    )


@lru_cache(maxsize=64)
def _lengths(town: Town, task: Task) -> tuple[float, float]:
    """Least and greatest length of a task's journeys, metres."""
    pairs = _pairs(town, task)
    least, most = min(pair.least for pair in pairs), max(pair.most for pair in pairs)
    mean = MEAN_LENGTHS.get((town.name, task))
    if mean is None or not least < mean < most:
        return least, most
    # As far to one side as to the other, so that the mean stays CoRL's where the town has no longer ones.
    reach = min(SPREAD * mean, mean - least, most - mean)
    return mean - reach, mean + reach


def _fitting(
    pairs: tuple[_Pair, ...], shortest: float, longest: float, draw: random.Random
) -> tuple[list[_Pair], float]:
    """A length between two, as far as the pairs have such, and the pairs that have journeys of it; never none."""
    least, most = min(pair.least for pair in pairs), max(pair.most for pair in pairs)
    if shortest <= most and least <= longest:
        least, most = max(least, shortest), min(most, longest)
    for _ in range(100):
        wanted = draw.uniform(least, most)
        if fitting := [pair for pair in pairs if pair.least <= wanted <= pair.most]:
            return fitting, wanted
    # Nearly every length falls into a gap: any pair's then.
    pair = draw.choice(pairs)
    return [pair], draw.uniform(pair.least, pair.most)


@lru_cache(maxsize=64)
def _pairs(town: Town, task: Task) -> tuple[_Pair, ...]:
    """All pairs of lanes whose shortest way is of the task; a journey passes a junction at least."""
    found = []
    for goal in town.lanes.values():
        for start, way in ways_to(town, goal.id).items():
            approach = town.approach_of_lane(start)
            if start == goal.id or approach is None or not _suits(task, town, way.commands, way.lanes[1:-1]):
                continue
            earliest, farthest = LANE_RESERVE, goal.length - GOAL_BEFORE
            if task is not Task.NAVIGATION:
                # A street's own bends are turns too: such a journey begins after them and ends before.
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
