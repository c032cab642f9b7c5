"""Writes the file of a finished evaluation: ``wrongturn_protocol.RunFile``, with a line for each episode."""

import contextlib
import gzip
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from wrongturn_client.errors import NotFinishedError
from wrongturn_protocol import EpisodeDetail, EvaluationDetail, EvaluationState

if TYPE_CHECKING:
    from wrongturn_client.client import Client


def run_lines(client: "Client", evaluation: str) -> Iterator[bytes]:
    """Yield the lines of an evaluation's run file. Each trajectory is fetched when its line is next.

    Raises:
        NotFinishedError: The evaluation is not finished, or was cancelled.
    """
    detail = client.evaluation(evaluation)
    _check_finished(detail)
    head = {
        **detail.model_dump(mode="json"),
        "suite_sha256": client.suite(detail.suite).sha256,
        "driver": client.agent(detail.agent).model_dump(mode="json"),
    }
    yield json.dumps(head).encode()[:-1] + b', "episodes": [\n'
    between = b""
    for episode in client.finished_episodes(evaluation):
        yield between + _line(client, episode)
        between = b",\n"
    yield b"\n]}\n"


def write_run(lines: Iterable[bytes], file: Path) -> None:
    """Write a run file, all at once or not at all; compressed if its name ends in ``.gz``.

    The same lines give the same bytes.

    Raises:
        OSError: The file cannot be written.
    """
    if file.exists() and not file.is_file():  # a pipe or a device, which nothing can replace
        with file.open("wb") as out:
            out.writelines(lines)
        return
    target = file.resolve()  # a link stays a link
    new = target.with_name(f".{target.name}.new")
    try:
        with new.open("wb") as out:
            if target.suffix == ".gz":
                with gzip.GzipFile(filename="", mode="wb", fileobj=out, mtime=0) as packed:
                    packed.writelines(lines)
            else:
                out.writelines(lines)
        new.replace(target)
    except BaseException:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)
        raise


def _check_finished(evaluation: EvaluationDetail) -> None:
    if evaluation.state is EvaluationState.CANCELLED:
        raise NotFinishedError(f"evaluation: {evaluation.id} was cancelled, so it has no episodes to keep")
    if evaluation.state is not EvaluationState.FINISHED:
        raise NotFinishedError(
            f"evaluation: {evaluation.id} is not finished ({evaluation.finished} of {evaluation.trials} episodes); "
            f"finish it first: wrongturn run --resume {evaluation.id}"
        )


def _line(client: "Client", episode: EpisodeDetail) -> bytes:
    """Return an episode as JSON. The trajectory keeps its bytes, so that its checksum stays right."""
    known = episode.model_dump(mode="json", include={"id", "trial", "outcome"})
    trajectory = client.trajectory(episode.id) if episode.trajectory_sha256 is not None else b""
    return json.dumps(known).encode()[:-1] + b', "trajectory": ' + (trajectory or b"null") + b"}"
