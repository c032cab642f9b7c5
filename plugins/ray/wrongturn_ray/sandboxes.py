"""Which nodes of a Ray cluster have a sandbox. Each is asked when it joins; no other one drives a model."""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable
from typing import Final

import structlog

from wrongturn_ray.programs import End, Node, Programs, Resources
from wrongturn_ray.settings import RaySettings
from wrongturn_sandbox import SandboxUnavailableError
from wrongturn_service.settings import Settings

_PATIENCE_S: Final = 90.0
"""Seconds in which a node has to answer. A sandbox has 60 to start."""
_AGAIN_S: Final = 60.0
"""Seconds until a node without a sandbox is asked again."""
_LOST_AGAIN_S: Final = 5.0
"""The same, if Ray lost the question."""
_AT_ONCE: Final = 16
"""Nodes that are asked at a time."""
_NAMED: Final = 3
"""Nodes without a sandbox that are named; of others there is the number."""


class RaySandboxes:
    """Asks the nodes, and knows what they answered. :meth:`open` begins."""

    def __init__(self, programs: Programs, settings: Settings) -> None:
        self.changed: Callable[[], None] = lambda: None
        """Called when other nodes than before have a sandbox."""
        self._programs = programs
        self._socket = str(settings.runner_socket or "")
        self._gpus = settings.runner_gpus
        self._url = ""
        self._found: dict[str, str] = {}
        """What the sandbox of a node is, by the node's id."""
        self._failed: dict[str, str] = {}
        """Why a node has none."""
        self._due: dict[str, float] = {}
        """When a node is to be asked again; those that are not in it have not been asked, or are being asked."""
        self._connection = 0
        self._asking: dict[str, asyncio.Task[None]] = {}
        self._at_once = asyncio.Semaphore(_AT_ONCE)
        self._news = asyncio.Event()
        self._keeping: asyncio.Task[None] | None = None
        self._log = structlog.get_logger("submissions")

    def open(self, url: str) -> None:
        """Begin to ask. Nodes have to reach the service at ``url``; an empty one is not tried."""
        self._url = url
        self._keeping = asyncio.create_task(self._keep())

    async def close(self) -> None:
        """Ask no more. Safe to call more than once."""
        tasks = [*self._asking.values(), *([] if self._keeping is None else [self._keeping])]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self._keeping = None

    def wake(self) -> None:
        """Look at the cluster, whose nodes or state have changed."""
        self._news.set()

    def doubt(self, machine: str) -> None:
        """Ask the nodes of a machine again, because a runner was lost there."""
        for node in self._programs.nodes:
            if node.name.startswith(f"{machine} ("):
                self._due[node.id] = 0.0
        self._news.set()

    @property
    def nodes(self) -> list[str]:
        """Ids of the nodes that have a sandbox."""
        live = () if self._programs.trouble is not None else self._programs.nodes
        return [node.id for node in live if node.id in self._found]

    @property
    def complete(self) -> bool:
        """Whether every node has answered."""
        return all(node.id in self._found or node.id in self._failed for node in self._programs.nodes)

    def look(self) -> str:
        """Return which nodes have a sandbox, and which have none. Raises SandboxUnavailableError if all have none."""
        if self._programs.trouble is not None:
            raise SandboxUnavailableError(f"no node can be reached: {self._programs.trouble}")
        failed = [f"{node.name}: {self._failed[node.id]}" for node in self._programs.nodes if node.id in self._failed]
        more = [f"and {len(failed) - _NAMED} more"] if len(failed) > _NAMED else []
        without = "; ".join((*failed[:_NAMED], *more))
        good = self.nodes
        if not good:
            raise SandboxUnavailableError(
                f"no node of the Ray cluster has a sandbox: {without or 'they are being asked'}"
            )
        what = "; ".join(Counter(self._found[node] for node in good))
        told = f"{len(good)} of {len(self._programs.nodes)} nodes on Ray: {what}"
        return f"{told}; not {without}" if without else told

    async def _keep(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            self._news.clear()
            live = {node.id for node in self._programs.nodes}
            for known in (self._found, self._failed, self._due):
                for gone in known.keys() - live:
                    del known[gone]
            if self._connection != self._programs.connections:
                self._connection = self._programs.connections
                self._due.clear()
            if self._programs.trouble is None:
                for node in self._programs.nodes:
                    if node.id not in self._asking and self._due.get(node.id, 0.0) <= loop.time():
                        self._asking[node.id] = asyncio.create_task(self._ask(node))
            self.changed()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_LOST_AGAIN_S):
                    await self._news.wait()

    async def _ask(self, node: Node) -> None:
        try:
            async with self._at_once:
                self._take_in(node, await self._answer(node))
        finally:
            del self._asking[node.id]
            self._news.set()

    async def _answer(self, node: Node) -> End | None:
        """Return how the question ended, None if it found no room on the node."""
        command = ("-P", "-m", "wrongturn_ray.asked", self._url, self._socket, *(["gpu"] * bool(self._gpus)))
        # It waits for no processor, and needs a GPU for the blink of an eye.
        resources = Resources(cores=0.0, gpus=min(self._gpus, 0.01))
        async with self._programs.starting(command, asyncio.Protocol, resources, nodes=(node.id,)) as (program, _):
            try:
                await asyncio.wait((program.ended,), timeout=_PATIENCE_S)
                return program.ended.result() if program.ended.done() else None
            finally:
                program.end()

    def _take_in(self, node: Node, end: End | None) -> None:
        now = asyncio.get_running_loop().time()
        lost = end is not None and end.status is None and not end.other_versions
        if lost and (self._programs.trouble is not None or node.id not in {one.id for one in self._programs.nodes}):
            return  # the node is gone, or the cluster; it is asked when it is back
        if end is None and node.id in self._found:
            return  # its GPUs are all taken
        if end is not None and end.status == 0:
            what = end.words.strip().splitlines()[-1]
            if self._found.get(node.id) != what:
                self._log.info("a node drives models", node=node.name, sandbox=what)
            self._found[node.id], self._due[node.id] = what, float("inf")
            self._failed.pop(node.id, None)
            return
        why = f"it did not answer within {_PATIENCE_S:g} s" if end is None else end.why or end.words.strip()
        if self._failed.get(node.id) != why:
            self._log.warning("a node drives no models", node=node.name, why=why)
        self._failed[node.id], self._due[node.id] = why, now + (_LOST_AGAIN_S if lost else _AGAIN_S)
        self._found.pop(node.id, None)


def probe_nodes(settings: Settings) -> str:
    """Ask all nodes and return what :meth:`RaySandboxes.look` says. Raises SandboxUnavailableError."""

    async def ask() -> str:
        programs = Programs(RaySettings())
        sandboxes = RaySandboxes(programs, settings)
        programs.changed = sandboxes.wake
        news = asyncio.Event()
        sandboxes.changed = news.set
        try:
            async with asyncio.timeout(_PATIENCE_S):
                await programs.open()
                await programs.connected()
                sandboxes.open(settings.runner_url or "")
                while not sandboxes.complete:
                    news.clear()
                    await news.wait()
        except (OSError, TimeoutError) as error:
            raise SandboxUnavailableError(
                f"no node can be reached: {programs.trouble or error or 'they do not answer'}"
            ) from error
        else:
            return sandboxes.look()
        finally:
            await sandboxes.close()
            await programs.close()

    return asyncio.run(ask())
