"""A Ray cluster of several nodes on this machine, each a ``ray start`` that is started again when it ends."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Self

import psutil

# A head that comes back is a new one, unless it has a Redis. Its nodes have to end before they can join it.
ENVIRONMENT = {"RAY_AUTH_MODE": "disabled", "RAY_worker_niceness": "0", "RAY_gcs_rpc_server_reconnect_timeout_s": "8"}
_BACK_S = 1.0
_SHARED = ("--min-worker-port", "0", "--max-worker-port", "0", "--object-store-memory", "100000000", "--block")


class Nodes:
    """A head without cores, and workers with one each. Use it as a context."""

    def __init__(self, workers: int = 2, cores: int = 1) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.address = f"127.0.0.1:{probe.getsockname()[1]}"
        # A short path, for Ray's sockets.
        self._folder = Path(tempfile.mkdtemp(prefix="wr-", dir="/tmp"))
        self.environment = {**ENVIRONMENT, "RAY_TMPDIR": str(self._folder)}
        head = ("--head", "--port", self.address.split(":")[1], "--num-cpus", "0", "--include-dashboard", "false")
        worker = ("--address", self.address, "--num-cpus", str(cores))
        self._commands = [head, *[worker] * workers]
        self._processes: list[subprocess.Popen[bytes] | None] = [None] * (workers + 1)
        self._stopping = threading.Event()
        self._keeping = threading.Thread(target=self._keep, daemon=True)

    def __enter__(self) -> Self:
        self._keeping.start()
        return self

    def __exit__(self, *_: type[BaseException] | BaseException | TracebackType | None) -> None:
        self._stopping.set()
        self._keeping.join()
        for number, process in enumerate(self._processes):
            self.kill(number)
            if process is not None:
                process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def workers(self) -> range:
        """The numbers of the nodes that programs run on; 0 is the head."""
        return range(1, len(self._commands))

    def kill(self, number: int) -> list[int]:
        """Kill a node with all that runs on it; return the processes."""
        found = self._tree(number)
        for process in found:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.send_signal(signal.SIGSTOP)  # nobody may see the others die
        for process in found:
            with contextlib.suppress(psutil.NoSuchProcess):
                process.kill()
        return [process.pid for process in found]

    def kill_raylet(self, number: int) -> bool:
        """Kill a node's raylet alone; return whether there was one."""
        return self.kill_one(self._named(number, "raylet"))

    def simulators(self, number: int) -> list[psutil.Process]:
        """Return the simulators on a node."""
        return self._named(number, "wrongturn_ray.serve")

    @staticmethod
    def children(pid: int) -> list[psutil.Process]:
        """Return the processes that another one has started."""
        with contextlib.suppress(psutil.NoSuchProcess):
            return psutil.Process(pid).children()
        return []

    def _named(self, number: int, name: str) -> list[psutil.Process]:
        found = []
        for process in self._tree(number):
            with contextlib.suppress(psutil.NoSuchProcess):
                words = process.cmdline()
                if words and (name in words or Path(words[0]).name == name):
                    found.append(process)
        return found

    @staticmethod
    def kill_one(found: list[psutil.Process]) -> bool:
        """Kill the first process of a list; return whether there was one."""
        with contextlib.suppress(psutil.NoSuchProcess):
            for process in found:
                process.kill()
                return True
        return False

    def _tree(self, number: int) -> list[psutil.Process]:
        process = self._processes[number]
        if process is None:
            return []
        with contextlib.suppress(psutil.NoSuchProcess):
            root = psutil.Process(process.pid)
            return [root, *root.children(recursive=True)]
        return []

    def _keep(self) -> None:
        while not self._stopping.is_set():
            for number, process in enumerate(self._processes):
                ended = process is None or process.poll() is not None
                if ended and (number == 0 or self._listening()):
                    self._start(number)
            self._stopping.wait(_BACK_S)

    def _listening(self) -> bool:
        host, port = self.address.split(":")
        with contextlib.suppress(OSError), socket.create_connection((host, int(port)), 1):
            return True
        return False

    def _start(self, number: int) -> None:
        with (self._folder / f"node-{number}.log").open("ab") as log:
            log.write(f"{time.ctime()}\n".encode())
            self._processes[number] = subprocess.Popen(
                [str(Path(sys.executable).with_name("ray")), "start", *self._commands[number], *_SHARED],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, **self.environment},
            )
