"""The cluster of a service: its programs on the nodes, and how the service uses them."""

from collections.abc import Callable, Iterator, Sequence

from typing_extensions import override

from wrongturn_ray.programs import Programs
from wrongturn_ray.runners import RayRunners
from wrongturn_ray.sandboxes import RaySandboxes
from wrongturn_ray.settings import RaySettings
from wrongturn_ray.simulators import RayStarter, slots
from wrongturn_service.cluster import Cluster
from wrongturn_service.errors import StartupError
from wrongturn_service.settings import Place, Settings
from wrongturn_service.simulators.simulator import Simulator


class RayCluster(Cluster):
    """A Ray cluster, as :class:`Cluster` says."""

    def __init__(self, settings: Settings, runner: Sequence[str]) -> None:
        """Create it; ``runner`` is the command of a runner."""
        self.changed = self.sandboxes_changed = lambda: None
        self._programs = Programs(RaySettings())
        self._programs.changed = self._change
        self._starter = RayStarter(self._programs, settings)
        self._sandboxes = RaySandboxes(self._programs, settings)
        self._sandboxes.changed = lambda: self.sandboxes_changed()  # noqa: PLW0108 - the service sets it later
        self._drives_models = settings.runners is Place.RAY
        self.runners = RayRunners(self._programs, self._sandboxes, settings, runner)

    @override
    async def open(self) -> None:
        try:
            await self._programs.open()
        except OSError as error:
            named = f"WRONGTURN_RAY_LISTEN: {self._programs.settings.ray_listen}"
            raise StartupError(
                f"{named}: {error.strerror or error}; name an address of this machine that is free"
            ) from error

    @override
    async def close(self) -> None:
        await self._programs.close()

    @property
    @override
    def trouble(self) -> str | None:
        return self._programs.trouble

    @property
    @override
    def slots(self) -> int:
        return slots(self._programs.nodes)

    @override
    async def start(self) -> Simulator:
        return await self._starter.start()

    @override
    def look(self) -> str:
        return self._sandboxes.look()

    @override
    def gauges(self) -> Iterator[tuple[str, str, Callable[[], float]]]:
        programs, sandboxes = self._programs, self._sandboxes
        yield "ray_connected", "1 if programs can be started on Ray", lambda: float(programs.trouble is None)
        yield "ray_nodes", "Nodes of the Ray cluster that live", lambda: len(programs.nodes)
        yield "ray_cores", "Cores of the Ray cluster", lambda: sum(node.cores for node in programs.nodes)
        yield "ray_connections", "How often the service has connected with Ray", lambda: programs.connections
        if self._drives_models:
            yield "ray_nodes_with_sandbox", "Nodes of the Ray cluster that drive models", lambda: len(sandboxes.nodes)

    def _change(self) -> None:
        self.changed()
        self._sandboxes.wake()
