"""All results that are stored, checked before anything is counted."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Self

from pydantic import TypeAdapter, ValidationError

from wrongturn_agents.reporting.errors import ResultsError
from wrongturn_agents.reporting.paper import ALGORITHMS
from wrongturn_agents.reporting.results_file import ResultsFile
from wrongturn_agents.suites import SuiteOf, SuiteTrials

STORED: Final = Path(__file__).parents[1] / "results"
"""The results that come with the package."""
SHIPPED: Final = "shipped.json"
"""Beside them: the training seed of each agent whose weights come with the package."""
_NAMED: Final = 3


@dataclass(frozen=True)
class Collection:
    """Results of agents and seeds on suites; each is complete, and there is one of each kind at most."""

    files: tuple[ResultsFile, ...]
    """Sorted by the names under which they are kept."""
    shipped: dict[str, int]
    """The training seed of each agent whose weights are shipped."""
    suite_of: SuiteOf

    @classmethod
    def read(cls, directory: Path, suite_of: SuiteOf) -> Self:
        """Read a directory's files.

        Raises:
            ResultsError: the directory is missing; a file is none, of another version of its suite, incomplete, or
                there twice. The file is named.
        """
        if not directory.is_dir():
            raise ResultsError(f"--directory: {directory} is no directory; name one that holds results files")
        paths = sorted(path for path in directory.glob("*.json") if path.name != SHIPPED)
        found: dict[str, tuple[Path, ResultsFile]] = {}
        for path in paths:
            file = ResultsFile.read(path)
            check(path.name, file, suite_of(file.suite))
            if file.stem in found:
                raise ResultsError(
                    f"{path.name}: {describe(file)} stands in {found[file.stem][0].name} already; remove one of them",
                )
            found[file.stem] = (path, file)
        return cls(tuple(found[stem][1] for stem in sorted(found)), _shipped(directory / SHIPPED), suite_of)

    def of(self, suite: str, agent: str, variant: str | None = None) -> dict[int | None, ResultsFile]:
        """An agent's results on a suite by training seed; of a trial driven both ways, those in process."""
        return _by_seed(self._sorted(suite, agent, variant, last="in process"))

    def of_shipped(self, suite: str, agent: str) -> ResultsFile | None:
        """The shipped weights' results; of a trial driven both ways, those over the service.

        An agent that is not trained has no seed, and is shipped as it is.
        """
        seed = self.shipped.get(agent)
        return _by_seed(self._sorted(suite, agent, None, last="over the service")).get(seed)

    def driven_how(self, suite: str, agent: str) -> dict[str, str]:
        """How each trial of :meth:`of_shipped` was driven."""
        seed = self.shipped.get(agent)
        files = self._sorted(suite, agent, None, last="over the service")
        return {trial: file.driven for file in files if file.seed == seed for trial in file.trials}

    def agents(self, suite: str) -> tuple[str, ...]:
        """Who has results on a suite as it is, no variant: the paper's algorithms first, then by name."""
        names = {file.agent for file in self.files if file.suite == suite and file.variant is None}
        return tuple(sorted(names, key=lambda name: (_place(name), name)))

    @cached_property
    def variants(self) -> tuple[tuple[str, str], ...]:
        """Agents and variants of ablations."""
        found = {(file.agent, file.variant) for file in self.files if file.variant is not None}
        return tuple(sorted(found, key=lambda one: (_place(one[0]), *one)))

    def differences(self) -> Iterator[tuple[ResultsFile, int]]:
        """Results that were driven both ways, and the number of trials with different verdicts."""
        by_kind = {(file.agent, file.seed, file.variant, file.suite, file.driven): file for file in self.files}
        for (agent, seed, variant, suite, driven), file in by_kind.items():
            other = by_kind.get((agent, seed, variant, suite, "over the service"))
            if driven == "in process" and other is not None:
                yield (
                    file,
                    sum(
                        one.verdict != other.trials[name].verdict
                        for name, one in file.trials.items()
                        if name in other.trials
                    ),
                )

    def missing(self, suites: Iterable[str]) -> tuple[str, ...]:
        """What the tables lack, a line each."""
        lines = []
        for suite in suites:
            absent = [agent for agent in ALGORITHMS if not self.of(suite, agent)]
            if absent:
                lines.append(f"no results on {suite}: {', '.join(absent)}")
        seeds = {agent: {seed for suite in suites for seed in self.of(suite, agent)} for agent in ALGORITHMS}
        for suite in suites:
            for agent in ALGORITHMS:
                have = self.of(suite, agent)
                lacking = sorted(str(seed) for seed in seeds[agent] - set(have))
                if have and lacking:
                    lines.append(f"{agent} has no results on {suite} of seed {', '.join(lacking)}")
            for agent in self.shipped:
                file = self.of_shipped(suite, agent)
                if file is not None and self.suite_of(suite).trials.keys() - file.trials:
                    lines.append(f"{agent}, shipped seed {file.seed}, has not met the other road users of {suite}")
        unshipped = [agent for agent in ALGORITHMS if seeds[agent] and agent not in self.shipped]
        if unshipped:
            lines.append(f"{SHIPPED} names no seed of {', '.join(unshipped)}")
        return tuple(lines)

    def _sorted(self, suite: str, agent: str, variant: str | None, *, last: str) -> list[ResultsFile]:
        files = [file for file in self.files if (file.suite, file.agent, file.variant) == (suite, agent, variant)]
        return sorted(files, key=lambda file: (-1 if file.seed is None else file.seed, file.driven == last))


def check(name: str, file: ResultsFile, suite: SuiteTrials) -> None:
    """See that a file is of the suite as it is installed, and has all its trials and no others.

    Drives in process may leave out all that need other road users, and thereby SUMO; drives over the service may be
    of these alone.

    Raises:
        ResultsError: it is not.
    """
    if file.suite_sha256 != suite.sha256:
        raise ResultsError(
            f"{name}: suite_sha256: it is of another {file.suite} ({file.suite_sha256[:12]}) than the one installed "
            f"({suite.sha256[:12]}); drive it again on that one",
        )
    lacking = suite.trials.keys() - file.trials
    crowded = {name for name, trial in suite.trials.items() if trial.traffic.vehicles or trial.traffic.pedestrians}
    left_out = crowded if file.driven == "in process" else suite.trials.keys() - crowded
    if crowded and lacking == left_out:
        lacking = set()
    for what, ids in (("lacks", lacking), ("has unknown", file.trials.keys() - suite.trials)):
        if ids:
            some = ", ".join(sorted(ids)[:_NAMED]) + (", …" if len(ids) > _NAMED else "")
            raise ResultsError(
                f"{name}: trials: {what} {len(ids)} of {file.suite}'s {len(suite.trials)} ({some}); "
                "drive the whole suite again",
            )


def describe(file: ResultsFile) -> str:
    """A file in words."""
    words = [file.agent, file.variant, None if file.seed is None else f"seed {file.seed}", f"on {file.suite}"]
    return " ".join(word for word in (*words, file.driven) if word is not None)


def _by_seed(files: Iterable[ResultsFile]) -> dict[int | None, ResultsFile]:
    """A seed's files as one; of a trial that stands in several, the last one's."""
    found: dict[int | None, ResultsFile] = {}
    for file in files:
        before = found.get(file.seed)
        found[file.seed] = file.model_copy(update={"trials": {**(before.trials if before else {}), **file.trials}})
    return found


def _place(agent: str) -> int:
    return ALGORITHMS.index(agent) if agent in ALGORITHMS else len(ALGORITHMS)


def _shipped(path: Path) -> dict[str, int]:
    if not path.is_file():
        return {}
    try:
        return TypeAdapter(dict[str, int]).validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise ResultsError(f"{path.name}: give each agent's seed, as {{'ppo-image': 3}} in JSON ({error})") from error
