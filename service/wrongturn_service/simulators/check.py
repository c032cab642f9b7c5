"""The check of simulators for ``wrongturn doctor``."""

import asyncio
import time

from wrongturn_service.machine import Machine
from wrongturn_service.settings import Settings
from wrongturn_service.simulators.local_pool import COMMAND
from wrongturn_service.simulators.local_simulator import LocalSimulator

_MIB = 2**20


class TooLittleMemoryError(Exception):
    """The simulators that are set do not fit into this machine's memory."""


def examine(settings: Settings) -> str:
    """Start one simulator, and return how long its start took and how much memory it has.

    Raises:
        SimulatorStartError: it does not start.
        TooLittleMemoryError: the number of simulators that is set does not fit.
    """
    return asyncio.run(_examine(settings))


async def _examine(settings: Settings) -> str:
    available = Machine().available_memory()
    began = time.monotonic()
    simulator = await LocalSimulator.start(
        COMMAND,
        {"WRONGTURN_HOME": str(settings.home)},
        start_timeout_s=settings.simulator_start_timeout_s,
        timeout_s=settings.simulator_timeout_s,
    )
    try:
        seconds = time.monotonic() - began
        memory = simulator.memory()
    finally:
        await simulator.close()
    count = settings.simulators + settings.spare_simulators
    report = (
        f"one was ready after {seconds:.1f} s and has {memory / _MIB:.0f} MiB; {count} of them, with the spare, "
        f"{count * memory / _MIB:.0f} MiB of {available / _MIB:.0f} that are free"
    )
    if available and count * memory > available:
        raise TooLittleMemoryError(report)
    return report
