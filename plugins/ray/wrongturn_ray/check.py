"""The check of simulators for ``wrongturn doctor``."""

import asyncio
import time

from wrongturn_ray.programs import Programs
from wrongturn_ray.settings import RaySettings, host_and_port
from wrongturn_ray.simulators import RayStarter, slots
from wrongturn_service.settings import Settings
from wrongturn_service.simulators.interface import SimulatorStartError


def examine(settings: Settings) -> str:
    """Start a simulator; return what the cluster has, and how long the start took. Raises SimulatorStartError."""
    return asyncio.run(_start(settings))


async def _start(settings: Settings) -> str:
    # Another port, because a running service has this one.
    ray = RaySettings()
    listen = f"{ray.ray_listen.rpartition(':')[0]}:0"
    advertise = ray.ray_advertise and host_and_port(ray.ray_advertise, port=0)[0]
    programs = Programs(ray.model_copy(update={"ray_listen": listen, "ray_advertise": advertise}))
    try:
        await programs.open()
        began = time.monotonic()
        simulator = await RayStarter(programs, settings).start()
        seconds = time.monotonic() - began
        await simulator.close()
        nodes = programs.nodes
    except OSError as error:
        where = f"WRONGTURN_RAY_LISTEN: {ray.ray_listen}"
        raise SimulatorStartError(f"{where}: {error.strerror or error}") from error
    finally:
        await programs.close()
    return (
        f"on Ray, {len(nodes)} nodes with {sum(node.cores for node in nodes):g} cores have room for {slots(nodes)}; "
        f"one was ready on {simulator.name} after {seconds:.1f} s, with the connection to Ray"
    )
