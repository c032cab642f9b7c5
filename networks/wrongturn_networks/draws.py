"""Draws: the trials that a secret makes of a suite's cells, with the scenery around them, and their order.

Every number is an HMAC-SHA256 of the secret and a label of its own, so nobody can foresee a trial, no number tells
another, and the same secret gives the same trials on every machine. ``docs/decisions.md`` says why trials are drawn.
"""

import hashlib
import hmac
import itertools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Final, TypeVar

from wrongturn_networks.drawn import drawn_name
from wrongturn_networks.errors import ApproachTooShortError, SecretError, UnknownTownError, UnknownTrialError
from wrongturn_networks.journeys import draw_journey
from wrongturn_networks.loading import load_town, town_names
from wrongturn_networks.per_net import once_per_net
from wrongturn_networks.starts import LANE_RESERVE, SHORTEST, WINDOW, fitted, room_for, slow_start
from wrongturn_networks.town import Town
from wrongturn_protocol import Cell, Command, Fault, FaultKind, JunctionType, Trial, trial_id, twin_id

NEAREST, FARTHEST = 22.0, 60.0
"""A start lies this far before the stop line where the lane is long enough, metres. Some faults need more."""
FARTHER = 10.0
"""Least width of that range where a fault needs more, metres."""
SPEEDS: Final = (4.0, 9.0)
"""Speed at a start, m/s."""
LATERAL = 0.4
"""Largest offset of a start from the lane's centre line, metres."""
YAW = 6.0
"""Largest angle of a start to the lane, degrees."""
SEEDS = 2**31
"""Seeds of trials are less than this."""
SCENERIES = 2**53
"""Seeds of scenery are less than this."""
WATCH: Final = (1.0, 4.0)
"""Range of the time for which a drive goes on after an exit, seconds."""

_DRAWN: Final = "drawn "
_PLACES: Final = 10
"""Drawn towns in which a cell is placed, where no suite says how many there are."""
_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class Draw:
    """The trials of one evaluation, and their twins.

    A twin drives the same approach and route as its trial, but has a start of its own. If both began alike, an agent
    that drives the twin first could recognise the trial and repeat what it did.
    """

    id: str
    """Id of the suite."""
    trials: tuple[Trial, ...]
    """Trials, without their twins."""
    twins: tuple[Trial, ...]
    """Twin of each trial, in the same order; empty for journeys, which have none."""
    secret: str | None = None
    """The secret's text; None for a suite that lists its trials."""

    @property
    def commitment(self) -> str | None:
        """SHA-256 of the secret's text, hexadecimal; None without a secret."""
        return None if self.secret is None else commitment_of(self.secret)

    @cached_property
    def episodes(self) -> tuple[Trial, ...]:
        """Trials that an evaluation drives: each one and its twin."""
        if not self.twins:
            return self.trials
        return tuple(episode for pair in zip(self.trials, self.twins, strict=True) for episode in pair)

    @cached_property
    def _by_id(self) -> MappingProxyType[str, Trial]:
        return MappingProxyType({trial.id: trial for trial in self.episodes})

    def trial(self, trial_id: str) -> Trial:
        """Return the trial or twin with an id. Raises UnknownTrialError if there is none."""
        if trial_id not in self._by_id:
            raise UnknownTrialError(trial_id, self._by_id)
        return self._by_id[trial_id]


def halves(draw: Draw, secret: str) -> tuple[tuple[Trial, ...], tuple[Trial, ...]]:
    """Return the episodes of a draw in the order in which a secret has them driven, in two halves.

    The first half has one of each pair, so that no pair can be recognised by holding an episode open. Journeys have no
    twins: all of them are in the first half.
    """
    numbers = _Numbers(secret)
    if not draw.twins:
        return tuple(numbers.ordered("order 1", draw.trials)), ()
    pairs = list(zip(draw.trials, draw.twins, strict=True))
    sides = [numbers.whole(f"{index} first", 2) for index in range(len(pairs))]
    first = numbers.ordered("order 1", [pair[side] for pair, side in zip(pairs, sides, strict=True)])
    second = numbers.ordered("order 2", [pair[1 - side] for pair, side in zip(pairs, sides, strict=True)])
    return tuple(first), tuple(second)


def commitment_of(secret: str) -> str:
    """Return the SHA-256 of a secret's text, as ``printf %s SECRET | sha256sum`` gives it. Raises SecretError."""
    return hashlib.sha256(_bytes_of(secret)).hexdigest()


def public_secret(suite_id: str, number: int) -> str:
    """Return the secret of a suite's public draw: draw 1 is the open draw, whose secret is the suite's id.

    The others are an HMAC-SHA256 of the id and a label of their own, behind the word ``public`` and a space. An
    evaluation's secret is 64 hexadecimal digits, so none is ever a public one. Raises SecretError for a number below 1.
    """
    if number < 1:
        raise SecretError(f"draw: is {number}; public draws are numbered from 1")
    if number == 1:
        return suite_id
    return f"public {hmac.digest(_bytes_of(suite_id), f'public draw {number}'.encode(), hashlib.sha256).hex()}"


def town_names_of(cells: Iterable[Cell], secret: str) -> dict[str, str]:
    """Return the names of the towns that a secret makes for cells, by their ``drawn K``. Nothing is built.

    Raises SecretError.
    """
    numbers = _Numbers(secret)
    drawn = dict.fromkeys(cell.town for cell in cells if is_drawn_cell(cell))
    return {town: drawn_name(numbers.digest(f"town {town.removeprefix(_DRAWN)}")) for town in drawn}


def is_drawn_cell(cell: Cell) -> bool:
    """Return whether the secret makes a cell's town."""
    return re.fullmatch(rf"{_DRAWN}\d+", cell.town) is not None


def draw_cells(suite_id: str, cells: Sequence[Cell], secret: str) -> Draw:
    """Draw the trials of a suite's cells, and their twins; a town that the secret makes is built where it is missing.

    Equal cells get different approaches while there are enough. Their routes are balanced, also among cells that differ
    only in the number of their drawn town. Raises what :meth:`wrongturn_networks.Suite.draw` raises.
    """
    numbers = _Numbers(secret)
    drawn = town_names_of(cells, secret)
    if any(cell.task for cell in cells):
        return Draw(suite_id, _journeys(cells, drawn, numbers), (), secret)
    cells = [placed(cell, drawn) for cell in cells]
    approaches = _dealt(cells, lambda cell: cell, lambda cell, *group: _approaches_of(cell, drawn, numbers, *group))
    routes = _dealt(cells, _anywhere, lambda cell, *group: _routes_of(cell, numbers, *group))
    trials: list[Trial] = []
    twins: list[Trial] = []
    taken: set[int] = set()
    for index, (cell, place) in enumerate(zip(cells, zip(approaches, routes, strict=True), strict=True)):
        town = drawn.get(cell.town, cell.town)
        trial = _trial(cell, town, f"{index} trial", place, numbers, taken)
        twin = _trial(cell, town, f"{index} twin", place, numbers, taken)
        trials.append(trial)
        twins.append(twin.model_copy(update={"id": twin_id(trial), "fault": Fault(kind=FaultKind.NONE)}))
    return Draw(suite_id, tuple(trials), tuple(twins), secret)


def placed(cell: Cell, drawn: Mapping[str, str]) -> Cell:
    """Return a cell in the drawn town where it can be driven: its own or, if that has no such approach, the next.

    Not every drawn town has a crossing, or a lane that is long enough for every fault. ``drawn`` has the names of towns
    by their ``drawn K``.
    """
    if cell.town not in drawn:
        return cell
    labels = [*drawn]
    own, least = labels.index(cell.town), max(room_for(cell.fault), SHORTEST)
    for label in (*labels[own:], *labels[:own]):
        if _roomy(load_town(drawn[label]), _type_of(cell), least):
            return cell.model_copy(update={"town": label})
    return cell


def possible_trials(cell: Cell) -> tuple[Trial, ...]:
    """Return one trial for each approach and route that a draw can choose for a cell, in one of its towns.

    As in a draw, a drawn town without such an approach is left for another. Makers of suites check by these trials that
    a cell's fault can be applied wherever a draw leads. Raises UnknownTownError; ApproachTooShortError if no approach
    of the cell's type has room for a start.
    """
    numbers = _Numbers("any")
    labels = [cell, *(cell.model_copy(update={"town": f"{_DRAWN}{k}"}) for k in range(_PLACES))]
    drawn = town_names_of(labels if is_drawn_cell(cell) else (), "any")
    cell = placed(cell, drawn) if cell.task is None else cell
    if cell.task is not None:
        return _journeys([cell], drawn, numbers)
    town = drawn.get(cell.town, cell.town)
    return tuple(
        _trial(cell, town, f"{approach} {route}", (approach, route), numbers, set())
        for approach in _approaches(cell, town, "cell")
        for route in sorted(_type_of(cell).exits)
    )


def _dealt(
    cells: Sequence[Cell], alike: Callable[[Cell], Cell], deal: Callable[[Cell, int, int], Sequence[_T]]
) -> list[_T]:
    """Return what each cell gets. ``deal`` serves all alike ones, given the first, its index and their number."""
    groups: dict[Cell, list[int]] = {}
    for index, cell in enumerate(cells):
        groups.setdefault(alike(cell), []).append(index)
    dealt: dict[int, _T] = {}
    for indices in groups.values():
        dealt.update(zip(indices, deal(cells[indices[0]], indices[0], len(indices)), strict=True))
    return [dealt[index] for index in range(len(cells))]


def _anywhere(cell: Cell) -> Cell:
    return cell.model_copy(update={"town": _DRAWN}) if is_drawn_cell(cell) else cell


def _approaches_of(cell: Cell, drawn: Mapping[str, str], numbers: "_Numbers", first: int, count: int) -> list[str]:
    """Return the approach of each of some equal cells, the first of which has the index ``first``."""
    approaches = _approaches(cell, drawn.get(cell.town, cell.town), f"cells[{first}]")
    chosen: list[str] = []
    for turn in range(-(-count // len(approaches))):
        chosen += numbers.ordered(f"{first} approaches {turn}", approaches)
    return chosen[:count]


def _routes_of(cell: Cell, numbers: "_Numbers", first: int, count: int) -> list[Command]:
    """Return the route of each of some cells that are alike, the first of which has the index ``first``."""
    exits = numbers.ordered(f"{first} exits", sorted(_type_of(cell).exits))
    return numbers.ordered(f"{first} routes", [exits[k % len(exits)] for k in range(count)])


def _approaches(cell: Cell, town: str, field: str) -> tuple[str, ...]:
    """Return the approaches of a cell's type in a town whose lanes have room for a start."""
    known = town_names()
    if town not in known and not is_drawn_cell(cell):
        raise UnknownTownError(town, known, f"{field}.town")
    least = max(room_for(cell.fault), SHORTEST)
    approaches = _roomy(load_town(town), _type_of(cell), least)
    if not approaches:
        raise ApproachTooShortError(
            f"{field}: no approach of type {cell.junction_type} in {town} has {least + LANE_RESERVE:.0f} m of "
            "lane, which a start needs; choose another town or type"
        )
    return approaches


@once_per_net(256)
def _roomy(town: Town, kind: JunctionType, least: float) -> tuple[str, ...]:
    roomy = (
        approach.id
        for approach in town.approaches.values()
        if approach.type is kind and town.lanes[approach.lane].length - LANE_RESERVE >= least
    )
    return tuple(sorted(roomy))


def _trial(
    cell: Cell, town_name: str, label: str, place: tuple[str, Command], numbers: "_Numbers", taken: set[int]
) -> Trial:
    """Return a trial of a cell. Its seed is none of those taken, and is added to them, so that ids differ too."""
    approach, route = place
    town = load_town(town_name)
    room = town.lanes[town.approach(approach).lane].length - LANE_RESERVE
    nearest = max(NEAREST, room_for(cell.fault))
    farthest = max(FARTHEST, nearest + FARTHER)
    seed = _seed(label, numbers, taken)
    trial = Trial(
        id=trial_id(town_name, approach, cell.fault, seed),
        town=town_name,
        approach=approach,
        junction_type=_type_of(cell),
        route=route,
        start=slow_start(
            numbers.between(f"{label} distance", min(nearest, room), min(farthest, room)),
            numbers.between(f"{label} speed", *SPEEDS),
            numbers.between(f"{label} lateral", -LATERAL, LATERAL),
            numbers.between(f"{label} yaw", -YAW, YAW),
        ),
        weather=cell.weather,
        traffic=cell.traffic,
        fault=cell.fault,
        seed=seed,
        window=round(numbers.between(f"{label} window", *WINDOW), 3),
        watch=round(numbers.between(f"{label} watch", *WATCH), 3),
        scenery=numbers.whole(f"scenery {cell.town}", SCENERIES),
    )
    return fitted(trial, town)


def _seed(label: str, numbers: "_Numbers", taken: set[int]) -> int:
    """Return a seed that is not taken, and take it."""
    drawn = (numbers.whole(f"{label} seed {attempt}", SEEDS) for attempt in itertools.count())
    seed = next(number for number in drawn if number not in taken)
    taken.add(seed)
    return seed


def _journeys(cells: Sequence[Cell], drawn: Mapping[str, str], numbers: "_Numbers") -> tuple[Trial, ...]:
    """Return a journey for each cell. Its way follows from a number of its own, not from the trial's seed."""
    taken: set[int] = set()
    trials = []
    for index, cell in enumerate(cells):
        if cell.task is None:
            raise ValueError(f"cells[{index}]: has no task, and others have one; make two suites of them")
        town = load_town(drawn.get(cell.town, cell.town))
        way = numbers.whole(f"{index} trial way", SEEDS)
        trial = draw_journey(town, cell.task, way, weather=cell.weather, traffic=cell.traffic)
        seed = _seed(f"{index} trial", numbers, taken)
        name = f"{town.name}.{cell.task}.{trial.approach}.s{seed}"
        scenery = numbers.whole(f"scenery {cell.town}", SCENERIES)
        trials.append(trial.model_copy(update={"id": name, "seed": seed, "scenery": scenery}))
    return tuple(trials)


def _type_of(cell: Cell) -> JunctionType:
    assert cell.junction_type is not None, "a journey's cell is drawn elsewhere"
    return cell.junction_type


def _bytes_of(secret: str) -> bytes:
    try:
        key = secret.encode()
    except UnicodeEncodeError:
        raise SecretError("secret: is not text in UTF-8; give it as the evaluation shows it") from None
    if not key:
        raise SecretError("secret: is empty; give the evaluation's, or leave it out for the open draw")
    return key


class _Numbers:
    """Numbers that follow from a secret and a label."""

    def __init__(self, secret: str) -> None:
        self._key = _bytes_of(secret)

    def digest(self, label: str) -> bytes:
        """Return the 32 bytes of a label."""
        return hmac.digest(self._key, label.encode(), hashlib.sha256)

    def whole(self, label: str, end: int) -> int:
        """Return a whole number from 0 to before ``end``."""
        return int.from_bytes(self.digest(label)[:16]) % end

    def between(self, label: str, low: float, high: float) -> float:
        """Return a number from ``low`` to before ``high``."""
        return low + (high - low) * (int.from_bytes(self.digest(label)[:6]) / 2**48)

    def ordered(self, label: str, items: Iterable[_T]) -> list[_T]:
        """Return the items in a random order."""
        numbered = list(enumerate(items))
        return [item for _, item in sorted(numbered, key=lambda pair: self.digest(f"{label} {pair[0]}"))]
