"""What the service asks of a Ray cluster. The package wrongturn-ray answers, by its entry point ``cluster``."""

from collections.abc import Callable, Iterator
from typing import Protocol

from wrongturn_service.simulators.simulator import Simulator
from wrongturn_service.submissions.runners import Runners


class Cluster(Protocol):
    """Nodes that run simulators, or runners, or both. It is made of the settings and the command of a runner."""

    runners: Runners
    """Runners on the nodes that have a sandbox."""
    changed: Callable[[], None]
    """Called when :attr:`slots` or :attr:`trouble` may have changed."""
    sandboxes_changed: Callable[[], None]
    """Called when other nodes than before have a sandbox."""

    async def open(self) -> None:
        """Connect, now and whenever the connection is lost. Raises StartupError."""

    async def close(self) -> None:
        """End all programs. Safe to call more than once."""

    @property
    def trouble(self) -> str | None:
        """Why no program can be started; None if it can, as far as is known."""

    @property
    def slots(self) -> int:
        """How many simulators may drive on the nodes."""

    async def start(self) -> Simulator:
        """Start a simulator and wait until it is ready. Raises SimulatorStartError."""

    def look(self) -> str:
        """Return which nodes have a sandbox. Raises SandboxUnavailableError if none has."""

    def gauges(self) -> Iterator[tuple[str, str, Callable[[], float]]]:
        """Yield the name, the meaning and the value of each figure."""
