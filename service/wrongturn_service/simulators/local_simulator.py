"""Simulators as processes of this machine."""

import asyncio
import contextlib
import re
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from typing_extensions import override

from wrongturn_service.child_environment import child_environment
from wrongturn_service.machine import Machine
from wrongturn_service.settings import Settings
from wrongturn_service.simulators.interface import SimulatorDiedError, SimulatorStartError
from wrongturn_service.simulators.simulator import Simulator

COMMAND = (sys.executable, "-m", "wrongturn_service.simulators")
"""Command of a simulator process; :meth:`LocalStarter.start` adds its arguments."""
_PASSED_ON: Final = (
    "WRONGTURN_HOME",
    "WRONGTURN_TOWNS",
    "WRONGTURN_SUITES",
    "WRONGTURN_KERNELS",
    "SUMO_HOME",
    "NUMBA_CACHE_DIR",
    "NUMBA_CPU_NAME",
    "NUMBA_CPU_FEATURES",
    "NUMBA_DISABLE_JIT",
    "NUMBA_NUM_THREADS",
)
"""Variables that a process gets beside every child's: where towns and compiled code are, and for which processor."""
_SHARE: Final = re.compile(rb"^Pss:\s+(\d+) kB", re.MULTILINE)
_RESIDENT: Final = re.compile(rb"^VmRSS:\s+(\d+) kB", re.MULTILINE)


class LocalSimulator(Simulator):
    """A simulator at the other end of a socket pair; make it by :class:`LocalStarter`."""

    def __init__(self, process: subprocess.Popen[bytes], stream: socket.socket, timeout_s: float) -> None:
        super().__init__(timeout_s)
        self.process = process
        self._handle = stream.fileno()

    @property
    @override
    def name(self) -> str:
        status = self.process.returncode
        return f"pid {self.process.pid}" + ("" if status is None else f", ended with status {status}")

    @override
    def memory(self) -> int:
        """Return the process's own memory and its part of what it shares, bytes; 0 if it has ended.

        Where the kernel does not tell the parts, the result is the process's resident memory.
        """
        for name, pattern in (("smaps_rollup", _SHARE), ("status", _RESIDENT)):
            with contextlib.suppress(OSError):
                match = pattern.search(Path(f"/proc/{self.process.pid}/{name}").read_bytes())
                if match:
                    return 1024 * int(match[1])
        return 0

    @override
    async def close(self) -> None:
        self._kill("the simulator process was ended")
        await asyncio.to_thread(self.process.wait)

    @override
    def _end_process(self) -> None:
        self.process.kill()


class LocalStarter:
    """Starts simulators as processes of this machine."""

    def __init__(
        self,
        environment: Mapping[str, str] | None = None,
        *,
        start_timeout_s: float,
        timeout_s: float,
        command: Sequence[str] = COMMAND,
    ) -> None:
        """A start may take ``start_timeout_s``. A call to a simulator counts as hung after ``timeout_s``.

        The socket's descriptor and whole seconds of a call are added to the ``command``, and the ``environment`` to the
        few variables that a process gets of this one's.
        """
        self._environment = {"OMP_NUM_THREADS": "1", **(environment or {})}
        self._start_timeout_s = start_timeout_s
        self._timeout_s = timeout_s
        self._command = tuple(command)
        # A start takes a core for seconds. More starts than cores would all be late.
        self._at_once = asyncio.Semaphore(Machine().processors())

    @classmethod
    def of(cls, settings: Settings) -> "LocalStarter":
        """Return the starter that the settings ask for."""
        return cls(
            {"WRONGTURN_HOME": str(settings.home)},
            start_timeout_s=settings.simulator_start_timeout_s,
            timeout_s=settings.simulator_timeout_s,
        )

    async def start(self) -> Simulator:
        """Start a process and wait until it is ready.

        Raises:
            SimulatorStartError: It ended, or was not ready in time.
        """
        async with self._at_once:
            return await self._start()

    async def _start(self) -> LocalSimulator:
        ours, theirs = socket.socketpair()
        with theirs:
            handle = theirs.fileno()

            def spawn() -> subprocess.Popen[bytes]:
                return subprocess.Popen(  # noqa: S603 - our own program
                    [*self._command, str(handle), str(int(self._timeout_s) + 1)],
                    pass_fds=[handle],
                    stdin=subprocess.DEVNULL,
                    # What SUMO prints must not mix with what the service prints on stdout.
                    stdout=2,
                    env={**child_environment(*_PASSED_ON), **self._environment},
                )

            try:
                process = await asyncio.to_thread(spawn)
            except OSError as error:
                ours.close()
                raise SimulatorStartError(f"no simulator process could be started: {error}") from error
        ours.setblocking(False)
        simulator = LocalSimulator(process, ours, self._timeout_s)
        await asyncio.get_running_loop().create_unix_connection(lambda: simulator, sock=ours)
        try:
            await simulator.ready(self._start_timeout_s)
        except SimulatorDiedError as error:
            await simulator.close()
            status = process.returncode
            raise SimulatorStartError(
                f"a simulator process did not get ready ({error}, status {status}); what it said is on stderr, "
                "and 'wrongturn doctor' checks the installation"
            ) from error
        except BaseException:
            await simulator.close()
            raise
        return simulator
