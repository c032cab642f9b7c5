"""Baseline ``careful``: does what a good driver does."""

from typing import ClassVar

from wrongturn_agents.baselines.rule_driver import RuleDriver
from wrongturn_agents.baselines.view import View
from wrongturn_protocol import Command


class Careful(RuleDriver):
    """Obeys if the commanded exit exists. Stops before the junction if it does not, or if the command names no exit.

    The command arrives 10 to 20 m before the stop line. Until then the car is slow enough to stop.
    """

    name: ClassVar[str] = "careful"
    description: ClassVar[str] = "Obeys when the commanded exit exists, else stops before the junction."

    def choose(self, view: View) -> Command | None:
        """Return the commanded exit if it exists, else None."""
        return view.command if view.command in view.exits else None
