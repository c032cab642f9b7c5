"""Runners on the nodes of a Ray cluster that have a sandbox. They speak with the service over TCP."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

import structlog
from typing_extensions import override

from wrongturn_ray.listener import Expected
from wrongturn_ray.programs import Program, Programs, Resources
from wrongturn_ray.sandboxes import RaySandboxes
from wrongturn_ray.settings import host_and_port
from wrongturn_runner.messages import BUSY, CheckJob, Job
from wrongturn_service.settings import Settings
from wrongturn_service.submissions.local_runners import COMMAND
from wrongturn_service.submissions.runners import LINE, HaltedError, NoRoomError, Runner, RunnerLostError

CORES: Final = 0.1
"""Cores that a sandbox is counted with. Ray places by them; nobody is limited to them. Simulators leave them free."""
SANDBOXES: Final = 2
"""Sandboxes of a drive; a check has one."""
_MEMORY: Final = 256 << 20
"""Bytes of a runner, and of a sandbox without its model."""
_MODEL: Final = "model"
"""Name of the model's file in the folder of a runner."""
_PLACE_S: Final = 60.0
"""Seconds in which Ray has to find room, and to bring the model there."""
_GRACE_S: Final = 2.0
"""Seconds that a runner gets to end by itself, and in which Ray tells how it has ended."""
_EVERYWHERE: Final = frozenset({"0.0.0.0", "::"})  # noqa: S104 - what a service may listen on


class RayRunner(Runner):
    """A runner on a node; make it by :class:`RayRunners`."""

    def __init__(
        self,
        program: Program,
        streams: tuple[asyncio.StreamReader, asyncio.StreamWriter],
        about: str,
        submission: str,
        halt: asyncio.Event,
    ) -> None:
        super().__init__(*streams, halt)
        self._program = program
        self._about = about
        self._log = structlog.get_logger("submissions").bind(submission=submission, runner=about)

    @override
    async def end(self) -> None:
        self._writer.close()  # which ends it, see Conversation
        await asyncio.wait((self._program.ended,), timeout=_GRACE_S)
        self._program.end()
        if self._program.ended.done():
            end = self._program.ended.result()
            if end.words.strip():
                self._log.warning("the runner wrote to stderr", status=end.status, stderr=end.words.strip())

    @override
    async def _how_it_ended(self) -> RunnerLostError:
        await asyncio.wait((self._program.ended,), timeout=_GRACE_S)
        status = self._program.ended.result().status if self._program.ended.done() else None
        if status == BUSY:
            return NoRoomError("all sandboxes are taken")
        how = "is gone, or its node" if status is None else f"ended with status {status}"
        return RunnerLostError(f"the runner on Ray {how}")


class RayRunners:
    """Starts runners where Ray finds room, on nodes with a sandbox."""

    def __init__(
        self, programs: Programs, sandboxes: RaySandboxes, settings: Settings, command: Sequence[str] = COMMAND
    ) -> None:
        """``command`` is the program of a runner; each node has its own Python in place of this one's."""
        self._programs = programs
        self._sandboxes = sandboxes
        self._settings = settings
        self._command = ("-P", "-m", "wrongturn_ray.piped", "{service}", *command[1:])
        self._url = ""
        self._opening: asyncio.Task[None] | None = None
        self._log = structlog.get_logger("submissions")

    def open(self, url: str) -> None:
        """Ask the nodes for sandboxes."""
        self._opening = asyncio.create_task(self._open(url))

    async def _open(self, url: str) -> None:
        await self._programs.connected()  # which knows this machine's address in the cluster
        self._url = self._settings.runner_url or self._reachable(url)
        self._sandboxes.open(self._url)

    def _reachable(self, url: str) -> str:
        if self._settings.host not in _EVERYWHERE:
            return url
        host, _ = host_and_port(self._programs.advertised)
        return f"http://{f'[{host}]' if ':' in host else host}:{urlsplit(url).port}"

    async def close(self) -> None:
        """Ask no more. Safe to call more than once."""
        if self._opening is not None:
            self._opening.cancel()
        await self._sandboxes.close()

    @contextlib.asynccontextmanager
    async def start(self, job: Job, submission: str, halt: asyncio.Event) -> AsyncIterator[RayRunner]:
        """Start a runner as :meth:`Runners.start` says. Its program is ended when the block ends."""
        nodes = self._sandboxes.nodes
        if not nodes:
            raise NoRoomError("no node of the Ray cluster has a sandbox")
        placed = job.model_copy(update={"model": Path(_MODEL), "url": self._url, "gpu": self._settings.runner_gpus > 0})
        reader = asyncio.StreamReader(limit=LINE)
        writers: list[asyncio.StreamWriter] = []
        async with self._programs.starting(
            self._command,
            lambda: asyncio.StreamReaderProtocol(reader, lambda _, writer: writers.append(writer)),
            self._resources(1 if isinstance(job, CheckJob) else SANDBOXES),
            files={_MODEL: job.model},
            nodes=nodes,
        ) as (program, expected):
            try:
                about = await self._connected(program, expected, halt)
                started = RayRunner(program, (reader, writers[0]), about, submission, halt)
                try:
                    await started.send(placed)
                    yield started
                except RunnerLostError as lost:
                    if isinstance(lost, NoRoomError):
                        raise
                    self._sandboxes.doubt(about.rpartition(" on ")[2])
                    raise self._counted(lost) from lost.__cause__
                finally:
                    await asyncio.shield(started.end())
            finally:
                program.end()

    def _resources(self, sandboxes: int) -> Resources:
        memory = _MEMORY + sandboxes * (_MEMORY + self._settings.model_memory)
        return Resources(CORES * sandboxes, memory, self._settings.runner_gpus)

    async def _connected(self, program: Program, expected: Expected, halt: asyncio.Event) -> str:
        """Wait until a runner has connected; return what it says of itself."""
        halted = asyncio.ensure_future(halt.wait())
        try:
            await asyncio.wait(
                (expected.connected, program.ended, halted), timeout=_PLACE_S, return_when=asyncio.FIRST_COMPLETED
            )
        finally:
            halted.cancel()
        if expected.connected.done():
            return expected.connected.result()
        if halt.is_set():
            raise HaltedError("the job has to end")
        if program.ended.done():
            end = program.ended.result()
            self._log.warning("a runner was not started on Ray", why=str(end))
            if end.status is None:  # such as a node that is gone, which Ray did not know yet; nothing of the model ran
                raise NoRoomError("Ray could not start a runner")
            raise RunnerLostError(f"the runner on Ray ended with status {end.status} at once")
        raise NoRoomError("no node with a sandbox has the processors and the memory that a runner needs")

    def _counted(self, lost: RunnerLostError) -> RunnerLostError:
        """Return what a loss counts as: no attempt if the whole cluster is lost."""
        return lost if self._programs.trouble is None else NoRoomError("the Ray cluster cannot be reached")
