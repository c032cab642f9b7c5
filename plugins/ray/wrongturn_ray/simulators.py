"""Simulators on the nodes of a Ray cluster. They speak with the service over TCP, so no picture goes through Ray."""

import asyncio
import contextlib
from typing import Final

import structlog
from typing_extensions import override

from wrongturn_ray.programs import Node, Program, Programs, Resources
from wrongturn_service.machine import PER_CORE, SIMULATOR_MEMORY
from wrongturn_service.settings import Settings
from wrongturn_service.simulators.interface import SimulatorDiedError, SimulatorStartError
from wrongturn_service.simulators.simulator import Simulator

RESOURCES: Final = Resources(cores=0.15, memory=SIMULATOR_MEMORY)
"""A little less than each of four simulators has of a core, so that a node has room for spare ones and runners."""
_CONNECT_S: Final = 60.0
"""Seconds in which the service has to be connected with Ray before a simulator can start."""
_LAST_WORDS_S: Final = 2.0
"""Seconds in which Ray tells how a program has ended that closed its connection."""
_log = structlog.get_logger("cluster")


def slots(nodes: tuple[Node, ...]) -> int:
    """Return how many simulators may drive on these nodes: four for each core, as far as the memory is enough."""
    return sum(min(int(PER_CORE * node.cores), max(0, node.memory // SIMULATOR_MEMORY)) for node in nodes)


class RaySimulator(Simulator):
    """A simulator on a node; make it by :class:`RayStarter`."""

    def __init__(self, timeout_s: float) -> None:
        super().__init__(timeout_s)
        self.about: str | None = None
        """What it says of itself; None before it has connected."""
        self.program: Program

    @property
    @override
    def name(self) -> str:
        return self.about or "not connected"

    @override
    def memory(self) -> int:
        return 0  # of this machine

    @override
    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        if transport.get_extra_info("sslcontext") is None:
            self._handle = transport.get_extra_info("socket").fileno()

    @override
    async def close(self) -> None:
        # Whether it has ended may become known much later, if its node is lost. Nobody has to wait for that.
        if self.about is None:
            self._end_process()
        else:
            self._kill("the simulator process was ended")

    @override
    def _end_process(self) -> None:
        self._handle = -1  # the descriptor may soon be another connection's
        self.program.end()


class RayStarter:
    """Starts simulators where Ray finds room."""

    def __init__(self, programs: Programs, settings: Settings) -> None:
        self._programs = programs
        self._address = programs.settings.ray_address
        self._start_timeout_s = settings.simulator_start_timeout_s
        self._timeout_s = settings.simulator_timeout_s
        self._turn = asyncio.Condition()
        self._now = 0
        """Starts that are going on."""

    async def start(self) -> Simulator:
        """Start a simulator on a node and wait until it is ready.

        Raises:
            SimulatorStartError: It ended, or was not ready in time; or Ray cannot be reached.
        """
        async with self._turn:
            # A start takes a core for seconds. More starts than the cluster has cores would all be late.
            await self._turn.wait_for(lambda: self._now < max(1, sum(int(one.cores) for one in self._programs.nodes)))
            self._now += 1
        try:
            async with asyncio.timeout(self._start_timeout_s):
                await self._connected()
                # A node with other versions ends a program at once. Ray spreads them, so the next is on another node.
                for _ in self._programs.nodes[1:]:
                    with contextlib.suppress(WrongNodeError):
                        return await self._start()
                return await self._start()
        except TimeoutError:
            why = self._programs.trouble or "the cluster's nodes have no free cores or are too slow"
            raise SimulatorStartError(
                f"no simulator got ready on Ray within {self._start_timeout_s:g} s: {why}"
            ) from None
        finally:
            async with self._turn:
                self._now -= 1
                self._turn.notify_all()

    async def _connected(self) -> None:
        try:
            async with asyncio.timeout(_CONNECT_S):
                await self._programs.connected()
        except TimeoutError:
            why = self._programs.trouble or "the cluster has no nodes"
            raise SimulatorStartError(
                f"WRONGTURN_RAY_ADDRESS: {self._address}: {why}; name the head of a cluster that runs, and if it asks "
                "for a token, set RAY_AUTH_MODE=token and RAY_AUTH_TOKEN or RAY_AUTH_TOKEN_PATH"
            ) from None

    async def _start(self) -> Simulator:
        simulator = RaySimulator(self._timeout_s)
        command = ("-m", "wrongturn_ray.serve", "{service}", str(int(self._timeout_s) + 1))
        variables = {"OMP_NUM_THREADS": "1"}
        async with self._programs.starting(command, lambda: simulator, RESOURCES, variables) as (program, expected):
            simulator.program = program
            try:
                await asyncio.wait((expected.connected, program.ended), return_when=asyncio.FIRST_COMPLETED)
                if expected.connected.done():
                    simulator.about = expected.connected.result()
                    await simulator.ready(self._start_timeout_s)
                    program.ended.add_done_callback(
                        lambda end: _log.info("ended", process=simulator.about, how=str(end.result()))
                    )
                    return simulator
            except SimulatorDiedError:
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(asyncio.shield(program.ended), _LAST_WORDS_S)
            except BaseException:
                await simulator.close()
                raise
            program.end()
            end = program.ended.result() if program.ended.done() else None
            if end is not None and end.other_versions:
                _log.warning("wrong node", why=end.why)
                raise WrongNodeError(str(end))
            raise SimulatorStartError(f"a simulator on Ray did not get ready: {end or 'it closed its connection'}")


class WrongNodeError(SimulatorStartError):
    """The node has other versions than the service."""
