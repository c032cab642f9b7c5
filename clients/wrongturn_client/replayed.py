"""Where a replay's episode comes from: a service, the file of ``run --json``, or a file with a trajectory."""

import json
from pathlib import Path
from typing import Final, NamedTuple

from wrongturn_client.client import Client
from wrongturn_client.errors import ReplayError
from wrongturn_protocol import Fault, FaultKind, Outcome
from wrongturn_protocol.episodes import trial_id
from wrongturn_protocol.run_file import UNREADABLE, RunFile, read_unpacked, reason_of

_REMEDY: Final = "give the file of 'run --json' or a trajectory"
_NAMED: Final = 5
"""Episodes that an error names."""


class Replayed(NamedTuple):
    """What a replay needs of an episode."""

    trajectory: bytes
    """JSON."""
    outcome: Outcome | None
    agent: str = ""
    """The name of who drove, where the source says it."""
    twin: tuple[bytes, Outcome | None] | None = None
    """The same of the trial's twin, if it was asked for."""


def replayed_from(source: str, episode: str | None = None, url: str | None = None, *, twin: bool = False) -> Replayed:
    """Return the episode that a file, or the service at a URL, has.

    The source is a file or an episode's id. ``episode`` chooses from the file of ``run --json`` by an id or a trial's.
    ``twin`` asks for the episode of its twin too.

    Raises:
        ReplayError: The file cannot be read, or it has no such episode, or no twin of it.
        RunFormatError: The file has episodes but is no file of ``run --json``.
        WrongturnError: The service does not answer, or refuses.
    """
    file = Path(source)
    if file.exists():
        return _from_file(file, episode, twin=twin)
    if file.suffix or len(file.parts) > 1:
        raise ReplayError(f"{source}: there is no such file; give the file of 'run --json', or an episode's id")
    if episode is not None:
        raise ReplayError(
            "--episode: chooses from the file of 'run --json', but an episode's id was given; leave it out"
        )
    with Client(url, patience=0) as client:
        return _from_service(client, source, twin=twin)


def _from_service(client: Client, source: str, *, twin: bool) -> Replayed:
    detail = client.episode(source)
    found = Replayed(client.trajectory(source), detail.outcome)
    if detail.evaluation is not None:
        found = found._replace(agent=client.agent(client.evaluation(detail.evaluation).agent).name)
    if twin:
        wanted = _twin_of(found.trajectory)
        others = client.finished_episodes(detail.evaluation) if detail.evaluation is not None else ()
        other = next((one for one in others if one.trial == wanted), None)
        if other is None:
            raise ReplayError(f"--twin: the evaluation of episode {source} has no trial {wanted}; leave it out")
        found = found._replace(twin=(client.trajectory(other.id), other.outcome))
    return found


def _twin_of(trajectory: bytes) -> str:
    """Return the id of the twin of a trajectory's trial; raise ReplayError if it has none."""
    trial = json.loads(trajectory)
    if trial["fault"]["kind"] == FaultKind.NONE:
        raise ReplayError(f"--twin: {trial['trial']} has no twin: only trials with a fault have one; leave it out")
    return trial_id(trial["town"], trial["approach"], Fault(kind=FaultKind.NONE), trial["seed"])


def _from_file(file: Path, episode: str | None, *, twin: bool) -> Replayed:
    content = _read(file)
    try:
        message = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ReplayError(f"{file}: is not JSON ({error}); {_REMEDY}") from error
    if isinstance(message, dict) and "episodes" in message:
        run = RunFile.from_json(content, str(file))
        found = _chosen(file, run, episode)
        if twin:
            found = found._replace(twin=_chosen(file, run, _twin_of(found.trajectory))[:2])
        return found
    if not isinstance(message, dict) or "town_sha256" not in message:
        raise ReplayError(f"{file}: is neither a file of 'run --json' nor a trajectory; {_REMEDY}")
    if episode is not None:
        raise ReplayError(f"--episode: {file} is a single trajectory; leave it out")
    if twin:
        raise ReplayError(f"--twin: {file} is a single trajectory; give the file of 'run --json', or an episode's id")
    return Replayed(content, None)


def _read(file: Path) -> bytes:
    try:
        return read_unpacked(file)
    except UNREADABLE as error:
        raise ReplayError(f"{file}: cannot be read ({reason_of(error)}); {_REMEDY}") from error


def _chosen(file: Path, run: RunFile, wanted: str | None) -> Replayed:
    episodes = run.episodes
    chosen = [one for one in episodes if wanted is None or wanted in {one.id, one.trial}]
    if len(chosen) == 1:
        if chosen[0].trajectory is None:
            raise ReplayError(f"{file}: episode {chosen[0].id} ended without a trajectory; name another by --episode")
        return Replayed(json.dumps(chosen[0].trajectory).encode(), chosen[0].outcome, run.driver.name)
    names = ", ".join(one.trial or one.id for one in episodes[:_NAMED]) + (", ..." if len(episodes) > _NAMED else "")
    if not chosen:
        raise ReplayError(f"--episode: {file.name} has no episode {wanted!r}; it has {names or 'none'}")
    raise ReplayError(
        f"--episode: {file.name} has {len(chosen)} such episodes; name one by its id or its trial's: {names}"
    )
