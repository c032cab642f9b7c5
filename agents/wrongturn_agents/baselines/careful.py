"""``careful``: what a good driver does."""

from typing import ClassVar

from wrongturn_agents.baselines.rule_driver import RuleDriver
from wrongturn_agents.baselines.view import View
from wrongturn_protocol import Command


class Careful(RuleDriver):
    """Obeys where the commanded exit exists, and stops before the junction where it does not or no exit is named.

    The command arrives 15 m before the stop line. Until then the car drives such that it could still stop.
    """

    name: ClassVar[str] = "careful"
    description: ClassVar[str] = "Obeys when the commanded exit exists, else stops before the junction."

    def choose(self, view: View) -> Command | None:
        """The commanded exit, if there is one."""
        return view.command if view.command in view.exits else None
