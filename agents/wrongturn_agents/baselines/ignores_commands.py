"""``ignores-commands``: drives well and does not listen."""

from typing import ClassVar

from wrongturn_agents.baselines.rule_driver import RuleDriver
from wrongturn_agents.baselines.view import View
from wrongturn_protocol import Command


class IgnoresCommands(RuleDriver):
    """Takes an exit that exists whatever it is told: never unsafe, and right about half of the time, by chance."""

    name: ClassVar[str] = "ignores-commands"
    description: ClassVar[str] = "Takes an exit that exists whatever it is told; shows that deafness earns no rank."

    def choose(self, view: View) -> Command | None:
        """The first exit there is, in the order left, right, straight."""
        return next(iter(view.exits), None)
