"""Makes the stored evaluations, ``python -m lab.results --evaluations``, each with a service of its own."""

import contextlib
import tempfile
from collections.abc import Sequence
from pathlib import Path

import typer

from lab.evaluations import Evaluation, evaluations_folder, read_evaluations
from lab.importing import results_of_run
from lab.paths import LAB
from wrongturn_agents.agent_code import checksums
from wrongturn_agents.errors import ResultsError, RunFileError
from wrongturn_agents.evaluation_run import RunOptions, evaluate
from wrongturn_agents.progress import ProgressStyle
from wrongturn_agents.registry import AgentSource, resolve, with_absolute_file
from wrongturn_agents.saved_run import SavedRun
from wrongturn_agents.saved_run import directory as saved_runs
from wrongturn_agents.stored_results import Collection
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_protocol import RunFile


def make_evaluations(directory: Path, agents: Sequence[str], count: int, suite: str = WRONG_COMMAND) -> Path:
    """Drive a number of evaluations of each agent over the service, and store them.

    Each evaluation has a service and a database of its own, so no agent is beside another one of the same weights.
    Evaluations that are stored already are not driven again, and one that was interrupted is resumed: no draw is ever
    thrown away. Those of other weights are removed first. The first evaluation is the agent's row in the tables.

    Args:
        directory: Directory of the stored results.
        agents: Names of the agents.
        count: Number of evaluations of each.
        suite: Suite to drive.

    Returns:
        Folder of the evaluations.

    Raises:
        ResultsError: No agent is given, or an evaluation cannot be written.
        AgentsError: An agent does not exist or fails.
        WrongturnError: A service cannot be started, or fails.
    """
    if not agents:
        raise ResultsError("--evaluations: name the agents to drive with --agent. Example: --agent doubting")
    seeds = Collection.read(directory).shipped
    for agent in agents:
        source = resolve(agent)
        known = {one.number for one in _current(source)}
        for number in range(1, count + 1):
            if number not in known:
                run = _driven(agent, source, f"{source.name} {number}", suite)
                keep(evaluation_of(run, source, number, seeds.get(source.name)), directory)
    return evaluations_folder(LAB)


def keep(evaluation: Evaluation, directory: Path) -> None:
    """Store an evaluation; the first one is the agent's row in the tables too.

    Raises:
        ResultsError: It lacks trials, or cannot be written.
    """
    evaluation.check(evaluation.stem)
    evaluations_folder(LAB).mkdir(parents=True, exist_ok=True)
    evaluation.write(evaluations_folder(LAB))
    if evaluation.number == 1:
        evaluation.results.write(directory)


def code_of(source: AgentSource) -> dict[str, str]:
    """Return the SHA-256 of the files that drive, by name."""
    return {Path(file).name: found for file, found in checksums(source.code).items()}


def evaluation_of(run: RunFile, source: AgentSource, number: int, seed: int | None = None) -> Evaluation:
    """Return what is stored of a finished run.

    Raises:
        ResultsError: It is of another version of its suite than the one installed.
    """
    results = results_of_run(run, source.name).model_copy(update={"seed": seed})
    return Evaluation(**dict(results), number=number, evaluation=run.id, code=code_of(source))


def _current(source: AgentSource) -> list[Evaluation]:
    """Return the stored evaluations of an agent, after removing those that other weights drove."""
    own = [one for one in read_evaluations(LAB) if one.agent == source.name]
    for one in own:
        if one.code != code_of(source):
            typer.echo(f"{one.stem}: {source.name} has other files now; the evaluation is removed", err=True)
            (evaluations_folder(LAB) / f"{one.stem}.json").unlink()
    return [one for one in own if one.code == code_of(source)]


def _driven(agent: str, source: AgentSource, shown: str, suite: str) -> RunFile:
    """Drive an evaluation from where it is, under a name that tells it from other runs, and return its run."""
    interrupted = _interrupted(agent, source, shown, suite)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.json.gz"
        options = RunOptions(
            agent=agent,
            suite=suite if interrupted is None else None,
            url=None,
            name=shown if interrupted is None else None,
            json_file=file,
            resume=None if interrupted is None else interrupted.evaluation,
            parallel=None,
            progress=ProgressStyle.AUTO,
            keep=False,
        )
        done = evaluate(options)
        if done.unsaved is not None:
            raise done.unsaved
        return RunFile.read(file)


def _interrupted(agent: str, source: AgentSource, shown: str, suite: str) -> SavedRun | None:
    """Return the run to resume, if one with the same files was interrupted."""
    for file in sorted(saved_runs().glob("*.json")):
        with contextlib.suppress(RunFileError):
            run = SavedRun.load(str(file))
            same = (run.agent, run.name, run.suite, run.url) == (with_absolute_file(agent), shown, suite, None)
            if same and run.code == checksums(source.code):
                return run
    return None
