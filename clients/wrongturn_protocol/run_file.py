"""The file that ``wrongturn run --json`` writes: an evaluation with every episode."""

from typing import Any

from wrongturn_protocol.results import AgentDetail, EpisodeResult, EvaluationDetail


class DrivenEpisode(EpisodeResult):
    """A finished episode with its trajectory."""

    trajectory: dict[str, Any] | None = None
    """The trajectory as ``GET /v1/episodes/{id}/trajectory`` gives it. None for an episode that ended without one."""


class RunFile(EvaluationDetail):
    """A finished evaluation, its agent, and every episode. ``replay`` and ``results --import`` read it."""

    driver: AgentDetail
    """The agent. Its id is ``agent``."""
    episodes: tuple[DrivenEpisode, ...]
    """The trials and twins, in the order in which they were driven."""
