"""Short words for people: the same on pages, in terminals, in tables and in figures."""

from typing import Final

from wrongturn_protocol.vocabulary import Command, Condition, JunctionType, Task, Verdict

COMMANDS: Final = {
    Command.LEFT: "left",
    Command.RIGHT: "right",
    Command.STRAIGHT: "straight on",
    Command.LANE_FOLLOW: "follow the lane",
    Command.VOID: "nothing",
}
"""What each command tells the agent."""
EXITS: Final = {Command.LEFT: "left exit", Command.RIGHT: "right exit", Command.STRAIGHT: "straight on"}
"""The exits of a junction."""
_NAMES: Final[dict[str, str]] = {
    JunctionType.CROSS: "crossing",
    JunctionType.STRAIGHT_LEFT: "straight or left",
    JunctionType.STRAIGHT_RIGHT: "straight or right",
    JunctionType.LEFT_RIGHT: "left or right",
    Task.NAVIGATION_DYNAMIC: "navigation with traffic",
    Condition.TRAINING: "town and weather of training",
    Condition.NEW_TOWN_AND_WEATHER: "new town and weather",
}
"""Words that do not follow from their value in the vocabulary."""


def name(word: str) -> str:
    """Return a word of the vocabulary as people read it: ``off_road`` is "off road", ``CROSS`` is "crossing"."""
    return _NAMES.get(word) or str(word).lower().replace("_", " ")


def ending(verdict: Verdict, exit_taken: Command | None) -> str:
    """Return where an episode ended: the exit that was taken, or the verdict."""
    return EXITS[exit_taken] if verdict.exited and exit_taken is not None else name(verdict)
