"""Adds results that were driven, or a curve that was trained, elsewhere to the stored results."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.reporting.curves import read_progress
from wrongturn_agents.reporting.results_file import ResultsFile, TrialResult
from wrongturn_agents.saved_run import SavedRun
from wrongturn_agents.suites import installed_suite
from wrongturn_agents.worker import service_at
from wrongturn_client import Client
from wrongturn_protocol import EpisodeDetail, EvaluationDetail

_REMEDY: Final = (
    "give a file of 'wrongturn score --json' or of 'wrongturn run --json', the file of a saved run, or the directory "
    "of a training run"
)
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
        source: A results file, as ``wrongturn score --json`` writes it; an evaluation, as ``wrongturn run --json``
            writes it, or the file of a saved run, in ``WRONGTURN_HOME``: its episodes are fetched from its service; or
            the directory of a training run.
        directory: Directory of the stored results.
        overrides: Fields that replace those of the source.

    Returns:
        Path of the stored file.

    Raises:
        ResultsError: The source is none of these, or does not fit its suite.
        RunFileError: The run of the evaluation is not known here any more.
        WrongturnError: The service cannot be reached.
    """
    if source.is_dir():
        return _import_curve(source, directory, overrides)
    try:
        content = json.loads(source.read_bytes())
    except FileNotFoundError as error:
        raise ResultsError(f"--import: there is no file {source}; {_REMEDY}") from error
    except OSError as error:
        raise ResultsError(f"--import: {source} cannot be read ({error.strerror}); {_REMEDY}") from error
    except (ValueError, RecursionError) as error:
        raise ResultsError(f"--import: {source} cannot be read as JSON ({error}); {_REMEDY}") from error
    if isinstance(content, dict) and "trials" in content and "verdict" not in content and "id" not in content:
        file = ResultsFile.read(source)
    elif isinstance(content, dict) and {"id", "suite", "state"} <= content.keys() and isinstance(content["id"], str):
        file = _fetch_evaluation(SavedRun.load(content["id"], "--import"))
    elif isinstance(content, dict) and {"evaluation", "suite", "token"} <= content.keys():
        file = _fetch_evaluation(SavedRun.load(str(source), "--import"))
    else:
        raise ResultsError(f"--import: {source} cannot be stored; {_REMEDY}")
    given = {name: value for name, value in vars(overrides).items() if value is not None}
    try:
        file = ResultsFile.model_validate({**file.model_dump(), **given})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ResultsError(f"--{first['loc'][0]}: {first['input']!r} is not valid: {first['msg']}") from error
    file.check(source.name)
    return file.write(directory)


def results_of_evaluation(agent: str, evaluation: EvaluationDetail, episodes: tuple[EpisodeDetail, ...]) -> ResultsFile:
    """Return the results file of a finished evaluation.

    Args:
        agent: Name of the agent.
        evaluation: The evaluation, with its secret if its suite draws trials.
        episodes: Its finished episodes.

    Raises:
        ResultsError: The service does not show an episode yet, because the evaluation is not finished.
    """
    trials = {}
    for episode in episodes:
        if episode.trial is None or episode.outcome is None:
            raise ResultsError(f"--import: episode {episode.id} is not shown yet; finish the evaluation first")
        trials[episode.trial] = TrialResult.of(episode.outcome)
    return ResultsFile(
        agent=agent,
        suite=evaluation.suite,
        suite_sha256=installed_suite(evaluation.suite).sha256,
        secret=evaluation.secret,
        commitment=evaluation.commitment,
        driven="over the service",
        trials=trials,
    )


def _fetch_evaluation(run: SavedRun) -> ResultsFile:
    with service_at(run.url, None) as (url, _), Client(url, run.token) as client:
        installed, driven = installed_suite(run.suite).sha256, client.suite(run.suite).sha256
        if driven != installed:
            raise ResultsError(
                f"--import: the service drives another {run.suite} ({driven[:12]}) than the one installed "
                f"({installed[:12]}); install its version",
            )
        evaluation = client.evaluation(run.evaluation)
        episodes = client.finished_episodes(run.evaluation)
    agent = Path(run.agent).stem if run.agent.endswith(".onnx") else run.agent
    return results_of_evaluation(agent, evaluation, episodes)


def _import_curve(run: Path, directory: Path, overrides: Overrides) -> Path:
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
    return read_progress(run / "progress.csv", agent, seed, variant).thinned().write(directory / "curves")
