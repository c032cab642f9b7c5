"""Metrics for Prometheus. Each service has its own registry."""

import platform
from collections.abc import Iterable, Mapping, Sequence
from contextvars import ContextVar
from importlib.metadata import version
from typing import Final, Literal, get_args

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, ProcessCollector, generate_latest

from wrongturn_protocol import SubmissionState
from wrongturn_service.storage.condition import FailureKind

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_BUCKETS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
_CHECK_BUCKETS = (0.5, 1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 30.0, 60.0, 300.0)

CLOSED: Final = (
    "head-too-large",
    "hosts",
    "pipelined",
    "slow-message",
    "slow-reader",
    "slow-request",
    "too-many",
    "too-many-frames",
)
"""Reasons for which the service closes a connection because of its client."""
Call = Literal["reset", "step", "view", "replay", "abort"]
"""Kinds of calls to a simulator."""
Voided = Literal["simulators-failed", "service-ended", "runner-ended", "cancelled"]
"""Reasons for which an episode ends without a verdict that counts."""
_simulated: ContextVar[tuple[str, float] | None] = ContextVar("simulated", default=None)
"""Kind of the current request's last call to a simulator, and the seconds of all its calls."""


class Telemetry:
    """The service's metrics, listed in ``docs/monitoring.md``."""

    def __init__(self) -> None:
        self._registry = registry = CollectorRegistry()

        def timed(name: str, documentation: str, *labels: str, buckets: Sequence[float] = _BUCKETS) -> Histogram:
            return Histogram(f"wrongturn_{name}", documentation, labels, buckets=buckets, registry=registry)

        def counted(name: str, documentation: str, *labels: str, values: Iterable[str] = ()) -> Counter:
            counter = Counter(f"wrongturn_{name}", documentation, labels, registry=registry)
            for value in values:
                counter.labels(value)
            return counter

        self._requests = timed("request_seconds", "Time to answer a request, by route", "method", "route", "status")
        simulation = timed("simulation_seconds", "Time that a simulator took to answer, by kind of call", "call")
        overhead = timed("overhead_seconds", "Time to answer a reset or step, less the simulator's time", "call")
        self._by_call = {call: (simulation.labels(call), overhead.labels(call)) for call in get_args(Call)}
        self.database = timed("database_seconds", "Time of a transaction, by operation", "operation")
        self.storage_errors = counted(
            "storage_errors", "Transactions that failed, by kind", "kind", values=[kind.value for kind in FailureKind]
        )
        self.steps = counted("steps", "Decisions that were simulated")
        self.ended = counted("episodes_ended", "Episodes with a verdict", "scored", "verdict")
        self.voided = counted(
            "episodes_voided",
            "Episodes that ended without a verdict that counts, by reason",
            "reason",
            values=get_args(Voided),
        )
        self.closed = counted("connections_closed", "Connections that the service closed", "reason", values=CLOSED)
        self._submissions = self.gauge("wrongturn_submissions", "Submissions that wait or run, by state", "state")
        self.submissions_over = counted("submissions_ended", "Submissions that are over, by state", "state")
        for state in SubmissionState:
            (self.submissions_over if state.over else self._submissions).labels(state.value)
        self.checks = timed(
            "submission_check_seconds", "Time to check a model, from the start of its runner", buckets=_CHECK_BUCKETS
        )
        self.runners_lost = counted("runners_lost", "Runners that ended before they were done")
        self.expired = counted("leases_expired", "Episodes that were aborted because their agent was silent")
        self.deaths = counted("simulator_deaths", "Simulators that died")
        self.replays = counted("replays", "Episodes that were replayed in another simulator")
        build = self.gauge("wrongturn_build_info", "1; the labels say what runs", "version", "python", "sumo")
        build.labels(version("wrongturn-service"), platform.python_version(), version("libsumo")).set(1)
        # Memory, processor time, descriptors and start of the service's own process, without its simulators.
        ProcessCollector(registry=registry)

    def gauge(self, name: str, documentation: str, *labels: str) -> Gauge:
        """Add a gauge."""
        return Gauge(name, documentation, labels, registry=self._registry)

    def answered(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count an answered request."""
        self._requests.labels(method, route, str(status)).observe(seconds)
        simulated = _simulated.get()
        if simulated is not None:
            _simulated.set(None)
            call, waited = simulated
            self._by_call[call][1].observe(max(0.0, seconds - waited))

    def simulated(self, call: Call, seconds: float) -> None:
        """Count a call to a simulator, answered or failed."""
        self._by_call[call][0].observe(seconds)
        if call == "step":
            self.steps.inc()
        before = _simulated.get()
        # The last kind counts: a replay may precede a step.
        _simulated.set((call, seconds if before is None else before[1] + seconds))

    def stepped(self, route: str, simulated_s: float, seconds: float) -> None:
        """Count a plain step: what :meth:`simulated` and :meth:`answered` count of other requests."""
        simulation, overhead = self._by_call["step"]
        simulation.observe(simulated_s)
        overhead.observe(seconds - simulated_s)
        self.steps.inc()
        self._requests.labels("WS", route, "200").observe(seconds)

    def submissions(self, counts: Mapping[SubmissionState, int]) -> None:
        """Show how many submissions wait or run. States that are left out have none."""
        for state in SubmissionState:
            if not state.over:
                self._submissions.labels(state.value).set(counts.get(state, 0))

    def render(self) -> bytes:
        """Return all metrics in Prometheus' text format."""
        return generate_latest(self._registry)
