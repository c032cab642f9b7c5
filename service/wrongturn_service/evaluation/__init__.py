"""What an evaluation came to, and how agents stand to one another: pure functions over outcomes.

- :mod:`~wrongturn_service.evaluation.metrics`: one agent's figures on a suite.
- :mod:`~wrongturn_service.evaluation.navigation`: what is counted of journeys.
- :mod:`~wrongturn_service.evaluation.ranking`: a suite's leaderboard from everybody's figures.
- :mod:`~wrongturn_service.evaluation.statistics`: the intervals and tests that both use.
"""

from wrongturn_service.evaluation.metrics import SuiteLike, UnscoredTrialError, compute
from wrongturn_service.evaluation.ranking import RankingInput, rank

__all__ = ["RankingInput", "SuiteLike", "UnscoredTrialError", "compute", "rank"]
