"""The check of simulators for ``wrongturn doctor``."""

import asyncio
import time

from wrongturn_service.machine import Machine
from wrongturn_service.settings import Settings
from wrongturn_service.simulators.local_pool import COMMAND
from wrongturn_service.simulators.local_simulator import LocalSimulator

_MIB = 2**20
_COMPILED_S = 10.0
"""Seconds after which a start is taken for a first one."""


class TooLittleMemoryError(Exception):
    """The simulators that are set do not fit into this machine's memory."""


def examine(settings: Settings) -> str:
    """Start one simulator, and return how long its start took and how much memory it has.

    Raises:
        SimulatorStartError: it does not start.
        TooLittleMemoryError: the number of simulators that is set does not fit.
    """
    available = Machine().available_memory()
    seconds, memory = asyncio.run(_start(settings))
    if seconds > _COMPILED_S:  # it has compiled the kernels, which takes several times the memory
        seconds, memory = asyncio.run(_start(settings))
    count = settings.simulators + settings.spare_simulators
    report = (
        f"one was ready after {seconds:.1f} s and has {memory / _MIB:.0f} MiB; {count} of them, with the spare, "
        f"{count * memory / _MIB:.0f} MiB of {available / _MIB:.0f} that are free"
    )
    if available and count * memory > available:
        raise TooLittleMemoryError(report)
    return report


async def _start(settings: Settings) -> tuple[float, int]:
    """Start a simulator; return the seconds until it was ready, and its bytes of memory."""
    began = time.monotonic()
    simulator = await LocalSimulator.start(
        COMMAND,
        {"WRONGTURN_HOME": str(settings.home)},
        start_timeout_s=settings.simulator_start_timeout_s,
        timeout_s=settings.simulator_timeout_s,
    )
    try:
        return time.monotonic() - began, simulator.memory()
    finally:
        await simulator.close()
