"""Five rule-based agents that show what the score means, and that tricks do not improve it."""

from wrongturn_agents.baselines.always_stops import AlwaysStops
from wrongturn_agents.baselines.careful import Careful
from wrongturn_agents.baselines.ignores_commands import IgnoresCommands
from wrongturn_agents.baselines.obeys_blindly import ObeysBlindly
from wrongturn_agents.baselines.parked import Parked
from wrongturn_agents.baselines.path import Path
from wrongturn_agents.baselines.rule_driver import Car, Manner, RuleDriver
from wrongturn_agents.baselines.view import View

__all__ = [
    "AlwaysStops",
    "Car",
    "Careful",
    "IgnoresCommands",
    "Manner",
    "ObeysBlindly",
    "Parked",
    "Path",
    "RuleDriver",
    "View",
]
