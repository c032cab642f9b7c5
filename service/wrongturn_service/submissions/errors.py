"""Errors of checks and drives, which no call meets."""


class RefusedError(Exception):
    """The submission has failed. The message says why and what to do, for its owner."""


class OverError(Exception):
    """The submission is over: it was cancelled while it was checked or driven."""


class HaltedError(Exception):
    """The job was told to end: its submission is over, or the service stops."""
