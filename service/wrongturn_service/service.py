"""The service without HTTP: it starts its parts, connects them, and stops them."""

import asyncio
import contextlib
import gc
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from importlib import import_module

import structlog
from prometheus_client import Gauge

from wrongturn_service import catalogue
from wrongturn_service.accounts import Accounts
from wrongturn_service.administration import Administration
from wrongturn_service.cache import Cache
from wrongturn_service.episodes.closings import Closings
from wrongturn_service.episodes.driver import EpisodeDriver
from wrongturn_service.episodes.episodes import Episodes
from wrongturn_service.episodes.evaluations import RunningEvaluations
from wrongturn_service.episodes.open_episode import Limits, Most, Registry
from wrongturn_service.episodes.queue import SimulatorQueue
from wrongturn_service.episodes.resets import Resets
from wrongturn_service.errors import StartupError
from wrongturn_service.evaluation.leaderboards import Leaderboards
from wrongturn_service.idempotency import Idempotency
from wrongturn_service.metrics_port import metrics_port
from wrongturn_service.readiness import why_not_ready
from wrongturn_service.registration import Registrations
from wrongturn_service.replays import Replays
from wrongturn_service.settings import Settings
from wrongturn_service.simulators.interface import SimulatorPool, SimulatorStartError
from wrongturn_service.simulators.local_pool import LocalPool
from wrongturn_service.socket.limits import ConnectionLimits
from wrongturn_service.storage.administration import AdministrationStore
from wrongturn_service.storage.database import Database
from wrongturn_service.storage.finished import FinishedStore
from wrongturn_service.storage.store import Store
from wrongturn_service.storage.submissions import SubmissionStore
from wrongturn_service.storage.usage import Quota
from wrongturn_service.submissions.availability import Availability
from wrongturn_service.submissions.dispatcher import Dispatcher
from wrongturn_service.submissions.files import ModelFiles
from wrongturn_service.submissions.jobs import JobContext
from wrongturn_service.submissions.operations import Submissions
from wrongturn_service.submissions.runners import COMMAND
from wrongturn_service.submissions.upload import Uploads
from wrongturn_service.telemetry import Telemetry

_PURGE_S = 3600.0
_RETRY_S = 30.0
_HOUR_S = 3600.0
_DAY_S = 86400.0
_DOCUMENTS = 32 << 20
"""Bytes of the documents that are cached."""
_PAGES = 64
"""Rendered pages that are cached. The page of a hundred agents has about 200 kB."""
_WARM_UP_AFTER_S = 10.0
"""Seconds after the start, in which the first agents come."""


@dataclass(frozen=True)
class Service:
    """The parts of a running service."""

    settings: Settings
    store: Store
    finished: FinishedStore
    replays: Replays
    pool: SimulatorPool
    episodes: Episodes
    resets: Resets
    closings: Closings
    evaluations: RunningEvaluations
    accounts: Accounts
    registrations: Registrations
    idempotency: Idempotency
    leaderboards: Leaderboards
    pages: Cache
    """Rendered pages of the leaderboards, by generation of these."""
    cache: Cache
    """What pages make of finished evaluations."""
    documents: Cache
    """JSON that never changes, by what it shows: suites, towns and the OpenAPI document."""
    submissions: Submissions
    uploads: Uploads
    availability: Availability
    dispatcher: Dispatcher
    telemetry: Telemetry
    sockets: ConnectionLimits
    administration: Administration


@contextlib.asynccontextmanager
async def run_service(
    settings: Settings, telemetry: Telemetry, pool: SimulatorPool | None = None, runner: Sequence[str] = COMMAND
) -> AsyncIterator[Service]:
    """Run a service until the block ends.

    ``runner`` is the program that checks and drives submissions. Without a pool, simulators are processes of this
    machine.

    Raises:
        StartupError: The database or the simulators cannot be used.
    """
    log = structlog.get_logger("service")
    async with contextlib.AsyncExitStack() as stack:
        await stack.enter_async_context(metrics_port(settings, telemetry))
        database = await Database.open(settings.database_url, home=settings.home, telemetry=telemetry)
        stack.push_async_callback(database.close)
        quota = Quota(
            settings.bytes_per_owner,
            settings.bytes_per_address,
            settings.agents_per_owner,
            settings.accounts_per_address,
        )
        store = Store(database, quota)
        lost = await store.lose_open_episodes()
        if lost:
            telemetry.voided("service-ended", lost)
            log.warning("episodes lost", count=lost, reason="they were open when the service ended last")
        pool = pool or _local_pool(settings, telemetry)
        await asyncio.gather(_start_pool(pool, stack), asyncio.to_thread(catalogue.warm_up))
        leaderboards = Leaderboards(store)
        evaluations = RunningEvaluations(store, telemetry, leaderboards.forget)
        await evaluations.resume()
        queue = SimulatorQueue(pool.slots, settings.max_waiting, settings.max_line)
        driver = EpisodeDriver(pool, queue, telemetry)
        episodes = Episodes(
            store,
            driver,
            evaluations,
            Registry(_limits(settings)),
            telemetry,
            release_s=settings.lease_release_s,
            abort_s=settings.lease_abort_s,
        )
        resets = Resets(store, driver, evaluations, episodes)
        closings = Closings(
            store,
            evaluations,
            episodes,
            idle_s=settings.evaluation_idle_h * _HOUR_S,
            longest_s=settings.evaluation_days * _DAY_S,
        )
        stack.push_async_callback(episodes.stop)
        telemetry.watch(
            "wrongturn_ready",
            "1 if new episodes can begin, as /health/ready says",
            lambda: float(why_not_ready(episodes, pool, store) is None),
        )
        telemetry.watch("wrongturn_open_episodes", "Open episodes", lambda: episodes.open)
        telemetry.watch("wrongturn_leases_held", "Open episodes that have a simulator", lambda: episodes.held)
        telemetry.watch(
            "wrongturn_leases_released",
            "Open episodes of silent agents, without a simulator",
            lambda: episodes.open - episodes.held,
        )
        telemetry.watch("wrongturn_simulator_slots", "Largest number of simulators that drive", lambda: pool.slots)
        telemetry.watch("wrongturn_simulators_running", "Simulator processes", lambda: pool.running)
        telemetry.watch("wrongturn_simulators_busy", "Simulator processes that drive an episode", lambda: pool.busy)
        telemetry.watch("wrongturn_simulators_idle", "Simulator processes that are ready and unused", lambda: pool.idle)
        telemetry.watch("wrongturn_simulators_awaited", "Calls that wait for a simulator", lambda: queue.waiting)
        sockets = ConnectionLimits(each=settings.max_sockets, address=settings.max_sockets_per_address)
        telemetry.watch("wrongturn_sockets", "Connections to /v1/drive", lambda: sockets.open)
        memory = telemetry.gauge("wrongturn_simulator_memory_bytes", "Memory of all simulators, updated every 30 s")
        rows = SubmissionStore(database, quota)
        accounts = Accounts(store, rows, settings)
        files = ModelFiles(settings.home)
        submissions = Submissions(rows, files, episodes, closings, settings, telemetry)
        await _prepare(submissions)
        uploads = Uploads(
            files, limit=settings.model_limit, patience_s=settings.slow_client_s, each=settings.submissions_per_owner
        )
        stack.callback(uploads.close)
        availability = Availability(settings)
        dispatcher = Dispatcher(
            JobContext(settings, store, submissions, episodes, evaluations, availability, telemetry, runner)
        )
        stack.push_async_callback(dispatcher.stop)
        registrations = Registrations(store, settings, accounts)
        await registrations.prepare()
        chores = _housekeeping(settings, store, evaluations, closings, submissions, pool, memory)
        replays = Replays(store)
        for work in (episodes.watch_leases(), chores, _warm_up(replays)):
            task = asyncio.create_task(work)
            stack.push_async_callback(_cancel, task)
        cache = Cache()
        administration = Administration(
            AdministrationStore(database), accounts, submissions, closings, leaderboards, replays, cache
        )
        log.info("ready", database=settings.database_url.rsplit("@", 1)[-1], simulators=settings.simulators)
        yield Service(
            settings,
            store,
            FinishedStore(database),
            replays,
            pool,
            episodes,
            resets,
            closings,
            evaluations,
            accounts,
            registrations,
            Idempotency(store),
            leaderboards,
            Cache(_PAGES, at_once=1),
            cache,
            Cache(_DOCUMENTS, size=len),
            submissions,
            uploads,
            availability,
            dispatcher,
            telemetry,
            sockets,
            administration,
        )


def _limits(settings: Settings) -> Limits:
    return Limits(
        evaluation=settings.max_parallel,
        agent=Most(settings.max_open, settings.max_practice),
        owner=Most(settings.max_open_per_owner, settings.max_practice_per_owner),
        address=Most(settings.max_open_per_address, settings.max_practice_per_address),
    )


def _local_pool(settings: Settings, telemetry: Telemetry) -> SimulatorPool:
    return LocalPool(
        settings.simulators,
        spare=settings.spare_simulators,
        start_timeout_s=settings.simulator_start_timeout_s,
        timeout_s=settings.simulator_timeout_s,
        environment={"WRONGTURN_HOME": str(settings.home)},
        on_death=telemetry.deaths.inc,
    )


async def _prepare(submissions: Submissions) -> None:
    try:
        submissions.files.prepare()
    except OSError as error:
        raise StartupError(
            f"{error.filename or submissions.files.folder} cannot be used: {error.strerror or error}; "
            "set WRONGTURN_HOME to a folder that the service can write to"
        ) from error
    await submissions.tidy()


async def _start_pool(pool: SimulatorPool, stack: contextlib.AsyncExitStack) -> None:
    stack.push_async_callback(pool.stop)
    try:
        # The first one compiles the kernels; the others find them in the cache.
        await pool.start()
    except SimulatorStartError as error:
        raise StartupError(str(error)) from error


async def _warm_up(replays: Replays) -> None:
    """Load what comparisons and pictures need, unless a request has done so before.

    The simulators have compiled the kernels by then, so they are in the cache.
    """
    await asyncio.sleep(_WARM_UP_AFTER_S)
    await asyncio.to_thread(import_module, "scipy.stats")
    await replays.warm_up()
    # What was loaded lives for ever. Frozen, it does not slow down garbage collection.
    gc.freeze()


async def _housekeeping(
    settings: Settings,
    store: Store,
    evaluations: RunningEvaluations,
    closings: Closings,
    submissions: Submissions,
    pool: SimulatorPool,
    memory: Gauge,
) -> None:
    """Do chores for ever. Each fails alone, and is then tried again."""
    log = structlog.get_logger("service")

    async def purge() -> None:
        now = time.time()
        await store.purge(
            practice_before=now - settings.practice_keep_days * _DAY_S,
            replies_before=now - settings.idempotency_keep_hours * _HOUR_S,
            abandoned_before=now - settings.abandoned_keep_days * _DAY_S,
            unused_before=now - settings.unused_keep_days * _DAY_S,
        )

    async def measure() -> None:
        memory.set(await asyncio.to_thread(pool.memory))

    async def close() -> None:
        await closings.close_overdue(await submissions.evaluations())

    async def start() -> None:
        # A service that is not ready gets no calls, so no call would start a simulator.
        if pool.failure is not None and not pool.running:
            await pool.start()

    always = {"memory": measure, "retry": evaluations.retry, "close": close, "tidy": submissions.tidy, "start": start}
    hourly = {"purge": purge, "purge submissions": submissions.purge}
    due = dict.fromkeys({**hourly, **always}, 0.0)
    while True:
        for name, chore in {**hourly, **always}.items():
            if time.monotonic() < due[name]:
                continue
            try:
                await chore()
                due[name] = time.monotonic() + (_PURGE_S if name in hourly else 0.0)
            except Exception:
                log.exception("housekeeping failed", chore=name)
        await asyncio.sleep(min(_RETRY_S, settings.evaluation_idle_h * _HOUR_S / 4))


async def _cancel(task: "asyncio.Task[None]") -> None:
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
