"""Errors of training."""

from wrongturn_agents.errors import AgentsError


class TrainingError(AgentsError, ValueError):
    """Error about a setting or file of a run. The message names it and the remedy."""
