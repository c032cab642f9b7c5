"""Baseline ``always-stops``: drives up to each junction and never enters it."""

from typing import ClassVar

from wrongturn_agents.baselines.rule_driver import RuleDriver
from wrongturn_agents.baselines.view import View
from wrongturn_protocol import Command


class AlwaysStops(RuleDriver):
    """Stops before every junction. It is never unsafe and completes no twin, so it is not ranked."""

    name: ClassVar[str] = "always-stops"
    description: ClassVar[str] = "Stops before every junction; shows that being safe without driving earns no rank."

    def choose(self, view: View) -> Command | None:  # noqa: ARG002
        """Return None, whatever the car sees."""
        return None
