"""The driver of Ray: ``python -m wrongturn_ray.driver ADDRESS [--join]``, a child of the service.

A driver runs on a node of its cluster. With ``--join`` it makes its machine one first, a node without cores.

Nothing else of the service imports Ray, which ends a process whose cluster is lost. The driver then ends with a status
that is not 0, and the service starts another one. Its programs end with it. It ends with stdin, too.

Lines of JSON on stdin:
    | ``{"do": "start", "id", "command", "environment", "files", "cores", "memory", "gpus", "nodes"}``; ``files`` has
      paths, ``nodes`` the ids of those that may run it, None for all
    | ``{"do": "end", "id"}``

Lines of JSON on stdout:
    | ``{"said": "connected", "address"}``, the address of this machine in the cluster
    | ``{"said": "nodes", "nodes"}`` whenever they change, each with ``id``, ``name``, ``cores`` and ``memory``
    | ``{"said": "trouble", "why"}``
    | ``{"said": "alive"}`` every few seconds
    | ``{"said": "ended", "id", "status", "words", "node", "why"}``
"""

import asyncio
import contextlib
import functools
import json
import logging
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Final

LONGEST: Final = 1 << 20
"""Longest line, bytes."""
LOOK_S: Final = 2.0
"""Seconds between two looks at the nodes."""
_OBJECT_STORE: Final = 100_000_000
"""Bytes of Ray's object store on a machine that joins; models of submissions go through it."""
_PATIENCE_S: Final = 5.0
"""Seconds in which Ray's head has to answer."""
_REPLACED: Final = 2
"""Looks at a head that listens and does not answer, after which it is taken for another one. Ray notices much later."""


class JoinError(Exception):
    """This machine could not become a node."""


class Driver:
    """Starts and ends programs, and tells what becomes of them."""

    def __init__(self, out: int, head: str) -> None:
        """Create it; ``out`` is the descriptor that lines are written to, ``head`` the address of Ray's head."""
        self._out = out
        self._head = head
        self._refs: dict[str, Any] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def say(self, said: str, **values: object) -> None:
        """Write one line."""
        data = json.dumps({"said": said, **values}).encode() + b"\n"
        while data:
            data = data[os.write(self._out, data) :]

    async def serve(self) -> None:
        """Do what stdin asks for, until its end."""
        reader = asyncio.StreamReader(limit=LONGEST)
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
        self._begin(self._watch())
        while line := await reader.readline():
            message = json.loads(line)
            if message.pop("do") == "start":
                self._begin(self._run(**message))
            else:
                self._end(message["id"])
        # Ray ends the programs of a driver that is gone. A clean end would wait for a head that may be gone too.
        os._exit(0)

    def _begin(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _end(self, name: str) -> None:
        import ray  # noqa: PLC0415

        if name in self._refs:
            # By force: what waits for a process does not notice anything else. In a thread: without a head it may hang.
            cancel = functools.partial(ray.cancel, self._refs[name], force=True)
            threading.Thread(target=cancel, daemon=True).start()

    async def _run(
        self,
        id: str,  # noqa: A002
        command: list[str],
        environment: dict[str, str],
        files: dict[str, str],
        cores: float,
        memory: int,
        gpus: float,
        nodes: list[str] | None,
    ) -> None:
        from wrongturn_ray.node import versions  # noqa: PLC0415

        try:
            where = None if nodes is None else {"ray.io/node-id": f"in({','.join(nodes)})"}
            task = _task().options(num_cpus=cores, memory=memory or None, num_gpus=gpus, label_selector=where)
            contents = {name: await asyncio.to_thread(Path(path).read_bytes) for name, path in files.items()}
            self._refs[id] = ref = task.remote(command, environment, contents, versions())
            end = await ref
        except Exception as error:
            # The first line is the message; what follows is where in Ray it happened.
            why = f"{type(error).__name__}: {(str(error) or 'without a message').splitlines()[0]}"
            end = {"status": None, "words": "", "node": "", "why": why}
        finally:
            self._refs.pop(id, None)
        self.say("ended", id=id, **end)

    async def _watch(self) -> None:
        told: object = None
        replaced = 0
        while True:
            try:
                news = await asyncio.wait_for(asyncio.to_thread(nodes), _PATIENCE_S)
            except Exception as error:
                lost = isinstance(error, TimeoutError)
                news = "Ray's head does not answer" if lost else f"Ray's head failed: {error}"
                replaced += await asyncio.to_thread(listens, self._head)
            else:
                replaced = 0
            if news == told:
                self.say("alive")
            else:
                self.say("trouble", why=news) if isinstance(news, str) else self.say("nodes", nodes=news)
            told = news
            if replaced == _REPLACED:
                self.say("trouble", why="another head of Ray is there, which does not know this driver")
                os._exit(1)
            await asyncio.sleep(LOOK_S)


def listens(address: str) -> bool:
    """Return whether somebody listens at an address."""
    try:
        check_answer(address)
    except OSError:
        return False
    return True


def nodes() -> Any:
    """Return what the cluster has: the nodes that live, each with its name, cores and bytes of memory."""
    import ray  # noqa: PLC0415

    return sorted(
        (
            {
                "id": node["NodeID"],
                "name": f"{node['NodeManagerHostname']} ({node['NodeManagerAddress']}, {node['NodeID'][:8]})",
                "cores": node["Resources"].get("CPU", 0.0),
                "memory": int(node["Resources"].get("memory", 0)),
            }
            for node in ray.nodes()
            if node["Alive"]
        ),
        key=lambda node: node["name"],
    )


@functools.cache
def _task() -> Any:
    import ray  # noqa: PLC0415

    from wrongturn_ray import node  # noqa: PLC0415

    ray.cloudpickle.register_pickle_by_value(node)
    return ray.remote(max_retries=0, scheduling_strategy="SPREAD")(node.run)


def check_answer(address: str) -> None:
    """Check that somebody listens at an address with a port: Ray itself tries for minutes. Raises OSError."""
    host, _, port = address.rpartition(":")
    if port.isdecimal():
        try:
            socket.create_connection((host.strip("[]"), int(port)), _PATIENCE_S).close()
        except OverflowError as error:
            raise OSError(str(error)) from error


def join(address: str) -> None:
    """Make this machine a node of a cluster, if it is none. It has no cores, so nothing is placed here.

    The node outlives a driver that is killed, and the next driver uses it. Raises JoinError.
    """
    if _is_node(address):
        return
    options = ["--num-cpus=0", "--num-gpus=0", f"--object-store-memory={_OBJECT_STORE}", "--disable-usage-stats"]
    command = [sys.executable, "-m", "ray.scripts.scripts", "start", f"--address={address}", *options]
    done = subprocess.run(  # noqa: S603 - Ray's own program
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    if done.returncode:
        raise JoinError(f"this machine could not join the cluster: {done.stdout.strip().splitlines()[-1]}")


def _is_node(address: str) -> bool:
    """Return whether this machine runs a node that was started with this address. Ray leaves helpers of dead ones."""
    for process in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            program, *arguments = process.read_bytes().split(b"\0")
            if program.endswith(b"/raylet") and f"--gcs-address={address}".encode() in arguments:
                return True
    return False


def connect(address: str) -> tuple[str, str]:
    """Connect this process; return the addresses of the head and of this machine. Raises what Ray raises."""
    import ray  # noqa: PLC0415

    context = ray.init(address=address, log_to_driver=False, logging_level=logging.WARNING, namespace="wrongturn")
    return str(context.address_info["gcs_address"]), str(ray.util.get_node_ip_address())


def main() -> None:
    """Drive the cluster whose address the command line names."""
    out = os.dup(1)
    os.dup2(2, 1)  # what Ray prints must not mix with our lines
    try:
        check_answer(sys.argv[1])
        if "--join" in sys.argv:
            join(sys.argv[1])
        head, own = connect(sys.argv[1])
    except Exception as error:
        cause = f" ({error.__cause__})" if error.__cause__ is not None else ""
        why = f"cannot connect to Ray at {sys.argv[1]}: {error}{cause}"
        Driver(out, "").say("trouble", why=why)
        sys.exit(1)
    driver = Driver(out, head)
    driver.say("connected", address=own)
    asyncio.run(driver.serve())


if __name__ == "__main__":
    main()
