"""The simulator of one environment: in this process, or in one of its own if another environment has this one's.

The program is ``python -m wrongturn_sim.simulator_process SOCKET``; the argument is the file descriptor of a socket.
It answers one request at a time, and ends with the stream. So nothing is left if the process that started it is killed.

Requests and replies:
    | ``("begin", (arguments, keywords) of Simulator.begin)``: the looks of all road users, and the visible ones
    | ``("move", (x, y, yaw))``: the visible road users
    | ``("set_route", (edges,))``: whether SUMO could take it

A refused request is answered by its error.
"""

import contextlib
import os
import socket
import subprocess
import sys
import weakref
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from wrongturn_sim.errors import SimError, SimulatorFailedError, SimulatorInUseError
from wrongturn_sim.simulator import Simulation, Simulator, is_free, release
from wrongturn_sim.traffic.plan import TrafficPlan

_GOODBYE: Final = 5.0
"""Seconds that the process has to end by itself."""


class SimulatorProcess:
    """A process with a simulator. It ends by :meth:`close`, or when this object or this process ends."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            # A session of its own: Ctrl-C is for the program that drives, which ends this process when it wants to.
            self._process = subprocess.Popen(  # noqa: S603 - a program of ours
                [sys.executable, "-m", "wrongturn_sim.simulator_process", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        self._connection = Connection(ours.detach())
        self._maker = os.getpid()
        self._begun = 0
        self.close = weakref.finalize(self, _end, self._process, self._connection)
        """End the process. Safe to call more than once."""

    @property
    def usable(self) -> bool:
        """Whether the process can begin an episode: not after its end, nor in a fork of the process that made it."""
        return not self._connection.closed and self._maker == os.getpid()

    def begin(self, *arguments: Any, **keywords: Any) -> Simulation:
        """Begin an episode; arguments and errors are those of :meth:`wrongturn_sim.simulator.Simulator.begin`."""
        self._begun += 1
        simulation = _DistantSimulation(self, self._begun)
        simulation.appearances, simulation.sightings = self.call("begin", (arguments, keywords))
        return simulation

    def call(self, request: str, arguments: Any) -> Any:
        """Return the reply to a request; raise the SimError that refuses it, or tells that the process is gone."""
        if self._maker != os.getpid():
            raise SimulatorInUseError(
                "the environment was made before this process was forked, and the other process drives its simulation; "
                "reset the environment here"
            )
        try:
            self._connection.send((request, arguments))
            reply = self._connection.recv()
        except (EOFError, OSError) as error:
            self.close()
            raise SimulatorFailedError(
                f"the simulation's process ended (exit status {self._process.returncode}); reset the environment"
            ) from error
        except BaseException:
            self.close()  # an interrupt: the next request must not get this reply
            raise
        if isinstance(reply, SimError):
            raise reply
        return reply

    def drives(self, number: int) -> bool:
        """Return whether an episode, by its number, is the last one that began."""
        return number == self._begun


class _DistantSimulation(Simulation):
    """An episode's simulation in another process."""

    __slots__ = ("_number", "_process")

    def __init__(self, process: SimulatorProcess, number: int) -> None:
        super().__init__()
        self._process = process
        self._number = number

    def move(self, x: float, y: float, yaw: float) -> None:
        if not self._process.drives(self._number):
            raise SimulatorInUseError("the environment drives another episode now; step that one")
        self.sightings = self._process.call("move", (x, y, yaw))

    def set_route(self, edges: tuple[str, ...]) -> bool:
        return self._process.drives(self._number) and bool(self._process.call("set_route", (edges,)))


def _end(process: subprocess.Popen[bytes], connection: Connection) -> None:
    connection.close()
    try:
        process.wait(_GOODBYE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


class EnvironmentSimulator(Simulator):
    """Gives an environment's episodes a simulation without taking another one's.

    The environment takes this process's simulator if it is free, and else a process of its own. The bytes are the same.
    """

    def __init__(self) -> None:
        self._simulation: Simulation | None = None
        self._process: SimulatorProcess | None = None

    def begin(self, net: Path, x: float, y: float, yaw: float, traffic: TrafficPlan, *, seed: int) -> Simulation:
        """Begin an episode, as :meth:`wrongturn_sim.simulator.Simulator.begin`."""
        release(self._simulation)
        if self._process is None and is_free():
            self._simulation = super().begin(net, x, y, yaw, traffic, seed=seed)
            return self._simulation
        if self._process is None or not self._process.usable:
            self._process = SimulatorProcess()
        return self._process.begin(net, x, y, yaw, traffic, seed=seed)

    def close(self) -> None:
        """Free this process's simulator and end the other process. Safe to call more than once."""
        release(self._simulation)
        if self._process is not None:
            self._process.close()


def _serve(connection: Connection) -> None:
    simulator, simulation = Simulator(), Simulation()
    reply: Any
    while True:
        request, arguments = connection.recv()
        try:
            if request == "begin":
                simulation = simulator.begin(*arguments[0], **arguments[1])
                reply = simulation.appearances, simulation.sightings
            elif request == "move":
                simulation.move(*arguments)
                reply = simulation.sightings
            else:
                reply = simulation.set_route(*arguments)
        except SimError as error:
            reply = error
        connection.send(reply)


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as served, contextlib.suppress(EOFError, ConnectionError):
        _serve(served)
