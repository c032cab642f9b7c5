"""The program of a simulator process: ``python -m wrongturn_service.simulators SOCKET SECONDS MEMORY``.

The arguments are the file descriptor of a socket to the service, whole seconds after which a hanging request ends the
process, and the file descriptor of the shared memory. The process answers one request at a time. It ends with the
stream, so no simulator outlives its service. The time limit is an alarm, which works even while SUMO does not return.

Requests:
    | ``["reset", trial, track, actions, encoding, place]``
    | ``["step", steer, throttle, brake, encoding, place]``
    | ``["view"]``
    | ``["abort"]``
    | ``["prepare", town]``

Replies:
    | ``[OK, observation, reward, terminated, truncated, end]`` to a reset or a step; ``end`` is None or
      ``[outcome, steps, trajectory, SHA-256 of it, SHA-256 of the actions]``
    | ``[OK, pixmap]`` to a view
    | ``[OK, end]`` to an abort, ``[OK]`` to prepare
    | ``[REFUSED, name, message]``
    | ``[FAILED, name, message]``

An observation as raw arrays is written to its place in the shared memory, and the reply has its number of bytes.
"""

import contextlib
import gc
import hashlib
import math
import signal
import socket
import sys
from pathlib import Path
from typing import Any, Final

from wrongturn_networks import Town, draw_journey, draw_trial, load_town
from wrongturn_protocol import FaultKind, Outcome, Task, Track, Trial, observations
from wrongturn_protocol.pixmap import to_pixmap
from wrongturn_service.encoding import Encoding, encoded
from wrongturn_service.simulators import frames
from wrongturn_service.simulators.actions import ACTION
from wrongturn_service.simulators.interface import replay_s
from wrongturn_service.simulators.shared_memory import SharedMemoryWriter
from wrongturn_sim import Episode

REFUSALS: Final = frozenset({"FaultNotApplicableError", "TrafficTooDenseError"})
"""Errors that are the caller's mistake and leave the simulator usable."""


class Server:
    """Answers requests with the episode of this process."""

    def __init__(self, writer: SharedMemoryWriter) -> None:
        self._writer = writer
        self._episode: Episode | None = None
        self._track = Track.STATE

    def answer(self, request: list[Any]) -> list[Any]:
        """Return the reply to a request."""
        operation, *arguments = request
        if operation == "step":
            return self._step(*arguments)
        if operation == "reset":
            return self._reset(*arguments)
        if operation == "prepare":
            self._drive_a_little(load_town(*arguments))
            return [frames.OK]
        episode = self._driven()
        if operation == "view":
            return [frames.OK, to_pixmap(episode.view())]
        return [frames.OK, _end(episode, episode.abort())]

    def warm_up(self) -> None:
        """Drive a little, so that the first agent does not wait for what is compiled or loaded late."""
        self._drive_a_little(load_town("junctions"))

    def _drive_a_little(self, town: Town) -> None:
        junction = draw_trial(town, next(iter(town.approaches)), FaultKind.NONE, 0)
        journey = draw_journey(town, Task.NAVIGATION, 0)  # judged by arithmetic of its own
        for trial, track in ((junction, Track.PRIVILEGED), (junction, Track.SEGMENTATION), (journey, Track.STATE)):
            self._reset(trial.model_dump_json(), track, ACTION.pack(0.0, 0.5, 0.0) * 3, Encoding.RAW, 0)
            self._driven().abort()

    def _driven(self) -> Episode:
        if self._episode is None:
            raise RuntimeError("no episode: reset comes first")
        return self._episode

    def _reset(self, trial: str, track: str, actions: bytes, encoding: str, place: int) -> list[Any]:
        self._track = Track(track)
        self._episode = episode = Episode(Trial.model_validate_json(trial), self._track)
        observation = episode.reset()
        reward, terminated, truncated = 0.0, False, False
        repeated = episode.repeat(list(ACTION.iter_unpack(actions)))
        if repeated is not None:
            observation, reward, terminated, truncated = repeated
        return self._reply(observation, reward, terminated, truncated, encoding, place)

    def _step(self, steer: float, throttle: float, brake: float, encoding: str, place: int) -> list[Any]:
        observation, reward, terminated, truncated = self._driven().step(steer, throttle, brake)
        return self._reply(observation, reward, terminated, truncated, encoding, place)

    def _reply(
        self,
        observation: observations.Observation,
        reward: float,
        terminated: bool,
        truncated: bool,
        encoding: str,
        place: int,
    ) -> list[Any]:
        shown: bytes | int
        if encoding == Encoding.RAW:
            shown = len(self._writer.write(observation, self._track, place))
        else:
            shown = encoded(observation, self._track, Encoding(encoding))
        end = None
        if terminated or truncated:
            episode = self._driven()
            assert episode.outcome is not None
            end = _end(episode, episode.outcome)
        return [frames.OK, shown, float(reward), bool(terminated), bool(truncated), end]


def _end(episode: Episode, outcome: Outcome) -> list[Any]:
    trajectory = episode.trajectory.to_json()
    sha256 = hashlib.sha256(trajectory).hexdigest()
    return [outcome.model_dump_json(), episode.steps, trajectory, sha256, episode.actions_sha256]


def serve(connection: socket.socket, limit_s: int, writer: SharedMemoryWriter) -> None:
    """Answer requests until the other side closes the stream.

    Args:
        connection: a blocking stream socket.
        limit_s: whole seconds after which a request ends the process; a replay gets more.
        writer: where observations are written.
    """
    server = Server(writer)
    server.warm_up()
    # These objects stay. A full garbage collection of them would make a step wait.
    gc.collect()
    gc.freeze()
    gc.enable()
    connection.sendall(frames.pack([frames.OK]))
    requests = frames.Receiver(connection)
    while True:
        try:
            request = requests.receive()
        except (EOFError, ConnectionError):
            return
        try:
            signal.alarm(limit_s + (math.ceil(replay_s(request[3])) if request[0] == "reset" else 0))
            reply = server.answer(request)
        except Exception as error:
            kind = frames.REFUSED if type(error).__name__ in REFUSALS else frames.FAILED
            reply = [kind, type(error).__name__, str(error)]
        signal.alarm(0)
        connection.sendall(frames.pack(reply))


def main() -> None:
    """Serve the socket and the memory that the command line names."""
    # Ctrl-C goes to the whole group of processes; the service decides when its simulators end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    # If memory runs out, end a simulator rather than the service, which replaces it.
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500", "ascii")
    # If the service was killed, nobody is left to answer.
    with socket.socket(fileno=int(sys.argv[1])) as connection, contextlib.suppress(ConnectionError):
        serve(connection, int(sys.argv[2]), SharedMemoryWriter(int(sys.argv[3])))
