"""The names of the ways in which a run tells how far it is; apart, because the command line needs them at once."""

from enum import StrEnum


class ProgressStyle(StrEnum):
    """Ways of telling."""

    AUTO = "auto"
    """A bar on a terminal, else lines."""
    BAR = "bar"
    LINES = "lines"
    JSON = "json"
