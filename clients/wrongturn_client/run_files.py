"""Lines of the file of a finished evaluation: ``wrongturn_protocol.RunFile``, with a line for each episode."""

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING

from wrongturn_client.evaluation import check_finished
from wrongturn_protocol import EpisodeDetail

if TYPE_CHECKING:
    from wrongturn_client.client import Client


def run_lines(client: "Client", evaluation: str) -> Iterator[bytes]:
    """Yield the lines of an evaluation's run file. Each trajectory is fetched when its line is next.

    Raises:
        NotFinishedError: The evaluation is not finished, or was cancelled.
    """
    detail = client.evaluation(evaluation)
    check_finished(detail, f"wrongturn run --resume {evaluation}")
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


def _line(client: "Client", episode: EpisodeDetail) -> bytes:
    """Return an episode as JSON. The trajectory keeps its bytes, so that its checksum stays right."""
    known = episode.model_dump(mode="json", include={"id", "trial", "outcome"})
    trajectory = client.trajectory(episode.id) if episode.trajectory_sha256 is not None else b""
    return json.dumps(known).encode()[:-1] + b', "trajectory": ' + (trajectory or b"null") + b"}"
