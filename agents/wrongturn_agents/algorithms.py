"""The paper's algorithms over their training seeds, for the leaderboard: entry-point group ``wrongturn.algorithms``."""

from pathlib import Path

from wrongturn_agents.results_file import ResultsFile
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.stored_results import STORED
from wrongturn_agents.suites import sha256_of_suite
from wrongturn_protocol import AlgorithmResult, SeedOutcome


def algorithm_results(suite: str, directory: Path = STORED) -> tuple[AlgorithmResult, ...]:
    """Return the stored outcomes of each algorithm's training seeds on a suite's open draw.

    Ablations are left out, and so are suites that list their trials.

    Raises:
        ResultsError: A file is not valid, or does not fit its suite.
    """
    seeds: dict[str, dict[int, ResultsFile]] = {}
    for path in sorted(directory.glob("*.in-process.json")):
        if f".{suite}." not in path.name:
            continue
        file = ResultsFile.read(path)
        standard = file.agent in SHIPPED_AGENTS and file.variant is None
        if file.suite == suite and standard and file.seed is not None and file.secret is not None:
            file.check(path.name)
            seeds.setdefault(file.agent, {})[file.seed] = file
    return tuple(
        AlgorithmResult(
            name=agent,
            track=SHIPPED_AGENTS[agent].track,
            suite=suite,
            sha256=sha256_of_suite(suite),
            seeds={seed: _outcomes(file) for seed, file in sorted(found.items())},
        )
        for agent, found in seeds.items()
    )


def _outcomes(file: ResultsFile) -> dict[str, SeedOutcome]:
    return {
        name: SeedOutcome(
            verdict=one.verdict, reaction=one.reaction, flags=one.flags, speed_at_verdict=one.speed_at_verdict
        )
        for name, one in file.trials.items()
    }
