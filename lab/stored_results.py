"""All stored results, checked before anything is counted."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.results_file import Driven, ResultsFile
from wrongturn_agents.stored_results import SHIPPED, shipped_seeds, table_order

_NOT_IN_FILE_NAMES: Final = re.compile(r"[^A-Za-z0-9@.]+")


class StoredResults(ResultsFile):
    """Results in a file that is named after them."""

    @property
    def stem(self) -> str:
        """File name without extension, made of agent, variant, seed, suite and the way of driving."""
        parts = [self.agent, self.variant, None if self.seed is None else f"s{self.seed}", self.suite, self.driven]
        return ".".join(_NOT_IN_FILE_NAMES.sub("-", part) for part in parts if part is not None)

    def __str__(self) -> str:
        words = [self.agent, self.variant, None if self.seed is None else f"seed {self.seed}", f"on {self.suite}"]
        return " ".join(word for word in (*words, self.driven) if word is not None)

    def write(self, directory: Path) -> Path:
        """Write the file into a directory under its own name, and return the path.

        Raises:
            ResultsError: The file cannot be written, or another agent's has this name.
        """
        path = directory / f"{self.stem}.json"
        if path.is_file() and (other := self.read(path).agent) != self.agent:
            raise ResultsError(
                f"{path.name}: holds the results of {other!r}, and those of {self.agent!r} would have the same file "
                "name; choose another by --agent"
            )
        try:
            path.write_text(self.text(), encoding="utf-8")
        except OSError as error:
            raise ResultsError(f"{path}: cannot be written ({error.strerror}); name another --directory") from error
        return path


@dataclass(frozen=True)
class Collection:
    """Complete results of agents and seeds on suites, with at most one file of each kind."""

    files: tuple[StoredResults, ...]
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
        found: dict[str, tuple[Path, StoredResults]] = {}
        for path in sorted(path for path in directory.glob("*.json") if path.name != SHIPPED):
            file = StoredResults.read(path)
            file.check(path.name)
            if file.stem in found:
                raise ResultsError(f"{path.name}: {file} is already in {found[file.stem][0].name}; remove one of them")
            found[file.stem] = (path, file)
        return cls(tuple(found[stem][1] for stem in sorted(found)), shipped_seeds(directory))

    def by_seed(
        self, suite: str, agent: str, variant: str | None = None, *, prefer: Driven = "in process"
    ) -> dict[int | None, StoredResults]:
        """Return an agent's results on a suite by training seed, each as one file.

        Results of one seed that were driven both ways make one file if they are of the same trials. Two draws of a
        suite are other trials: the one of the preferred way counts. The variant is an ablation's name.
        """
        merged: dict[int | None, StoredResults] = {}
        files = [file for file in self.files if (file.suite, file.agent, file.variant) == (suite, agent, variant)]
        for file in sorted(files, key=lambda file: (-1 if file.seed is None else file.seed, file.driven == prefer)):
            merged[file.seed] = file.over(merged.get(file.seed))
        return merged

    def of_shipped(self, suite: str, agent: str) -> StoredResults | None:
        """Return the results of the shipped weights, preferably over the service; None if there are none.

        An agent without training has no seed and is shipped as it is.
        """
        return self.by_seed(suite, agent, prefer="over the service").get(self.shipped.get(agent))

    def agents(self, suite: str) -> tuple[str, ...]:
        """Return the agents with results on a suite (no ablations), the paper's algorithms first."""
        names = {file.agent for file in self.files if file.suite == suite and file.variant is None}
        return tuple(sorted(names, key=table_order))
