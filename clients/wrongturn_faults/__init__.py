"""Wrong commands for any driving program: the faults of Wrongturn as pure functions, without any dependency.

The package is a folder of plain Python from 3.8 on. It can be copied into another program.
"""

from wrongturn_faults.commands import CARLA, DIRECTIONS, NAVSIM, OPENPILOT, Command, from_one_hot, one_hot
from wrongturn_faults.plan import faulty_plan, junctions_of
from wrongturn_faults.rules import DOSES, RULES, Guidance, Order, Passage
from wrongturn_faults.sentences import phrasings, sentence

__all__ = [
    "CARLA",
    "DIRECTIONS",
    "DOSES",
    "NAVSIM",
    "OPENPILOT",
    "RULES",
    "Command",
    "Guidance",
    "Order",
    "Passage",
    "faulty_plan",
    "from_one_hot",
    "junctions_of",
    "one_hot",
    "phrasings",
    "sentence",
]
