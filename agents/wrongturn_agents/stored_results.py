"""All stored results, checked before anything is counted."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from pydantic import TypeAdapter, ValidationError

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.results_file import Driven, ResultsFile
from wrongturn_protocol import PAPER

STORED: Final = Path(__file__).parent / "results"
"""Directory of the results that come with the package."""
ALGORITHMS: Final = tuple(agent.ours for agent in PAPER)
"""Names of our agents that follow the designs of the paper's agents, in the order of its tables."""
_SHIPPED: Final = "shipped.json"  # in that directory: the training seed of each agent with shipped weights


@dataclass(frozen=True)
class Collection:
    """Complete results of agents and seeds on suites, with at most one file of each kind."""

    files: tuple[ResultsFile, ...]
    """Results, sorted by file name."""
    shipped: dict[str, int]
    """Training seed of each agent whose weights are shipped."""

    @classmethod
    def read(cls, directory: Path) -> Self:
        """Read the files of a directory.

        Raises:
            ResultsError: The directory is missing; or a file is not valid, is of another version of its suite, is
                incomplete, or holds the same results as another file. The error names the file.
        """
        if not directory.is_dir():
            raise ResultsError(f"--directory: {directory} is not a directory; name one with results files")
        found: dict[str, tuple[Path, ResultsFile]] = {}
        for path in sorted(path for path in directory.glob("*.json") if path.name != _SHIPPED):
            file = ResultsFile.read(path)
            file.check(path.name)
            if file.stem in found:
                raise ResultsError(f"{path.name}: {file} is already in {found[file.stem][0].name}; remove one of them")
            found[file.stem] = (path, file)
        return cls(tuple(found[stem][1] for stem in sorted(found)), _shipped_seeds(directory / _SHIPPED))

    def by_seed(
        self, suite: str, agent: str, variant: str | None = None, *, prefer: Driven = "in process"
    ) -> dict[int | None, ResultsFile]:
        """Return an agent's results on a suite by training seed, each as one file.

        Results of one seed that were driven both ways make one file if they are of the same trials. Two draws of a
        suite are other trials: the one of the preferred way counts. The variant is an ablation's name.
        """
        merged: dict[int | None, ResultsFile] = {}
        files = [file for file in self.files if (file.suite, file.agent, file.variant) == (suite, agent, variant)]
        for file in sorted(files, key=lambda file: (-1 if file.seed is None else file.seed, file.driven == prefer)):
            before = merged.get(file.seed)
            same_draw = before is not None and before.secret == file.secret
            merged[file.seed] = file.model_copy(
                update={"trials": {**(before.trials if before and same_draw else {}), **file.trials}}
            )
        return merged

    def of_shipped(self, suite: str, agent: str) -> ResultsFile | None:
        """Return the results of the shipped weights, preferably over the service; None if there are none.

        An agent without training has no seed and is shipped as it is.
        """
        return self.by_seed(suite, agent, prefer="over the service").get(self.shipped.get(agent))

    def agents(self, suite: str) -> tuple[str, ...]:
        """Return the agents with results on a suite (no ablations), the paper's algorithms first."""
        names = {file.agent for file in self.files if file.suite == suite and file.variant is None}
        return tuple(sorted(names, key=table_order))


def _shipped_seeds(path: Path) -> dict[str, int]:
    if not path.is_file():
        return {}
    try:
        return TypeAdapter(dict[str, int]).validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise ResultsError(f"{path.name}: give each agent's seed, as {{'ppo-image': 3}} in JSON ({error})") from error


def table_order(agent: str) -> tuple[int, str]:
    """Return a sort key for agents: the paper's algorithms first, then by name."""
    return (ALGORITHMS.index(agent) if agent in ALGORITHMS else len(ALGORITHMS), agent)
