"""``wrongturn run --workers`` and ``--ray``: what fits together, and the way to :mod:`wrongturn_agents.batch`."""

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import typer
from rich.table import Table

from wrongturn_agents.errors import RunError
from wrongturn_agents.evaluation_run import RunOptions, made_once
from wrongturn_agents.practice import practice_table
from wrongturn_agents.progress import show_progress
from wrongturn_agents.suites import NAVIGATION, WRONG_COMMAND
from wrongturn_client.tables import console
from wrongturn_protocol.installing import install
from wrongturn_protocol.json_output import STDOUT, check_json_file

if TYPE_CHECKING:
    from wrongturn_agents.batch.batch_run import BatchRun

MOST_DRAWS: Final = 1000
"""Most public draws of one run."""


@dataclass(frozen=True)
class BatchOptions:
    """What the user asks for, as the options of the same names."""

    agents: Sequence[str] = ()
    draws: int | None = None
    workers: int | None = None
    ray: bool = False
    shard: str | None = None
    task: str | None = None

    @property
    def wanted(self) -> bool:
        """Whether this is a batch. Raises RunError if an option of batches is given without one."""
        if self.workers is not None and self.ray:
            raise RunError("--workers: drives on this machine, and --ray on a cluster; leave one of them out")
        if self.workers is not None or self.ray:
            return True
        for name, given in (("--draws", self.draws), ("--shard", self.shard)):
            if given is not None:
                raise RunError(f"{name}: drives without a service; add --workers N, or --ray")
        if len(self.agents) > 1:
            raise RunError("AGENT: a service gets one agent in a run; name one, or add --workers N, or --ray")
        return False


def drive_batch(options: RunOptions, batch: BatchOptions) -> None:
    """Drive a batch, and print its table, or say what to do with a shard's file. Raises RunError."""
    _check(options, batch)
    shard = shard_of(batch.shard)
    try:
        from wrongturn_agents.batch.batch_run import BatchAgent, BatchRun  # noqa: PLC0415 - comes with an extra
        from wrongturn_agents.batch.workers import workers  # noqa: PLC0415
    except ImportError as error:
        option, wanted = ("--ray", "wrongturn-ray") if batch.ray else ("--workers", "wrongturn-service")
        raise RunError(
            f"{option}: drives in process, and {error.name} is not installed; install it with: {install(wanted)}"
        ) from error
    suite = options.suite or (WRONG_COMMAND if batch.task is None else NAVIGATION)
    agents = [BatchAgent(named, made_once(named, None)[0]) for named in batch.agents]
    aside = options.json_file == STDOUT
    file = None if aside else options.json_file
    run = BatchRun(agents, suite, draws=batch.draws or 1, task=batch.task, shard=shard, file=file)
    name = agents[0].source.name if len(agents) == 1 else f"{len(agents)} agents"
    drivers = workers(batch.workers)
    try:
        with show_progress(options.progress, name) as update:
            run.drive(drivers, update)
    except BaseException:
        if file is not None:
            typer.echo(f"Not finished. The same command goes on with what {file} has.", err=True)
        raise
    if batch.shard is not None:
        typer.echo(f"{file} has shard {batch.shard}. Merge all: wrongturn results --merge FILE… --json OUT", err=True)
        return
    _show(run, aside=aside)


def shard_of(text: str | None) -> tuple[int, int]:
    """Return a shard's number, from 1, and the number of shards. Raises RunError."""
    if text is None:
        return 1, 1
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)
    number, shards = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= number <= shards:
        raise RunError(
            f"--shard: is {text!r}; give i/n with i from 1 to n, such as 2/10. A Slurm array begins at 1: --array=1-10"
        )
    return number, shards


def _check(options: RunOptions, batch: BatchOptions) -> None:
    option = "--ray" if batch.ray else "--workers"
    if not batch.agents:
        raise RunError("AGENT: name one or more; 'wrongturn agents' lists the shipped ones")
    if options.url is not None:
        raise RunError(f"{option}: drives without a service; leave --url out, and unset WRONGTURN_URL")
    for name, given in (("--name", options.name), ("--resume", options.resume), ("--keep", options.keep)):
        if given:
            raise RunError(f"{option}: keeps nothing but the file of --json; leave {name} out")
    if options.parallel is not None:
        raise RunError(f"--parallel: is for episodes on a service; leave it out beside {option}")
    if batch.shard is not None and (options.json_file is None or options.json_file == STDOUT):
        raise RunError("--shard: drives a piece; name its file with --json. Example: --json piece-1.json")
    if batch.shard is not None and batch.task is not None:
        raise RunError("--shard: divides whole suites; leave --task out")
    check_json_file(options.json_file)


def _show(run: "BatchRun", *, aside: bool) -> None:
    """Print the table in the paper's layout, or one of practice for each run of journeys; on stderr beside JSON."""
    from wrongturn_agents.results_file import text_of  # noqa: PLC0415

    for table in _tables(run):
        console(stderr=aside).print(table)
    if aside:
        sys.stdout.write(text_of(run.runs))


def _tables(run: "BatchRun") -> list[Table]:
    from wrongturn_agents import records as of_runs  # noqa: PLC0415 - slow to import

    if any(trial.is_twin for trial in run.suite_of(run.runs[0]).trials.values()):
        records = of_runs.pooled([of_runs.of_results(one) for one in run.runs])
        table = of_runs.results_table(records)
        of = "the open draw" if run.draws == 1 else f"the first {run.draws} public draws"
        table.caption = f"Practice on {of}, which everybody knows. It is never scored."
        return [table]
    return [practice_table(one, run.suite_of(one)) for one in run.runs]
