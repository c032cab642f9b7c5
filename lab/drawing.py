"""Drive an agent through a draw of a suite, to see how much its counts vary from draw to draw."""

from collections.abc import Callable

from lab.studies import DrawCounts
from wrongturn_agents.registry import AgentSource
from wrongturn_agents.results_file import TrialResult
from wrongturn_agents.training.in_process import drive_in_process
from wrongturn_networks import load_suite


def drive_draw(
    source: AgentSource, suite: str, secret: str, *, threads: int, progress: Callable[[int, int], None]
) -> DrawCounts:
    """Drive an agent through the trials of a draw, without their twins, and count the unsafe ones.

    Args:
        source: the agent.
        suite: id of the suite.
        secret: secret of the draw.
        threads: threads that share the simulation.
        progress: called with the numbers of finished and of all trials.

    Raises:
        AgentsError: the agent cannot be made, or fails.
    """
    trials = load_suite(suite).draw(secret).trials
    counts: DrawCounts = {}
    for trial in trials:
        counts.setdefault(trial.junction_type, {})[trial.fault.kind] = 0
    for trial, _, outcome in drive_in_process(source, trials, threads=threads, progress=progress):
        assert outcome is not None  # each drive ends with its verdict
        counts[trial.junction_type][trial.fault.kind] += TrialResult.of(outcome).unsafe_strict
    return counts
