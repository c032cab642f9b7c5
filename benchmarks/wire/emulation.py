"""A simulator that only takes as long as one, and shows the same observation again and again."""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import msgpack

from wrongturn_protocol import Track, wire
from wrongturn_protocol.observations import observation_space

TRACK = Track.SEGMENTATION
SIZE = wire.layout(TRACK).size
WORK = "WRONGTURN_BENCHMARK_WORK_S"


def command() -> tuple[str, ...]:
    """What is started in a simulator process's place. Its environment is small, so it gets the time as an argument."""
    return (sys.executable, str(Path(__file__).parent), "--simulator", os.environ[WORK])


def seconds() -> float:
    """Of a step."""
    return float(os.environ[WORK])


def work(duration: float) -> None:
    """Keep a core busy: processor time, so that more simulations than cores take as long as they would."""
    end = time.thread_time() + duration
    while time.thread_time() < end:
        pass


def observation() -> dict[str, Any]:
    space = observation_space(TRACK)
    space.seed(0)
    sample: dict[str, Any] = space.sample()
    return sample


class Emulated:
    """In place of an episode."""

    def __init__(self, *_: object, **__: object) -> None:
        self.shown = observation()
        self.duration = seconds()

    def reset(self) -> Any:
        return self.shown

    def repeat(self, actions: list[Any]) -> Any:
        shown = None
        for action in actions:
            shown = self.step(*action)
        return shown

    def step(self, *_: float) -> Any:
        work(self.duration)
        return self.shown, 1.0, False, False


def simulator() -> None:
    """The service's simulator process around it."""
    from wrongturn_service.simulators import worker  # noqa: PLC0415

    worker.Episode = Emulated  # type: ignore[misc, assignment]
    worker.Server.warm_up = lambda _: None  # type: ignore[method-assign]
    worker.main()


class Asked:
    """The same process, asked over its socket by a program that waits: the bare hop."""

    def __init__(self) -> None:
        from wrongturn_service.encoding import Encoding  # noqa: PLC0415

        ours, theirs = socket.socketpair()
        with theirs:
            subprocess.Popen([*command(), str(theirs.fileno()), "60"], pass_fds=[theirs.fileno()])
        self.socket = ours
        self.replies = msgpack.Unpacker(ours.makefile("rb", 0), read_size=1 << 17)
        next(self.replies)
        self.request = msgpack.packb(["step", 0.0, 0.5, 0.0, Encoding.RAW.value])
        ours.sendall(msgpack.packb(["reset", _trial(), TRACK.value, b"", Encoding.RAW.value]))
        next(self.replies)

    def ask(self) -> None:
        self.socket.sendall(self.request)

    def answer(self) -> bytes:
        """The block."""
        block: bytes = next(self.replies)[1]
        return block


def _trial() -> str:
    from wrongturn_networks import draw_trial, load_town  # noqa: PLC0415
    from wrongturn_protocol import FaultKind  # noqa: PLC0415

    town = load_town("junctions")
    return draw_trial(town, next(iter(town.approaches)), FaultKind.NONE, 0).model_dump_json()
