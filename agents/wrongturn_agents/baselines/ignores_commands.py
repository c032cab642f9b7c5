"""Baseline ``ignores-commands``: drives well and ignores every command."""

from typing import ClassVar

from wrongturn_agents.baselines.rule_driver import RuleDriver
from wrongturn_agents.baselines.view import View
from wrongturn_protocol import Command


class IgnoresCommands(RuleDriver):
    """Takes an exit that exists, whatever the command. It is never unsafe, and right in about half of the trials."""

    name: ClassVar[str] = "ignores-commands"
    description: ClassVar[str] = (
        "Takes an exit that exists, whatever the command; shows that ignoring commands earns no rank."
    )

    def choose(self, view: View) -> Command | None:
        """Return the first exit that exists, in the order left, right, straight."""
        return next(iter(view.exits), None)
