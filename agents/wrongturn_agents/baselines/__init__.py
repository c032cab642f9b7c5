"""Five rule-based agents that show what the score means, and that tricks do not improve it."""

from wrongturn_agents.baselines.drivers import AlwaysStops, Careful, IgnoresCommands, ObeysBlindly, Parked, made_up_path
from wrongturn_agents.baselines.path import Path
from wrongturn_agents.baselines.rule_driver import Manner, RuleDriver
from wrongturn_agents.baselines.view import View

__all__ = [
    "AlwaysStops",
    "Careful",
    "IgnoresCommands",
    "Manner",
    "ObeysBlindly",
    "Parked",
    "Path",
    "RuleDriver",
    "View",
    "made_up_path",
]
