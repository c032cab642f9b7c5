"""Taking what was driven or trained elsewhere into the stored results."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from wrongturn_agents.reporting.collection import check
from wrongturn_agents.reporting.curves import read_progress
from wrongturn_agents.reporting.errors import ResultsError
from wrongturn_agents.reporting.results_file import ResultsFile, TrialResult
from wrongturn_agents.suites import SuiteOf
from wrongturn_protocol import EpisodeDetail

_REMEDY: Final = (
    "give a file of 'wrongturn score --json' or of 'wrongturn run --json', or the directory of a training run"
)
_PLAIN: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
"""Names that a curve's file can be called by."""


@dataclass(frozen=True)
class Origin:
    """What a file that is taken in does not say itself; it goes before what the file says."""

    agent: str | None = None
    seed: int | None = None
    variant: str | None = None
    steps: int | None = None


def take_in(source: Path, directory: Path, origin: Origin, suite_of: SuiteOf) -> Path:
    """Keep a results file, an evaluation over a service, or a training run's curve.

    Args:
        source: a results file as ``wrongturn score`` writes it; what ``wrongturn run --json`` wrote, whose episodes
            the service that the run was at is asked for; or the directory of a training run.
        directory: of the stored results.
        origin: what the source does not say.
        suite_of: finds the suite that a results file is held against.

    Returns:
        The file that was written.

    Raises:
        ResultsError: the source is none of these, or does not fit its suite.
        RunFileError: the run is not known here any more.
        WrongturnError: the service cannot be reached.
    """
    if source.is_dir():
        return _curve(source, directory, origin)
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
        file = _evaluation(content["id"], suite_of)
    else:
        raise ResultsError(f"--import: {source} is nothing that can be stored; {_REMEDY}")
    told = {name: value for name, value in vars(origin).items() if value is not None}
    try:
        file = ResultsFile.model_validate({**file.model_dump(), **told})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ResultsError(f"--{first['loc'][0]}: {first['input']!r} cannot be one: {first['msg']}") from error
    check(source.name, file, suite_of(file.suite))
    return file.write(directory)


def of_episodes(agent: str, suite: str, episodes: tuple[EpisodeDetail, ...], suite_of: SuiteOf) -> ResultsFile:
    """The results file of an evaluation's finished episodes.

    Raises:
        ResultsError: an episode is not shown, for the evaluation is not finished.
    """
    trials = {}
    for episode in episodes:
        if episode.trial is None or episode.outcome is None:
            raise ResultsError(f"--import: episode {episode.id} is not shown yet; finish the evaluation first")
        outcome = episode.outcome
        clean = None if outcome.journey is None else outcome.journey.clean
        trials[episode.trial] = TrialResult(verdict=outcome.verdict, reaction=outcome.reaction, clean=clean)
    return ResultsFile(
        agent=agent, suite=suite, suite_sha256=suite_of(suite).sha256, driven="over the service", trials=trials
    )


def _evaluation(evaluation: str, suite_of: SuiteOf) -> ResultsFile:
    from wrongturn_agents.saved_run import SavedRun  # noqa: PLC0415
    from wrongturn_agents.worker import service_at  # noqa: PLC0415
    from wrongturn_client import Client  # noqa: PLC0415

    run = SavedRun.load(evaluation)
    with service_at(run.url, None) as (url, _), Client(url, run.token) as client:
        installed = suite_of(run.suite).sha256
        driven = client.suite(run.suite).sha256
        if driven != installed:
            raise ResultsError(
                f"--import: the service drives another {run.suite} ({driven[:12]}) than the one installed "
                f"({installed[:12]}); install its version",
            )
        episodes = client.finished_episodes(evaluation)
    return of_episodes(
        Path(run.agent).stem if run.agent.endswith(".onnx") else run.agent, run.suite, episodes, suite_of
    )


def _curve(run: Path, directory: Path, origin: Origin) -> Path:
    if not (run / "progress.csv").is_file():
        raise ResultsError(f"--import: {run} is a directory, and no training run's: it has no progress.csv; {_REMEDY}")
    config: Any = {}
    if (run / "config.json").is_file():
        try:
            config = json.loads((run / "config.json").read_bytes())
        except (OSError, ValueError, RecursionError) as error:
            raise ResultsError(f"--import: {run / 'config.json'} cannot be read as JSON ({error})") from error
    if not isinstance(config, dict):
        raise ResultsError(f"--import: {run / 'config.json'} is no run's; name the directory of a training run")
    agent = origin.agent or config.get("algorithm")
    seed = origin.seed if origin.seed is not None else config.get("seed")
    if not isinstance(agent, str) or not isinstance(seed, int):
        raise ResultsError(f"--import: {run} does not say which algorithm and seed it is of; give --agent and --seed")
    variant = origin.variant or config.get("variant")
    for option, value in (("--agent", agent), ("--variant", variant)):
        if value is not None and not (isinstance(value, str) and _PLAIN.fullmatch(value)):
            raise ResultsError(f"{option}: {value!r} cannot be one; give letters, digits, dashes and underscores")
    return read_progress(run / "progress.csv", agent, seed, variant).thinned().write(directory / "curves")
