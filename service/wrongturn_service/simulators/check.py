"""The check of simulators for ``wrongturn doctor``."""

import asyncio
import time

from wrongturn_protocol.installing import ray
from wrongturn_service.machine import SANDBOX_MEMORY, Machine
from wrongturn_service.settings import Settings, sandboxes
from wrongturn_service.simulators.local_simulator import LocalStarter

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
    if settings.on_ray:
        return str(ray("examine")(settings))
    available = Machine().available_memory()
    seconds, memory = asyncio.run(_start(settings))
    if seconds > _COMPILED_S:  # it has compiled the kernels, which takes several times the memory
        seconds, memory = asyncio.run(_start(settings))
    count = settings.most_simulators + settings.spare_simulators
    others = sandboxes(settings.submissions, settings.runner_socket) * SANDBOX_MEMORY
    report = (
        f"one was ready after {seconds:.1f} s and has {memory / _MIB:.0f} MiB; {count} of them, with the spare, "
        f"{count * memory / _MIB:.0f} MiB of {available / _MIB:.0f} that are free"
    )
    if others:
        report += f"; {others // SANDBOX_MEMORY} sandboxes of submissions, about {others / _MIB:.0f} MiB"
    if available and count * memory + others > available:
        raise TooLittleMemoryError(report)
    return report


async def _start(settings: Settings) -> tuple[float, int]:
    """Start a simulator; return the seconds until it was ready, and its bytes of memory."""
    began = time.monotonic()
    simulator = await LocalStarter.of(settings).start()
    try:
        return time.monotonic() - began, simulator.memory()
    finally:
        await simulator.close()
