"""What can go wrong in training."""

from wrongturn_agents.errors import AgentsError


class TrainingError(AgentsError, ValueError):
    """A setting of a run that cannot be: it names the setting and the remedy."""
