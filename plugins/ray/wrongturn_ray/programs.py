"""The service's end of a Ray cluster: starts programs on its nodes, and tells what becomes of them."""

import asyncio
import contextlib
import json
import sys
import uuid
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import structlog

from wrongturn_ray.connecting import way
from wrongturn_ray.driver import LONGEST
from wrongturn_ray.listener import Expected, Listener
from wrongturn_ray.settings import RaySettings, host_and_port, server_tls
from wrongturn_service.child_environment import child_environment

COMMAND: Final = (sys.executable, "-P", "-m", "wrongturn_ray.driver")
"""Command of the driver; the address of the cluster is added."""
_PASSED_ON: Final = ("RAY_TMPDIR", "RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH", "RAY_USE_TLS")
_TLS: Final = ("RAY_TLS_SERVER_CERT", "RAY_TLS_SERVER_KEY", "RAY_TLS_CA_CERT")
_AGAIN_S: Final = 2.0
"""Seconds until a driver that has ended is started again."""
_CONNECT_S, _SILENT_S = 180.0, 30.0
"""Seconds in which a driver has to connect, and then to say its next word."""
_GRACE_S: Final = 5.0
"""Seconds that a driver gets to end by itself."""


@dataclass(frozen=True)
class Resources:
    """What a program takes of its node."""

    cores: float
    memory: int = 0
    """Bytes that have to be free; Ray does not limit the program to them."""
    gpus: float = 0.0


@dataclass(frozen=True)
class Node:
    """A node of the cluster that lives."""

    id: str
    """Another one each time that its machine joins."""
    name: str
    cores: float
    memory: int
    """Bytes that programs may take."""


@dataclass(frozen=True)
class End:
    """How a program ended."""

    status: int | None
    """None if that is not known, or it was never started."""
    words: str
    """The last that it wrote to stdout or stderr."""
    why: str | None
    """Why Ray did not start it, or lost it."""
    other_versions: bool = False
    """Whether its node has other versions than the service."""

    def __str__(self) -> str:
        """Return one sentence for the log."""
        if self.status is None:
            return self.why or "nobody knows how it ended"
        return f"status {self.status}" + (f": {self.words.strip().splitlines()[-1]}" if self.words.strip() else "")


@dataclass(eq=False)
class Program:
    """A program that was started, or is being placed."""

    id: str
    end: Callable[[], None]
    """Ends it at once. Safe to call more than once."""
    ended: "asyncio.Future[End]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())


class Programs:
    """Programs on the nodes of one cluster. A driver that ends is started again, with the cluster's new state."""

    def __init__(self, settings: RaySettings, command: Sequence[str] = COMMAND) -> None:
        """Create it; :meth:`open` connects."""
        self.trouble: str | None = "Ray is not connected yet"
        """Why no program can be started; None if it can, as far as is known."""
        self.nodes: tuple[Node, ...] = ()
        """The nodes when Ray last answered."""
        self.connections = 0
        """How often a driver has connected."""
        self.changed: Callable[[], None] = lambda: None
        """Called when :attr:`trouble` or :attr:`nodes` have changed."""
        self.settings = settings
        self._command = (*command, settings.ray_address, *(["--join"] if settings.ray_join else []))
        tls = None
        self._certificate: str | None = None
        if settings.ray_certificate is not None:
            tls = server_tls(settings.ray_certificate, settings.ray_key)
            self._certificate = settings.ray_certificate.read_text("ascii")
        self._listener = Listener(tls)
        self._programs: dict[str, Program] = {}
        self._driver: asyncio.subprocess.Process | None = None
        self._address = ""
        self._port = 0
        self._news = asyncio.Event()
        self._keeping: asyncio.Task[None] | None = None
        self._log = structlog.get_logger("cluster")

    async def open(self) -> None:
        """Listen, and start the driver. Raises OSError if the address cannot be listened on."""
        self._port = await self._listener.open(*host_and_port(self.settings.ray_listen))
        self._keeping = asyncio.create_task(self._keep_driver())

    async def close(self) -> None:
        """End all programs and the driver. Safe to call more than once."""
        if self._keeping is not None:
            self._keeping.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._keeping
            self._keeping = None
            await self._listener.close()

    async def connected(self) -> None:
        """Wait until programs can be started."""
        while self.trouble is not None or not self.nodes:
            self._news.clear()
            await self._news.wait()

    @property
    def advertised(self) -> str:
        """Address at which programs reach this service."""
        if self.settings.ray_advertise:
            host, port = host_and_port(self.settings.ray_advertise, port=self._port)
        else:
            host, port = host_and_port(self.settings.ray_listen)[0], self._port
            host = self._address if host in {"0.0.0.0", "::"} else host  # noqa: S104 - what it stands for
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    @contextlib.asynccontextmanager
    async def starting(
        self,
        command: Sequence[str],
        protocol: Callable[[], asyncio.Protocol],
        resources: Resources,
        environment: Mapping[str, str] | None = None,
        files: Mapping[str, Path] | None = None,
        nodes: Iterable[str] | None = None,
    ) -> AsyncIterator[tuple[Program, Expected]]:
        """Start a program that connects with this service, and expect it until the block ends.

        ``command`` are arguments of the node's Python; ``{service}`` in one becomes the address to connect with.
        ``protocol`` makes what speaks with the program. The program has the ``files`` in the folder that it runs in.
        ``nodes`` are the ids of those that may run it; None are all.
        """
        with self._listener.expect(protocol) as expected:
            name = uuid.uuid4().hex
            program = Program(name, lambda: self._end(name))
            words = [word.replace("{service}", self.advertised) for word in command]
            variables = {**(environment or {}), **way(expected.secret, self._certificate)}
            if self._driver is None or self.trouble is not None:
                program.ended.set_result(End(None, "", self.trouble or "Ray's driver is being started"))
            else:
                self._programs[name] = program
                self._tell(
                    do="start",
                    id=name,
                    command=words,
                    environment=variables,
                    files={name: str(path) for name, path in (files or {}).items()},
                    cores=resources.cores,
                    memory=resources.memory,
                    gpus=resources.gpus,
                    nodes=None if nodes is None else list(nodes),
                )
            yield program, expected

    def _end(self, name: str) -> None:
        if name in self._programs:
            self._tell(do="end", id=name)

    def _tell(self, **message: Any) -> None:
        if self._driver is not None and self._driver.stdin is not None and not self._driver.stdin.is_closing():
            self._driver.stdin.write(json.dumps(message).encode() + b"\n")

    async def _keep_driver(self) -> None:
        while True:
            try:
                await self._drive()
            except OSError as error:
                self._state(f"Ray's driver could not be started: {error}")
            await asyncio.sleep(_AGAIN_S)

    async def _drive(self) -> None:
        """Run one driver until it ends, and hear what it says."""
        self._driver = driver = await asyncio.create_subprocess_exec(
            *self._command,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            limit=LONGEST,
            env=child_environment(*_PASSED_ON, *_TLS),
        )
        assert driver.stdin is not None
        assert driver.stdout is not None
        failure = None
        try:
            patience_s = _CONNECT_S
            while line := await asyncio.wait_for(driver.stdout.readline(), patience_s):
                failure = self._hear(json.loads(line)) or failure
                patience_s = _SILENT_S
        except TimeoutError:  # Ray has calls that hang for ever
            failure = "Ray's driver is silent"
            driver.kill()
        finally:
            self._driver = None
            driver.stdin.close()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_GRACE_S):
                    await driver.wait()
            if driver.returncode is None:
                driver.kill()
            await driver.wait()
            lost, self._programs = self._programs, {}
            for program in lost.values():
                program.ended.set_result(End(None, "", "Ray's driver ended"))
        self._state(failure or f"Ray's driver ended with status {driver.returncode}")

    def _hear(self, message: dict[str, Any]) -> str | None:
        """Take in what the driver says; return why it will end, if it says so."""
        said = message.pop("said")
        if said == "connected":
            self._address = message["address"]
            self.connections += 1
        elif said == "nodes":
            self.nodes = tuple(Node(**node) for node in message["nodes"])
            self._log.info(
                "Ray", nodes=[node.name for node in self.nodes], cores=sum(node.cores for node in self.nodes)
            )
            self._state(None)
        elif said == "trouble":
            self._state(message["why"])
            return str(message["why"])
        elif said == "ended" and (program := self._programs.pop(message["id"], None)) is not None:
            program.ended.set_result(
                End(
                    message["status"],
                    message["words"],
                    message["why"],
                    message["node"] != "" and message["status"] is None,
                )
            )
        return None

    def _state(self, trouble: str | None) -> None:
        if trouble is not None and trouble != self.trouble:
            self._log.warning("Ray", trouble=trouble)
        self.trouble = trouble
        self._news.set()
        self.changed()
