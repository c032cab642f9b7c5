"""Figures below a leaderboard's table. Packages name them by entry points in the group ``wrongturn.figures``."""

from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from typing import Final, NamedTuple

import structlog
from markupsafe import Markup

from wrongturn_protocol import LeaderboardEntry

GROUP: Final = "wrongturn.figures"
Draw = Callable[[Sequence[LeaderboardEntry]], str | None]
"""Function that returns a figure as HTML, such as an SVG drawing; None where it has nothing to show."""


class Figure(NamedTuple):
    """A figure on a page."""

    id: str
    """Name of its entry point. Its words are the heading."""
    html: Markup

    @property
    def heading(self) -> str:
        """What stands above it."""
        return self.id.replace("-", " ").capitalize()


def figures(entries: Sequence[LeaderboardEntry]) -> Iterator[Figure]:
    """Yield the figures of a leaderboard's entries, by name. One that fails is logged and left out."""
    for point in sorted(metadata.entry_points(group=GROUP), key=lambda point: point.name):
        try:
            draw: Draw = point.load()
            drawn = draw(entries)
        except Exception:
            structlog.get_logger("pages").exception("figure failed", plugin=point.value)
            continue
        if drawn:
            yield Figure(point.name, Markup(drawn))  # noqa: S704 -- the operator has installed the package
