"""The simulator of one environment, of which a process can have any number."""

from pathlib import Path

from wrongturn_sim.simulation import Simulation
from wrongturn_sim.simulator import Simulator, is_free, release
from wrongturn_sim.simulator_process import SimulatorProcess
from wrongturn_sim.traffic.plan import TrafficPlan


class EnvironmentSimulator(Simulator):
    """Gives an environment's episodes a simulation without taking another one's.

    A car that drives alone needs no SUMO, because SUMO then moves nothing that an episode reads. With traffic, the
    environment takes this process's simulator if it is free, and else a process of its own. The bytes are the same.
    """

    def __init__(self) -> None:
        self._simulation: Simulation | None = None
        self._process: SimulatorProcess | None = None

    def begin(
        self, net: Path, edge: str, x: float, y: float, yaw: float, *, seed: int, traffic: TrafficPlan | None = None
    ) -> Simulation:
        """Begin an episode; arguments and errors are those of :meth:`wrongturn_sim.simulator.Simulator.begin`."""
        self._release()
        if traffic is None:
            return Simulation()
        if self._process is None and is_free():
            self._simulation = super().begin(net, edge, x, y, yaw, seed=seed, traffic=traffic)
            return self._simulation
        if self._process is None or not self._process.usable:
            self._process = SimulatorProcess()
        return self._process.begin(net=net, edge=edge, x=x, y=y, yaw=yaw, seed=seed, traffic=traffic)

    def close(self) -> None:
        """Free this process's simulator and end the other process. Safe to call more than once."""
        self._release()
        if self._process is not None:
            self._process.close()

    def _release(self) -> None:
        if self._simulation is not None:
            release(self._simulation)
            self._simulation = None
