"""Where a replay's episode comes from: a service, the file of ``run --json``, or a file with a trajectory."""

import json
from pathlib import Path
from typing import Final, NamedTuple

from wrongturn_client.client import Client
from wrongturn_client.errors import ReplayError
from wrongturn_protocol import Outcome
from wrongturn_protocol.run_file import UNREADABLE, DrivenEpisode, RunFile, read_unpacked, reason_of

_REMEDY: Final = "give the file of 'run --json' or a trajectory"
_NAMED: Final = 5
"""Episodes that an error names."""


class Replayed(NamedTuple):
    """What a replay needs of an episode."""

    trajectory: bytes
    """JSON."""
    outcome: Outcome | None


def replayed_from(source: str, episode: str | None = None, url: str | None = None) -> Replayed:
    """Return the episode that a file, or the service at a URL, has.

    The source is a file or an episode's id. ``episode`` chooses from the file of ``run --json`` by an id or a trial's.

    Raises:
        ReplayError: The file cannot be read, or it has no such episode.
        RunFormatError: The file has episodes but is no file of ``run --json``.
        WrongturnError: The service does not answer, or refuses.
    """
    file = Path(source)
    if file.exists():
        return _from_file(file, episode)
    if file.suffix or len(file.parts) > 1:
        raise ReplayError(f"{source}: there is no such file; give the file of 'run --json', or an episode's id")
    if episode is not None:
        raise ReplayError(
            "--episode: chooses from the file of 'run --json', but an episode's id was given; leave it out"
        )
    with Client(url, patience=0) as client:
        return Replayed(client.trajectory(source), client.episode(source).outcome)


def _from_file(file: Path, episode: str | None) -> Replayed:
    content = _read(file)
    try:
        message = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ReplayError(f"{file}: is not JSON ({error}); {_REMEDY}") from error
    if isinstance(message, dict) and "episodes" in message:
        found = _chosen(file, RunFile.from_json(content, str(file)), episode)
        if found.trajectory is None:
            raise ReplayError(f"{file}: episode {found.id} ended without a trajectory; name another one by --episode")
        return Replayed(json.dumps(found.trajectory).encode(), found.outcome)
    if not isinstance(message, dict) or "town_sha256" not in message:
        raise ReplayError(f"{file}: is neither a file of 'run --json' nor a trajectory; {_REMEDY}")
    if episode is not None:
        raise ReplayError(f"--episode: {file} is a single trajectory; leave it out")
    return Replayed(content, None)


def _read(file: Path) -> bytes:
    try:
        return read_unpacked(file)
    except UNREADABLE as error:
        raise ReplayError(f"{file}: cannot be read ({reason_of(error)}); {_REMEDY}") from error


def _chosen(file: Path, run: RunFile, wanted: str | None) -> DrivenEpisode:
    episodes = run.episodes
    chosen = [one for one in episodes if wanted is None or wanted in {one.id, one.trial}]
    if len(chosen) == 1:
        return chosen[0]
    names = ", ".join(one.trial or one.id for one in episodes[:_NAMED]) + (", ..." if len(episodes) > _NAMED else "")
    if not chosen:
        raise ReplayError(f"--episode: {file.name} has no episode {wanted!r}; it has {names or 'none'}")
    raise ReplayError(
        f"--episode: {file.name} has {len(chosen)} such episodes; name one by its id or its trial's: {names}"
    )
