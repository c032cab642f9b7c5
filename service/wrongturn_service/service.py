"""The service without HTTP: it starts its parts, connects them, and stops them."""

import asyncio
import contextlib
import gc
import time
from collections import Counter
from collections.abc import AsyncIterator, Sequence
from importlib import import_module

import structlog

from wrongturn_protocol import ProblemType
from wrongturn_protocol.installing import ray
from wrongturn_service import catalogue
from wrongturn_service.accounts import Accounts
from wrongturn_service.administration import Administration
from wrongturn_service.cache import Cache
from wrongturn_service.certificates import Certificates
from wrongturn_service.cluster import Cluster
from wrongturn_service.episodes.draws import Draws
from wrongturn_service.episodes.driver import EpisodeDriver
from wrongturn_service.episodes.episodes import Episodes
from wrongturn_service.episodes.evaluations import RunningEvaluations
from wrongturn_service.episodes.open_episode import Registry
from wrongturn_service.episodes.queue import SimulatorQueue
from wrongturn_service.episodes.resets import Closings, Resets
from wrongturn_service.errors import ServiceError, StartupError, UnavailableError
from wrongturn_service.evaluation.leaderboards import Leaderboards
from wrongturn_service.idempotency import Idempotency
from wrongturn_service.machine import check_disk
from wrongturn_service.registration import Registrations
from wrongturn_service.replays import Replays
from wrongturn_service.settings import Place, Settings
from wrongturn_service.simulators.interface import SimulatorStartError
from wrongturn_service.simulators.local_simulator import LocalStarter
from wrongturn_service.simulators.pool import SimulatorPool
from wrongturn_service.socket.guards import ConnectionLimits
from wrongturn_service.storage.administration import AdministrationStore
from wrongturn_service.storage.database import Database
from wrongturn_service.storage.finished import FinishedStore
from wrongturn_service.storage.location import file_of, parse
from wrongturn_service.storage.store import Store
from wrongturn_service.storage.submissions import SubmissionStore
from wrongturn_service.storage.usage import Quota
from wrongturn_service.submissions.availability import Availability
from wrongturn_service.submissions.dispatcher import Dispatcher
from wrongturn_service.submissions.files import ModelFiles
from wrongturn_service.submissions.jobs import JobContext
from wrongturn_service.submissions.local_runners import COMMAND, LocalRunners
from wrongturn_service.submissions.operations import Submissions
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
_log = structlog.get_logger("service")


class Service:
    """The parts of a running service.

    Attributes:
        pages: Rendered pages of the leaderboards, by generation of these.
        cache: What pages make of finished evaluations.
        lists: Lists of accounts, which are kept for a second.
        documents: JSON that never changes, by what it shows: suites, towns and the OpenAPI document.
    """

    def __init__(
        self,
        settings: Settings,
        telemetry: Telemetry,
        database: Database,
        pool: SimulatorPool,
        cluster: Cluster | None,
        runner: Sequence[str],
    ) -> None:
        self.settings = settings
        self.telemetry = telemetry
        self.pool = pool
        self.cluster = cluster
        quota = Quota(
            settings.bytes_per_owner,
            settings.bytes_per_address,
            settings.agents_per_owner,
            settings.accounts_per_address,
        )
        self.store = Store(database, quota)
        self.finished = FinishedStore(database)
        rows_of_operator = AdministrationStore(database)
        self.certificates = Certificates(rows_of_operator, self.store, self.finished, settings.signing_key_file)
        self.draws = Draws(settings.home)
        self.replays = Replays(self.store, self.draws)
        self.judgements = Counter[str]()
        self.judging = asyncio.Semaphore(1)
        self.pages = Cache(_PAGES, at_once=1)
        self.lists = Cache(_PAGES, at_once=1, keep_s=1.0)
        self.cache = Cache()
        self.documents = Cache(_DOCUMENTS, size=len)
        self.leaderboards = Leaderboards(self.store)
        self.idempotency = Idempotency(self.store)
        self.sockets = ConnectionLimits(each=settings.max_sockets, address=settings.max_sockets_per_address)

        self.evaluations = RunningEvaluations(self.store, telemetry, self.draws, self.leaderboards.forget)
        self.queue = SimulatorQueue(lambda: pool.slots, settings.max_waiting, settings.max_line)
        driver = EpisodeDriver(pool, self.queue, telemetry)
        self.episodes = Episodes(
            self.store,
            driver,
            self.evaluations,
            Registry(settings.max_parallel, settings.max_open),
            telemetry,
            release_s=settings.lease_release_s,
            abort_s=settings.lease_abort_s,
        )
        self.resets = Resets(self.store, driver, self.evaluations, self.episodes, self.check_disk)
        self.closings = Closings(
            self.store,
            self.evaluations,
            self.draws,
            self.episodes,
            idle_s=settings.evaluation_idle_h * _HOUR_S,
            longest_s=settings.evaluation_days * _DAY_S,
        )

        rows = SubmissionStore(database, quota)
        files = ModelFiles(settings.home, settings.disk_reserve)
        self.accounts = Accounts(self.store, rows, settings)
        self.registrations = Registrations(self.store, settings, self.accounts)
        self.submissions = Submissions(rows, files, self.episodes, self.closings, settings, telemetry)
        self.uploads = Uploads(
            files, limit=settings.model_limit, patience_s=settings.slow_client_s, each=settings.submissions_per_owner
        )
        remote = cluster if settings.runners is Place.RAY else None
        self.availability = Availability(settings, None if remote is None else remote.look)
        self.dispatcher = Dispatcher(
            JobContext(
                settings,
                self.store,
                self.submissions,
                self.episodes,
                self.evaluations,
                self.availability,
                telemetry,
                LocalRunners(runner) if remote is None else remote.runners,
            )
        )
        if remote is not None:
            remote.sandboxes_changed = self.dispatcher.wake
        self.administration = Administration(
            rows_of_operator,
            self.accounts,
            self.submissions,
            self.closings,
            self.leaderboards,
            self.replays,
            self.cache,
            self.lists,
        )

    def why_not_ready(self) -> UnavailableError | None:
        """Return why new episodes cannot begin, as far as is known without asking anybody; None if they can."""
        if self.episodes.stopping:
            return UnavailableError(ProblemType.SHUTTING_DOWN, "the service is stopping")
        if self.pool.failure is not None and not self.pool.running:
            return UnavailableError(ProblemType.SIMULATOR_FAILED, "no simulator could be started", retry_after_s=30)
        lost = self.settings.on_ray and self.cluster is not None and self.cluster.trouble is not None
        if lost and not self.pool.idle:
            detail = "the Ray cluster, which runs the simulators, cannot be reached; the service tries again"
            return UnavailableError(ProblemType.SIMULATOR_FAILED, detail, retry_after_s=5)
        if self.store.trouble is not None:
            detail = f"the database fails: {self.store.trouble}"
            return UnavailableError(ProblemType.STORAGE_FAILED, detail, retry_after_s=5)
        return None

    def check_disk(self) -> None:
        """Check that the disk of an SQLite database has its reserve. Raises ServiceError (507)."""
        file = file_of(parse(self.settings.database_url))
        try:
            if file is not None:
                check_disk(file.parent, self.settings.disk_reserve)
        except OSError as error:
            raise ServiceError(
                ProblemType.STORAGE_FAILED,
                "the disk of the service is nearly full, so it takes neither registrations nor practice; come back "
                "later, or ask the operator to make room or to lower WRONGTURN_DISK_RESERVE",
                status=507,
            ) from error

    def cluster_changed(self) -> None:
        """Take over what the cluster's nodes are now."""
        if self.settings.on_ray and self.cluster is not None:
            self.pool.resize(min(self.cluster.slots, self.settings.most_simulators))

    def watch(self) -> None:
        """Add the gauges whose values are read when metrics are collected."""
        pool, episodes, queue, sockets = self.pool, self.episodes, self.queue, self.sockets
        for name, documentation, read in (
            (
                "ready",
                "1 if new episodes can begin, as /health/ready says",
                lambda: float(self.why_not_ready() is None),
            ),
            ("open_episodes", "Open episodes", lambda: episodes.open),
            ("leases_held", "Open episodes that have a simulator", lambda: episodes.held),
            (
                "leases_released",
                "Open episodes of silent agents, without a simulator",
                lambda: episodes.open - episodes.held,
            ),
            ("simulator_slots", "Largest number of simulators that drive", lambda: pool.slots),
            ("simulators_running", "Simulator processes", lambda: pool.running),
            ("simulators_busy", "Simulator processes that drive an episode", lambda: pool.busy),
            ("simulators_idle", "Simulator processes that are ready and unused", lambda: pool.idle),
            ("simulators_awaited", "Calls that wait for a simulator", lambda: queue.waiting),
            ("sockets", "Connections to /v1/drive", lambda: sockets.open),
            *(() if self.cluster is None else self.cluster.gauges()),
        ):
            self.telemetry.gauge(f"wrongturn_{name}", documentation).set_function(read)

    async def prepare(self) -> None:
        """Take over what the database and the home hold. Raises StartupError."""
        lost = await self.store.lose_open_episodes()
        if lost:
            self.telemetry.voided.labels("service-ended").inc(lost)
            _log.warning("episodes lost", count=lost, reason="they were open when the service ended last")
        try:
            await self.certificates.use()
        except ValueError as error:
            raise StartupError(f"WRONGTURN_SIGNING_KEY_FILE: {error}") from None
        await self.evaluations.resume()
        await self.registrations.prepare()
        try:
            self.submissions.files.prepare()
        except OSError as error:
            raise StartupError(
                f"{error.filename or self.submissions.files.folder} cannot be used: {error.strerror or error}; "
                "set WRONGTURN_HOME to a folder that the service can write to"
            ) from error
        await self.submissions.tidy()

    async def warm_up(self) -> None:
        """Load what comparisons and pictures need, unless a request has done so before.

        The simulators have compiled the kernels by then, so they are in the cache.
        """
        await asyncio.sleep(_WARM_UP_AFTER_S)
        await asyncio.to_thread(import_module, "scipy.stats")
        await self.replays.warm_up()
        # What was loaded lives for ever. Frozen, it does not slow down garbage collection.
        gc.freeze()

    async def keep_house(self) -> None:
        """Do chores for ever. Each fails alone, and is then tried again."""
        settings, pool = self.settings, self.pool
        memory = self.telemetry.gauge(
            "wrongturn_simulator_memory_bytes", "Memory of all simulators, updated every 30 s"
        )

        async def purge() -> None:
            now = time.time()
            await self.store.purge(
                practice_before=now - settings.practice_keep_days * _DAY_S,
                replies_before=now - settings.idempotency_keep_hours * _HOUR_S,
                abandoned_before=now - settings.abandoned_keep_days * _DAY_S,
                unused_before=now - settings.unused_keep_days * _DAY_S,
            )
            await self.submissions.purge()

        async def measure() -> None:
            memory.set(await asyncio.to_thread(pool.memory))

        async def close() -> None:
            await self.closings.close_overdue(await self.submissions.evaluations())

        async def start() -> None:
            # A service that is not ready gets no calls, so no call would start a simulator.
            if pool.failure is not None and not pool.running:
                await pool.start()

        purged = -_PURGE_S
        while True:
            for chore in (measure, self.evaluations.retry, close, self.submissions.tidy, start, purge):
                if chore is purge and time.monotonic() < purged + _PURGE_S:
                    continue
                try:
                    await chore()
                    purged = time.monotonic() if chore is purge else purged
                except Exception:
                    _log.exception("housekeeping failed", chore=chore.__name__)
            await asyncio.sleep(min(_RETRY_S, settings.evaluation_idle_h * _HOUR_S / 4))


@contextlib.asynccontextmanager
async def run_service(
    settings: Settings, telemetry: Telemetry, pool: SimulatorPool | None = None, runner: Sequence[str] = COMMAND
) -> AsyncIterator[Service]:
    """Run a service until the block ends.

    ``runner`` is the program that checks and drives submissions. Without a pool, the settings say where simulators run.

    Raises:
        StartupError: The database or the simulators cannot be used.
    """
    async with contextlib.AsyncExitStack() as stack:
        database = await Database.open(settings.database_url, home=settings.home, telemetry=telemetry)
        stack.push_async_callback(database.close)
        cluster: Cluster | None = ray("cluster")(settings, runner) if settings.uses_ray else None
        if cluster is not None:
            await cluster.open()
            stack.push_async_callback(cluster.close)
        pool = pool or SimulatorPool(
            settings.most_simulators,
            cluster.start if settings.on_ray and cluster is not None else LocalStarter.of(settings).start,
            spare=settings.spare_simulators,
            on_death=telemetry.deaths.inc,
        )
        stack.push_async_callback(pool.stop)
        service = Service(settings, telemetry, database, pool, cluster, runner)
        if cluster is not None:
            cluster.changed = service.cluster_changed
        await service.prepare()
        try:
            # The first simulator compiles the kernels; the others find them in the cache.
            await asyncio.gather(pool.start(), asyncio.to_thread(catalogue.warm_up))
        except SimulatorStartError as error:
            raise StartupError(str(error)) from error
        stack.push_async_callback(service.draws.stop)
        stack.push_async_callback(service.episodes.stop)
        stack.callback(service.uploads.close)
        stack.push_async_callback(service.dispatcher.stop)
        service.watch()
        for work in (service.episodes.watch_leases(), service.keep_house(), service.warm_up()):
            stack.push_async_callback(_cancel, asyncio.create_task(work))
        _log.info("ready", database=settings.database_url.rsplit("@", 1)[-1], simulators=pool.slots)
        yield service


async def _cancel(task: "asyncio.Task[None]") -> None:
    task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await task
