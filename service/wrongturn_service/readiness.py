"""Why new episodes cannot begin, as far as the service knows without asking anybody."""

from wrongturn_protocol import ProblemType
from wrongturn_service.episodes.episodes import Episodes
from wrongturn_service.errors import UnavailableError
from wrongturn_service.simulators.interface import SimulatorPool
from wrongturn_service.storage.store import Store


def why_not_ready(episodes: Episodes, pool: SimulatorPool, store: Store) -> UnavailableError | None:
    """Return the error of a service that is not ready, None if nothing is known against it."""
    if episodes.stopping:
        return UnavailableError(ProblemType.SHUTTING_DOWN, "the service is stopping")
    if pool.failure is not None and not pool.running:
        return UnavailableError(ProblemType.SIMULATOR_FAILED, "no simulator could be started", retry_after_s=30)
    if store.trouble is not None:
        return UnavailableError(ProblemType.STORAGE_FAILED, f"the database fails: {store.trouble}", retry_after_s=5)
    return None
