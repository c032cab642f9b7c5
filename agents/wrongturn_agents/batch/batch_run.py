"""One batch: agents, the public draws of a suite, and the shard that is driven here; its file and what it lacks."""

import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wrongturn_agents.batch.group import Group, drive_group
from wrongturn_agents.batch.workers import Workers
from wrongturn_agents.errors import RunError
from wrongturn_agents.practice import name_in_file, trials_of
from wrongturn_agents.progress import Progress
from wrongturn_agents.registry import AgentSource, with_absolute_file
from wrongturn_agents.results_file import ResultsFile, resumed, text_of
from wrongturn_agents.suites import SuiteTrials, installed_suite
from wrongturn_networks.draws import public_secret
from wrongturn_protocol.json_output import write_json

WHOLE: Final = (1, 1)
"""The only shard of a run in one piece."""
_LARGEST: Final = 16
"""Most trials of a group. A run that is killed loses the groups that were being driven."""
_EACH: Final = 4
"""Groups that each worker gets at least, if there are trials enough."""


@dataclass(frozen=True)
class BatchAgent:
    """An agent of a batch."""

    named: str
    """As the user names it."""
    source: AgentSource


class BatchRun:
    """Drives agents through the public draws of a suite, as far as its file lacks trials, and keeps what they did.

    The file has a run for each agent and draw, agents in their order. It says nothing of workers, shards or times.

    Args:
        agents: One or more, each of another name.
        suite: Id of the suite.
        draws: The first so many public draws; the first is the open draw. 1 for a suite that lists its trials.
        task: Drive only this task's trials; None for all.
        shard: Number of the shard, from 1, and of all shards.
        file: File of results, which is resumed if it exists; None for none.

    Raises:
        RunError: The agents, the draws or the shard do not fit, or the file is of another run.
        ResultsError: The file exists and is not a results file, or there is no such suite.
    """

    def __init__(
        self,
        agents: Sequence[BatchAgent],
        suite: str,
        *,
        draws: int = 1,
        task: str | None = None,
        shard: tuple[int, int] = WHOLE,
        file: Path | None = None,
    ) -> None:
        names = [name_in_file(one.source) for one in agents]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise RunError(f"AGENT: two are called {twice}; drive them in two runs with a file each")
        first = installed_suite(suite)
        if draws > 1 and first.secret is None:
            raise RunError(f"--draws: {suite} lists its trials, so there is one draw; leave --draws out")
        self.agents, self.draws, self.file = tuple(agents), draws, file
        self._task, self._shard = task, shard
        self._suite, self._in_draw = first, len(trials_of(first, task))
        runs = [
            ResultsFile(
                agent=name,
                suite=first.id,
                suite_sha256=first.sha256,
                secret=self._secret(draw),
                driven="in process",
                trials={},
            )
            for name in names
            for draw in range(1, draws + 1)
        ]
        self.runs = resumed(runs, file)

    @property
    def total(self) -> int:
        """Number of the shard's trials, driven or not."""
        begin, end = self._bounds
        return end - begin

    def drive(self, workers: Workers, progress: Progress) -> None:
        """Drive the missing trials of the shard, and write the file after each group.

        ``progress`` is called with the numbers of finished and of all trials.

        Raises what :meth:`Workers.drive` raises, and JsonFileError if the file cannot be written. The file holds the
        results so far.
        """
        write_json(text_of(self.runs), self.file)
        size = max(1, min(_LARGEST, math.ceil(self.total / (_EACH * workers.count))))
        progress(self._finished(), self.total)
        with closing(workers.drive(self._groups(size), drive_group)) as driven:  # type: ignore[type-var]
            for group, results in driven:
                run = self.runs[group.run]
                self.runs[group.run] = run.model_copy(update={"trials": {**run.trials, **results}})
                write_json(text_of(self.runs), self.file)
                progress(self._finished(), self.total)

    def suite_of(self, run: ResultsFile) -> SuiteTrials:
        """Return the trials of a run's draw. Towns that it makes are built where they are missing."""
        return self._suite if run.secret == self._suite.secret else run.drawn

    @property
    def _bounds(self) -> tuple[int, int]:
        """Where the shard begins and ends among all trials: those of the first draw come first, agent by agent."""
        (number, shards), whole = self._shard, self._in_draw * len(self.runs)
        return (number - 1) * whole // shards, number * whole // shards

    def _parts(self) -> Iterator[tuple[int, int, int]]:
        """Yield the runs that the shard has trials of: the run's number, and where its part begins and ends."""
        begin, end = self._bounds
        order = [agent * self.draws + draw for draw in range(self.draws) for agent in range(len(self.agents))]
        for place, run in enumerate(order):
            low, high = (min(max(bound - place * self._in_draw, 0), self._in_draw) for bound in (begin, end))
            if low < high:
                yield run, low, high

    def _groups(self, size: int) -> Iterator[Group]:
        """Yield the missing trials in groups. A draw's towns are built when its first group is wanted."""
        folder = str(Path.cwd())
        for run, low, high in self._parts():
            suite = self.suite_of(self.runs[run])
            names = sorted(trials_of(suite, self._task), key=lambda name: (suite.trials[name].town, name))[low:high]
            missing = [suite.trials[name] for name in names if name not in self.runs[run].trials]
            for begin in range(0, len(missing), size):
                agent = with_absolute_file(self.agents[run // self.draws].named)
                yield Group(run, agent, folder, tuple(missing[begin : begin + size]))

    def _finished(self) -> int:
        """Return how many trials of the runs are driven, at most those of the shard."""
        return min(self.total, sum(len(self.runs[run].trials) for run, *_ in self._parts()))

    def _secret(self, draw: int) -> str | None:
        return None if self._suite.secret is None else public_secret(self._suite.id, draw)
