"""What runs in a simulator process: ``python -m wrongturn_service.simulators.worker FD SECONDS SCREEN``.

It serves one socket, whose other end the service has: one request at a time, one reply each. At the end of the stream
it ends, so no simulator outlives its service; a call that takes too long ends it too, by an alarm that works even
while SUMO does not give Python the word.

Requests: ``["reset", trial, track, actions, encoding, place]``, ``["step", steer, throttle, brake, encoding, place]``,
``["abort"]``, ``["prepare", town]``, ``["lend", number, place, episode, seq, practice]`` with a connection's file
descriptor, and ``["recall"]``, which ends a loan and has no reply.
Replies: ``[OK, observation, reward, terminated, truncated, final]``, ``[REFUSED, name, message]``,
``[FAILED, name, message]``; ``final`` is None or ``[outcome, steps, trajectory, its sha256, the actions' sha256]``.
A loan's is ``[OK, …]`` with what :meth:`Handover.drive` hands back.
An observation as raw arrays is written to the place on the screen, and the reply has its number of bytes.
"""

import contextlib
import gc
import hashlib
import math
import signal
import socket
import sys
from typing import Any, Final

from wrongturn_networks import Town, draw_journey, draw_trial, load_town
from wrongturn_protocol import FaultKind, Outcome, Task, Track, Trial, observations
from wrongturn_service.encoding import Encoding, encoded
from wrongturn_service.simulators import frames
from wrongturn_service.simulators.action_log import ACTION
from wrongturn_service.simulators.handover import Handover, Loan
from wrongturn_service.simulators.interface import LOAN_S, SENDING_S, replay_s
from wrongturn_service.simulators.shared_memory import SharedMemoryWriter
from wrongturn_sim import Episode

REFUSALS: Final = frozenset({"FaultNotApplicableError", "TrafficTooDenseError"})
"""Errors that are the caller's mistake and leave the simulator sound."""


class Server:
    """The episode of this process."""

    def __init__(self, writer: SharedMemoryWriter) -> None:
        self._writer = writer
        self._episode: Episode | None = None
        self._track = Track.STATE

    def answer(self, request: list[Any]) -> list[Any]:
        """The reply to one request."""
        operation, *arguments = request
        if operation == "step":
            return self._step(*arguments)
        if operation == "reset":
            return self._reset(*arguments)
        if operation == "prepare":
            self._drive_a_little(load_town(*arguments))
            return [frames.OK]
        episode = self._driven()
        return [frames.OK, _final(episode, episode.abort())]

    def warm_up(self) -> None:
        """Drive a little, so that what is compiled or loaded late is there before the first agent comes."""
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
        return self._frame(observation, reward, terminated, truncated, encoding, place)

    def _step(self, steer: float, throttle: float, brake: float, encoding: str, place: int) -> list[Any]:
        observation, reward, terminated, truncated = self._driven().step(steer, throttle, brake)
        return self._frame(observation, reward, terminated, truncated, encoding, place)

    def _frame(
        self,
        observation: observations.Observation,
        reward: float,
        terminated: bool,
        truncated: bool,
        encoding: str,
        place: int | None,
    ) -> list[Any]:
        shown: bytes | int
        if encoding == Encoding.RAW and place is not None:
            shown = len(self._writer.write(observation, self._track, place))
        else:
            shown = encoded(observation, self._track, Encoding(encoding))
        final = None
        if terminated or truncated:
            episode = self._driven()
            assert episode.outcome is not None
            final = _final(episode, episode.outcome)
        return [
            frames.OK,
            shown,
            float(reward),
            bool(terminated),
            bool(truncated),
            final,
        ]

    def lend(
        self, lent: Handover, handle: int, number: int, place: int, episode: str, seq: int, practice: bool
    ) -> list[Any]:
        """The reply to a loan."""
        self._writer.action_log.open(number)
        with socket.socket(fileno=handle) as connection:
            loan = Loan(connection, episode, seq, place, practice)
            return [frames.OK, *lent.drive(loan, self._driven(), self._track, self._finished)]

    def _finished(
        self, observation: observations.Observation, reward: float, terminated: bool, truncated: bool
    ) -> list[Any]:
        return self._frame(observation, reward, terminated, truncated, Encoding.RAW, None)


def _final(episode: Episode, outcome: Outcome) -> list[Any]:
    trajectory = episode.trajectory.to_json()
    sha256 = hashlib.sha256(trajectory).hexdigest()
    return [outcome.model_dump_json(), episode.steps, trajectory, sha256, episode.actions_sha256]


def serve(connection: socket.socket, limit_s: int, writer: SharedMemoryWriter) -> None:
    """Answer requests until the other side is gone.

    Args:
        connection: a blocking stream socket.
        limit_s: whole seconds after which a request ends the process; those for a replay come on top.
        writer: where observations are written.
    """
    server = Server(writer)
    server.warm_up()
    # What is there by now stays: to look through it for garbage time and again would be a pause of its own.
    gc.collect()
    gc.freeze()
    connection.sendall(frames.pack([frames.OK]))
    requests = frames.Receiver(connection)
    lent = Handover(connection, requests, writer)
    while True:
        try:
            request = requests.receive()
        except (EOFError, ConnectionError):
            return
        operation, *arguments = request
        if operation == "recall":
            continue  # what it would end has just ended
        signal.alarm(limit_s + math.ceil(_more_s(request)))
        try:
            if operation == "lend":
                reply = server.lend(lent, requests.take_handle(), *arguments)
            else:
                reply = server.answer(request)
        except Exception as error:
            kind = frames.REFUSED if type(error).__name__ in REFUSALS else frames.FAILED
            reply = [kind, type(error).__name__, str(error)]
        signal.alarm(0)
        connection.sendall(frames.pack(reply))


def _more_s(request: list[Any]) -> float:
    """Seconds that a request may take on top of those for any."""
    if request[0] == "reset":
        return replay_s(request[3])
    return LOAN_S + SENDING_S if request[0] == "lend" else 0.0


def main() -> None:
    """Serve the socket whose file descriptor the first argument names, with the screen that the third does."""
    # Ctrl-C goes to the whole group of processes; the service decides when its simulators end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    # Where the service was killed meanwhile, nobody is left to answer.
    with socket.socket(fileno=int(sys.argv[1])) as connection, contextlib.suppress(ConnectionError):
        serve(connection, int(sys.argv[2]), SharedMemoryWriter(int(sys.argv[3])))


if __name__ == "__main__":
    main()
