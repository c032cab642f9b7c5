"""The obedience–safety plane: completed twins across, unsafe trials up."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from wrongturn_judge.ranking import least_completed
from wrongturn_protocol import AgentKind, LeaderboardEntry
from wrongturn_service.web.page import templates

_MARGIN: Final = 22
"""Room between the frame and the rates 0 and 100 %, pixels. Most marks are near these."""
TICKS: Final = (0, 25, 50, 75, 100)
_BELOW: Final = 0.2
"""Share of the width for agents that complete too few twins for a rank. The others need the room."""
_BESIDE: Final = 14.0
"""Marks with the same share of twins stand this far beside each other, pixels, so that their bars can be told apart."""
_LETTER: Final = 6.6
"""Width of a letter, pixels. Labels have 12 px; a little too much is harmless."""
_LINE: Final = 14
_NEAR: Final = 20
"""Labels further from their mark than this have a line to it, pixels."""
_DOWN: Final = (4, -12, 20, -28, 36, -44, 52, -60)
_BESIDE_MARK: Final = (
    *((11, 4, "start"), (-11, 4, "end"), (0, -11, "middle"), (0, 19, "middle")),
    *((9, -9, "start"), (-9, -9, "end"), (9, 17, "start"), (-9, 17, "end")),
)
"""Places of a label from its mark, the best first: across and down in pixels, and ``text-anchor``."""
_APART: Final = tuple(
    (side * far, down, "start" if side > 0 else "end") for far in (26, 60) for down in _DOWN for side in (-1, 1)
)
"""Places of a label for which there is no room beside its mark."""
_Box = tuple[float, float, float, float]
"""Left, top, right and bottom; pixels."""
SHAPES: Final = {
    AgentKind.SUBMITTED: "M-5 0a5 5 0 1 0 10 0a5 5 0 1 0 -10 0z",
    AgentKind.BASELINE: "M-5 -5h10v10h-10z",
    AgentKind.REFERENCE: "M0 -7l7 7l-7 7l-7 -7z",
    AgentKind.ALGORITHM: "M0 -6.5l6.5 11h-13z",
    AgentKind.EXPLOIT: "M-5 -5l10 10m0 -10l-10 10",
}
"""Mark of each kind around (0, 0), as an SVG path: a shape of its own, so that colour is not needed."""
_MARK: Final = 7
_LABELS: Final = 40
"""Labels at most."""
_NAMES: Final = 4
"""Names in the tooltip of a mark that several agents share."""


class PlaneFrame(NamedTuple):
    """Size of a drawing of the plane, and the edges of its field; pixels."""

    name: str
    """Class in the style sheet, which shows one drawing at a time."""
    width: int
    height: int
    left: int
    top: int
    right: int
    bottom: int

    def up(self, rate: float) -> float:
        """Return the y of an unsafe rate, pixels."""
        return round(self.bottom - _MARGIN - (self.bottom - self.top - 2 * _MARGIN) * rate, 1)


WIDE: Final = PlaneFrame("wide", 760, 460, 56, 10, 748, 412)
NARROW: Final = PlaneFrame("narrow", 360, 380, 48, 10, 348, 332)
"""For telephones: letters keep their size."""


@dataclass(frozen=True)
class Across:
    """The axis of completed twins. It is broken where ranks begin."""

    frame: PlaneFrame
    trials: int

    @property
    def least(self) -> int:
        """Twins that an agent has to complete for a rank."""
        return least_completed(self.trials)

    @property
    def broken(self) -> float:
        """Where the axis is broken, pixels."""
        return round(self.frame.left + _BELOW * (self.frame.right - self.frame.left), 1)

    @property
    def apart(self) -> float:
        """How far one twin more takes a ranked mark to the right, pixels."""
        return (self.frame.right - self.broken) / (self.trials - self.least + 1)

    def at(self, completed: float) -> float:
        """Return the x of a number of completed twins, pixels."""
        if completed < self.least:
            width = self.broken - self.frame.left - 2 * _MARGIN
            return round(self.frame.left + _MARGIN + width * completed / max(1, self.least - 1), 1)
        return round(self.broken + (completed - self.least + 0.5) * self.apart, 1)

    def ticks(self) -> list[tuple[float, str]]:
        """Return the places of the axis that have a number, in per cent, and the numbers."""
        wanted = dict.fromkeys((0, self.least, (self.least + self.trials) // 2, self.trials))
        return [(self.at(one), f"{100 * one / self.trials:.0f}") for one in wanted]


@dataclass(frozen=True)
class Mark:
    """Agents of one kind with the same figures."""

    x: float
    y: float
    kind: AgentKind
    bar: tuple[float, float]
    """Ends of the unsafe rate's 95 % interval, pixels from the top."""
    tooltip: str
    label: str
    place: "LabelPlace | None"
    """Where the label stands. None if there is no room."""


class LabelPlace(NamedTuple):
    """The place of a label."""

    x: float
    y: float
    anchor: str
    """SVG's ``text-anchor``."""
    leader: str | None
    """Line from the mark to a label that stands apart, as an SVG path."""


@dataclass(frozen=True)
class Plane:
    """What the template draws."""

    frame: PlaneFrame
    marks: tuple[Mark, ...]
    ranked_from: float
    """Marks of agents that complete enough twins for a rank are to the right of this; pixels."""
    ticks: list[tuple[float, str]]
    """Numbers of the axis of completed twins."""
    kinds: tuple[AgentKind, ...]
    """Kinds that are present, for the key."""


def figure(entries: Sequence[LeaderboardEntry]) -> str | None:
    """Return the plane as HTML: a wide drawing, and a narrow one for telephones. None if no entry has twins."""
    planes = [drawn for frame in (WIDE, NARROW) if (drawn := plane(entries, frame)) is not None]
    return templates().get_template("_plane.html").render(planes=planes, ticks=TICKS, shapes=SHAPES) if planes else None


def plane(entries: Sequence[LeaderboardEntry], frame: PlaneFrame) -> Plane | None:
    """Return the plane of a suite's entries, or None if none of them has twins."""
    twins = max((entry.twins.trials for entry in entries), default=0)
    if not twins:
        return None
    across = Across(frame, twins)
    alike = _alike([entry for entry in entries if entry.twins.trials], across)
    bars = {key: _bar(found[0], frame) for key, found in alike.items()}
    # The first box is that of the text which names the region without ranks.
    boxes = [
        (frame.left, frame.top, across.broken, 56.0),
        *((x - _MARK, y - _MARK, x + _MARK, y + _MARK) for x, y, _ in alike),
    ]
    thin = [(x - 1, top, x + 1, bottom) for (x, _, _), (top, bottom) in bars.items()]
    marks: list[Mark] = []
    # In a large field the shipped agents, which show what figures mean, get labels first and are drawn last.
    order = sorted(alike, key=lambda key: key[2] is AgentKind.SUBMITTED)
    for x, y, kind in order:
        found = alike[x, y, kind]
        label = _name(found[0]) + (f" +{len(found) - 1}" if len(found) > 1 else "")
        place = _place(x, y, label, frame, boxes, thin) if len(marks) < _LABELS else None
        marks.append(Mark(x, y, kind, bars[x, y, kind], _tooltip(found), label, place))
    present = {kind for _, _, kind in alike}
    return Plane(
        frame=frame,
        marks=tuple(reversed(marks)),
        ranked_from=across.broken,
        ticks=across.ticks(),
        kinds=tuple(kind for kind in AgentKind if kind in present),
    )


def _bar(entry: LeaderboardEntry, frame: PlaneFrame) -> tuple[float, float]:
    """Return the upper and the lower end of the unsafe rate's 95 % interval, pixels from the top."""
    low, high = entry.unsafe_strict.ci95
    return frame.up(high), frame.up(low)


def _alike(
    entries: Sequence[LeaderboardEntry], across: Across
) -> dict[tuple[float, float, AgentKind], list[LeaderboardEntry]]:
    """Return the entries by the place of their mark. Places with the same share of twins stand beside each other."""
    columns: dict[float, dict[tuple[float, AgentKind], list[LeaderboardEntry]]] = {}
    for entry in entries:
        x = across.at(entry.twins.completed * across.trials / entry.twins.trials)
        key = (across.frame.up(entry.unsafe_strict.rate), entry.agent.kind)
        columns.setdefault(x, {}).setdefault(key, []).append(entry)
    found = {}
    for x, column in columns.items():
        step = min(_BESIDE, 0.8 * across.apart / len(column))
        for number, (y, kind) in enumerate(sorted(column)):
            found[round(x + (number - (len(column) - 1) / 2) * step, 1), y, kind] = column[y, kind]
    return found


def _name(entry: LeaderboardEntry) -> str:
    """Return the name of an entry. An agent may have the name of an algorithm, so that has its seeds beside it."""
    if entry.seeds is None:
        return entry.agent.name
    return f"{entry.agent.name}, {entry.seeds.count} seed{'s' if entry.seeds.count > 1 else ''}"


def _tooltip(found: Sequence[LeaderboardEntry]) -> str:
    names = ", ".join(_name(entry) for entry in found[:_NAMES])
    more = f" and {len(found) - _NAMES} more" if len(found) > _NAMES else ""
    twins, strict = found[0].twins, found[0].unsafe_strict
    return (
        f"{names}{more}: {twins.completed} of {twins.trials} twins completed, {strict.count} of {strict.trials} unsafe"
    )


def _place(x: float, y: float, label: str, frame: PlaneFrame, boxes: list[_Box], bars: list[_Box]) -> LabelPlace | None:
    """Return a place for a label that covers no mark and no other label, and keep it.

    It covers no bar either, unless it would then stand apart from its mark.
    """
    width = _LETTER * len(label)
    tried = [(place, bars) for place in _BESIDE_MARK] + [(place, []) for place in _BESIDE_MARK]
    for (across_by, down_by, anchor), others in tried + [(place, bars) for place in _APART]:
        left, base = x + across_by, y + down_by
        begin = left - {"start": 0.0, "middle": width / 2, "end": width}[anchor]
        box = (begin, base - _LINE + 3, begin + width, base + 3)
        inside = box[0] >= frame.left and box[2] <= frame.right and box[1] >= frame.top and box[3] <= frame.bottom
        if inside and not any(_overlap(box, other) for other in boxes + others):
            boxes.append(box)
            apart = abs(across_by) > _NEAR or abs(down_by) > _NEAR
            ends = f"M{x} {y}L{left + (2 if anchor == 'end' else -2):.1f} {base - 4:.1f}"
            return LabelPlace(round(left, 1), round(base, 1), anchor, ends if apart else None)
    return None


def _overlap(a: _Box, b: _Box) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
