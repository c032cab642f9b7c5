"""Metrics of evaluations, and rankings of agents.

- :mod:`~wrongturn_service.evaluation.metrics`: an agent's metrics on a suite.
- :mod:`~wrongturn_service.evaluation.navigation`: metrics of journeys.
- :mod:`~wrongturn_service.evaluation.ranking`: a suite's ranking from the metrics of all agents.
- :mod:`~wrongturn_service.evaluation.comparison`: an exact test between two agents.
- :mod:`~wrongturn_service.evaluation.algorithms`: rows over training seeds, which other packages provide.
- :mod:`~wrongturn_service.evaluation.statistics`: intervals and tests.
- :mod:`~wrongturn_service.evaluation.leaderboards`: the leaderboards, kept until an evaluation changes them.
"""

from wrongturn_service.evaluation.metrics import SuiteLike, UnscoredTrialError, compute
from wrongturn_service.evaluation.ranking import RankingInput, rank

__all__ = ["RankingInput", "SuiteLike", "UnscoredTrialError", "compute", "rank"]
