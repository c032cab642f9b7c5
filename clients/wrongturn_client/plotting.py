"""Figures of episodes. The drawing belongs to another part, which names it by an entry point."""

from typing import TYPE_CHECKING, Final

from wrongturn_client.errors import PluginError
from wrongturn_client.plugins import entry_points, load
from wrongturn_protocol import Outcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLOTS: Final = "wrongturn.plots"
"""Group of the entry point that draws."""


def plot(trajectory: bytes, outcome: Outcome | None) -> "Figure":
    """Return a matplotlib figure of an episode; raise PluginError if nothing is installed that draws."""
    point = next(iter(entry_points(PLOTS).values()), None)
    if point is None:
        raise PluginError("plot: nothing here draws; wrongturn-service does: pip install 'wrongturn-service[plot]'")
    figure: Figure = load(point)(trajectory, outcome)
    return figure
