"""Old place of an entry point."""

from wrongturn_agents.algorithms import algorithm_results

__all__ = ["algorithm_results"]
