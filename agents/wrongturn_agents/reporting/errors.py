"""What can go wrong with stored results."""

from wrongturn_agents.errors import AgentsError


class ResultsError(AgentsError):
    """A stored file, or what was asked for, does not fit; the text is one line for a user."""


class MissingPackageError(ResultsError):
    """A package of the extra ``training`` is not installed."""


class OutdatedPageError(ResultsError):
    """A page or picture says something else than the stored results."""
