"""Adds results that were driven, or a curve that was trained, elsewhere to the stored results."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from lab.curves import read_progress
from lab.paths import LAB
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.figures.drives import check_suite
from wrongturn_agents.results_file import ResultsFile, TrialResult
from wrongturn_agents.saved_run import RunDatabase, SavedRun
from wrongturn_agents.worker import service_at
from wrongturn_client import Client
from wrongturn_protocol import RunFile, RunFormatError
from wrongturn_protocol.run_file import UNREADABLE, read_unpacked, reason_of

_REMEDY: Final = (
    "give a file of 'wrongturn score --json' or of 'wrongturn run --json', the file of a saved run, or the directory "
    "of a training run"
)
PRIVILEGED_CURVE: Final = "privileged.csv"
"""Progress of the first half of a run of ``lbc``: of the agent from which the other learns."""
_PLAIN_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")  # what a curve's file name may hold


@dataclass(frozen=True)
class Overrides:
    """Fields of imported results that the user gives; they replace what the imported file says."""

    agent: str | None = None
    seed: int | None = None
    variant: str | None = None
    steps: int | None = None


def import_results(source: Path, directory: Path, overrides: Overrides) -> Path:
    """Store a results file, an evaluation over a service, or a training run's curve.

    Args:
        source: A results file, as ``wrongturn score --json`` writes it; a run file, as ``wrongturn run --json`` writes
            it; the file of a saved run, in ``WRONGTURN_HOME``: its episodes are fetched from its service; or the
            directory of a training run.
        directory: Directory of the stored results.
        overrides: Fields that replace those of the source.

    Returns:
        Path of the stored file. A run of two halves has a curve of each: the path is that of the second.

    Raises:
        ResultsError: The source is none of these, or does not fit its suite.
        WrongturnError: The service cannot be reached.
    """
    if source.is_dir():
        return _import_curve(source, overrides)
    file = _results_of(source)
    given = {name: value for name, value in vars(overrides).items() if value is not None}
    try:
        file = ResultsFile.model_validate({**file.model_dump(), **given})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ResultsError(f"--{first['loc'][0]}: {first['input']!r} is not valid: {first['msg']}") from error
    file.check(source.name)
    return file.write(directory)


def results_of_run(run: RunFile, agent: str | None = None) -> ResultsFile:
    """Return the results file of a finished evaluation.

    Args:
        run: The evaluation with its episodes.
        agent: Name of the agent; None for its name on the leaderboard.

    Raises:
        ResultsError: The run is of another version of the suite than the one installed.
    """
    check_suite(run.suite, run.suite_sha256)
    return ResultsFile(
        agent=agent or run.driver.name,
        suite=run.suite,
        suite_sha256=run.suite_sha256,
        secret=run.secret,
        commitment=run.commitment,
        driven="over the service",
        trials={episode.trial: TrialResult.of(episode.outcome) for episode in run.episodes},
    )


def _results_of(source: Path) -> ResultsFile:
    """Return the results in a file of any of the kinds that are imported."""
    try:
        content = read_unpacked(source)
    except FileNotFoundError as error:
        raise ResultsError(f"--import: there is no file {source}; {_REMEDY}") from error
    except UNREADABLE as error:
        raise ResultsError(f"--import: {source} cannot be read ({reason_of(error)}); {_REMEDY}") from error
    try:
        found = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ResultsError(f"--import: {source} cannot be read as JSON ({error}); {_REMEDY}") from error
    keys = found.keys() if isinstance(found, dict) else set()
    if {"id", "suite", "state"} <= keys:
        return _results_of_run_file(source)
    if {"evaluation", "suite", "token"} <= keys:
        return _fetch(SavedRun.load(str(source), "--import"))
    if {"number", "evaluation", "trials"} <= keys:
        raise ResultsError(f"--import: {source} is a stored evaluation of --evaluations; there is nothing to import")
    if "trials" in keys and "verdict" not in keys:
        return ResultsFile.read(source)
    raise ResultsError(f"--import: {source} holds no results; {_REMEDY}")


def _results_of_run_file(source: Path) -> ResultsFile:
    try:
        return results_of_run(RunFile.read(source))
    except RunFormatError as error:
        raise ResultsError(f"--import: {error}") from error


def _fetch(saved: SavedRun) -> ResultsFile:
    database = None if saved.database is None else RunDatabase(saved.database).url
    with service_at(saved.url, None, database) as (url, _), Client(url, "") as client:
        run = client.run_file(saved.evaluation)
    return results_of_run(run, saved.name)


def _import_curve(run: Path, overrides: Overrides) -> Path:
    if not (run / "progress.csv").is_file():
        raise ResultsError(
            f"--import: {run} is a directory without progress.csv, so it is not a training run's; {_REMEDY}"
        )
    config: Any = {}
    if (run / "config.json").is_file():
        try:
            config = json.loads((run / "config.json").read_bytes())
        except (OSError, ValueError, RecursionError) as error:
            raise ResultsError(f"--import: {run / 'config.json'} cannot be read as JSON ({error})") from error
    if not isinstance(config, dict):
        raise ResultsError(
            f"--import: {run / 'config.json'} is not a run's config; name the directory of a training run"
        )
    agent = overrides.agent or config.get("algorithm")
    seed = overrides.seed if overrides.seed is not None else config.get("seed")
    if not isinstance(agent, str) or not isinstance(seed, int):
        raise ResultsError(f"--import: {run} does not say which algorithm and seed it is of; give --agent and --seed")
    variant = overrides.variant or config.get("variant")
    for option, value in (("--agent", agent), ("--variant", variant)):
        if value is not None and not (isinstance(value, str) and _PLAIN_NAME.fullmatch(value)):
            raise ResultsError(f"{option}: {value!r} is not valid; give letters, digits, dashes and underscores")
    first = run / PRIVILEGED_CURVE
    if first.is_file() and variant is None:  # an ablation leaves out a part of the second half only
        read_progress(first, f"{agent}-privileged", seed).thinned().write(LAB / "curves")
    return read_progress(run / "progress.csv", agent, seed, variant).thinned().write(LAB / "curves")
