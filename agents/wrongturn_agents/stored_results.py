"""The results that come with the package: what the shipped agents did on the suites."""

from pathlib import Path
from typing import Final

from pydantic import TypeAdapter, ValidationError

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.results_file import ResultsFile
from wrongturn_protocol import PAPER

STORED: Final = Path(__file__).parent / "results"
"""Directory of the results that come with the package."""
ALGORITHMS: Final = tuple(agent.ours for agent in PAPER)
"""Names of our agents that follow the designs of the paper's agents, in the order of its tables."""
SHIPPED: Final = "shipped.json"
"""File in that directory: the training seed of each agent with shipped weights."""


def shipped_seeds(directory: Path = STORED) -> dict[str, int]:
    """Return the training seed of each agent whose weights are shipped. Raises ResultsError."""
    path = directory / SHIPPED
    if not path.is_file():
        return {}
    try:
        return TypeAdapter(dict[str, int]).validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise ResultsError(f"{path.name}: give each agent's seed, as {{'ppo-image': 3}} in JSON ({error})") from error


def shipped_results(suite: str, directory: Path = STORED) -> dict[str, ResultsFile]:
    """Return the results of the shipped agents on a suite by name, the paper's algorithms first.

    An agent without training has no seed and is shipped as it is. Results that were driven both ways make one file if
    they are of the same trials. Two draws of a suite are other trials: the one over the service counts.

    Raises:
        ResultsError: A file is not valid, or does not fit its suite.
    """
    seeds = shipped_seeds(directory)
    found: dict[str, ResultsFile] = {}
    for path in sorted(directory.glob(f"*.{suite}.*.json")):  # in process first
        file = ResultsFile.read(path)
        if file.variant is None and file.seed == seeds.get(file.agent):
            file.check(path.name)
            found[file.agent] = file.over(found.get(file.agent))
    return {agent: found[agent] for agent in sorted(found, key=table_order)}


def table_order(agent: str) -> tuple[int, str]:
    """Return a sort key for agents: the paper's algorithms first, then by name."""
    return (ALGORITHMS.index(agent) if agent in ALGORITHMS else len(ALGORITHMS), agent)
