"""Old place of an entry point."""

from wrongturn_agents.figures.cli import results

__all__ = ["results"]
