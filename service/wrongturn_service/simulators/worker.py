"""The program of a simulator process: ``python -m wrongturn_service.simulators SOCKET SECONDS``.

The arguments are the file descriptor of a socket to the service, and whole seconds after which a hanging request ends
the process. The process answers one request at a time. It ends with the stream, so no simulator outlives its service.
The time limit is an alarm, which works even while SUMO does not return.

Requests and replies are values of msgpack, one after the other. Requests:
    | ``["reset", trial, track or JSON of a rig, actions, encoding]``
    | ``["step", steer, throttle, brake, encoding]``
    | ``["view"]``
    | ``["abort"]``
    | ``["prepare", town, scenery]``

Replies:
    | ``[OK, observation, reward, terminated, truncated, end]`` to a reset or a step; ``end`` is None or the values of
      an abort's reply
    | ``[OK, pixmap]`` to a view
    | ``[OK, outcome, steps, trajectory, SHA-256 of it, SHA-256 of the actions]`` to an abort, ``[OK]`` to prepare
    | ``[REFUSED, name, message]``
    | ``[FAILED, name, message]``
"""

import contextlib
import gc
import hashlib
import math
import signal
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import msgpack

from wrongturn_networks import Town, draw_journey, draw_trial, load_town
from wrongturn_protocol import FaultKind, Outcome, Rig, Sight, Task, Track, Traffic, Trial
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.pixmap import to_pixmap
from wrongturn_protocol.rigs import sight_from
from wrongturn_protocol.wire import Block, layout
from wrongturn_service.encoding import Encoding, encoded
from wrongturn_service.simulators.interface import ACTION, FAILED, OK, REFUSED, replay_s
from wrongturn_sim import Episode

REFUSALS: Final = frozenset({"FaultNotApplicableError", "TrafficTooDenseError"})
"""Errors that are the caller's mistake and leave the simulator usable."""
_READ_SIZE: Final = 1 << 14


class Server:
    """Answers requests with the episode of this process."""

    def __init__(self) -> None:
        self._episode: Episode | None = None
        self._sight: Sight = Track.STATE
        self._memory = bytearray()
        self._block: Block | None = None

    def answer(self, request: list[Any]) -> list[Any]:
        """Return the values of the reply to a request."""
        operation, *arguments = request
        if operation == "step":
            *action, encoding = arguments
            return self._reply(self._driven().step(*action), encoding)
        if operation == "reset":
            return self._reset(*arguments)
        if operation == "prepare":
            self._drive_a_little(load_town(*arguments))
            return []
        episode = self._driven()
        return [to_pixmap(episode.view())] if operation == "view" else _end(episode, episode.abort())

    def warm_up(self) -> None:
        """Drive a little, so that the first agent does not wait for what is compiled or loaded late."""
        self._drive_a_little(load_town("junctions"))

    def _drive_a_little(self, town: Town) -> None:
        junction = draw_trial(town, next(iter(town.approaches)), FaultKind.NONE, 0)
        # A journey is judged by arithmetic of its own; with another car in town it needs SUMO.
        journey = draw_journey(town, Task.NAVIGATION, 0, traffic=Traffic(vehicles=1))
        for trial, track in ((junction, Track.PRIVILEGED), (junction, Track.SEGMENTATION), (journey, Track.STATE)):
            self._reset(trial.model_dump_json(), track, ACTION.pack(0.0, 0.5, 0.0) * 3, Encoding.RAW)
            self._driven().abort()

    def _driven(self) -> Episode:
        if self._episode is None:
            raise RuntimeError("no episode: reset comes first")
        return self._episode

    def _reset(self, trial: str, sight: str, actions: bytes, encoding: str) -> list[Any]:
        self._sight = sight_from(sight)
        self._episode = episode = Episode(Trial.model_validate_json(trial), self._sight, mirrored=True, compressed=True)
        begun = episode.reset(), 0.0, False, False
        return self._reply(episode.repeat(list(ACTION.iter_unpack(actions))) or begun, encoding)

    def _reply(self, result: tuple[Observation, float, bool, bool], encoding: str) -> list[Any]:
        observation, reward, terminated, truncated = result
        end = None
        if terminated or truncated:
            episode = self._driven()
            assert episode.outcome is not None
            end = _end(episode, episode.outcome)
        return [self._shown(observation, encoding), float(reward), bool(terminated), bool(truncated), end]

    def _shown(self, observation: Observation, encoding: str) -> bytes | bytearray:
        """Return an encoded observation. It may change with the next one."""
        if encoding != Encoding.RAW or isinstance(self._sight, Rig):
            return encoded(observation, self._sight, Encoding(encoding))
        if self._block is None or self._block.layout.track is not self._sight:
            self._memory = bytearray(layout(self._sight).size)
            self._block = Block(self._memory, self._sight)
        self._block.write(observation)
        return self._memory


def _end(episode: Episode, outcome: Outcome) -> list[Any]:
    trajectory = episode.trajectory.to_json()
    sha256 = hashlib.sha256(trajectory).hexdigest()
    return [outcome.model_dump_json(), episode.steps, trajectory, sha256, episode.actions_sha256]


def serve(connection: socket.socket, limit_s: int) -> None:
    """Answer requests until the other side closes the stream.

    A request that takes longer than ``limit_s`` whole seconds ends the process; a replay gets more.
    """
    server = Server()
    server.warm_up()
    # These objects stay. A full garbage collection of them would make a step wait.
    gc.collect()
    gc.freeze()
    gc.enable()
    connection.sendall(msgpack.packb([OK]))
    for request in msgpack.Unpacker(connection.makefile("rb", 0), read_size=_READ_SIZE):
        try:
            signal.alarm(limit_s + (math.ceil(replay_s(request[3])) if request[0] == "reset" else 0))
            reply = [OK, *server.answer(request)]
        except Exception as error:
            kind = REFUSED if type(error).__name__ in REFUSALS else FAILED
            reply = [kind, type(error).__name__, str(error)]
        signal.alarm(0)
        connection.sendall(msgpack.packb(reply))


def main(connect: Callable[[str], socket.socket] = lambda handle: socket.socket(fileno=int(handle))) -> None:
    """Serve the socket that the command line names; ``connect`` makes it of the first argument."""
    # Ctrl-C goes to the whole group of processes; the service decides when its simulators end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    # If memory runs out, end a simulator rather than the service, which replaces it.
    with contextlib.suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text("500", "ascii")
    where, limit_s = sys.argv[1:]
    # If the service was killed or its machine has vanished, nobody is left to answer.
    with connect(where) as connection, contextlib.suppress(ConnectionError, TimeoutError):
        serve(connection, int(limit_s))
