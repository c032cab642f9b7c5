"""Processes that somebody starts again whenever they end, as an operator's supervisor and an agent's owner would."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import httpx
import psutil
from nginx_program import free_port

_AGAIN_S, _AFTER_FAILURE_S = 0.3, 2.0


def children(pid: int) -> list[int]:
    """Process ids."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return sorted(child.pid for child in psutil.Process(pid).children())
    return []


class Kept:
    """A process that is started again when it ends."""

    def __init__(self, command: list[str], log: Path, environment: dict[str, str]) -> None:
        self._command = command
        self._log = log
        self._environment = {n: v for n, v in os.environ.items() if not n.startswith("WRONGTURN_")}
        if "WRONGTURN_HOME" in os.environ:
            self._environment["WRONGTURN_HOME"] = os.environ["WRONGTURN_HOME"]
        self._environment |= environment
        self._process: subprocess.Popen[bytes] | None = None
        self._stopping = threading.Event()
        self._back_s = _AGAIN_S
        self._thread = threading.Thread(target=self._keep, daemon=True)

    def start(self) -> None:
        self._thread.start()

    @property
    def pid(self) -> int | None:
        process = self._process
        return process.pid if process is not None and process.poll() is None else None

    def kill(self, back_s: float = _AGAIN_S) -> bool:
        """Kill -9, to be started again after some seconds; False where there was nothing to kill."""
        process = self._process
        if process is None or process.poll() is not None:
            return False
        self._back_s = back_s
        process.kill()
        process.wait()
        return process.returncode == -signal.SIGKILL

    def wait(self, timeout_s: float) -> bool:
        """Until it has ended with status 0; False where it has not by then."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def stop(self) -> int:
        """End it for good by SIGTERM; its status."""
        self._stopping.set()
        while self._thread.is_alive():
            if self.pid is not None and self._process is not None:
                self._process.terminate()
            # Its handlers are gone for the last moment of its end, when another signal would be its status.
            self._thread.join(60.0)
        return self._process.returncode if self._process is not None else 0

    def _keep(self) -> None:
        while not self._stopping.is_set():
            with self._log.open("ab") as log:
                self._process = subprocess.Popen(
                    self._command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=self._environment
                )
            status = self._process.wait()
            if status == 0:
                return
            if status != -signal.SIGKILL and not self._stopping.is_set():
                self._back_s = _AFTER_FAILURE_S
            self._stopping.wait(self._back_s)
            self._back_s = _AGAIN_S


class Service(Kept):
    """``wrongturn serve`` on a port of its own that stays the same."""

    def __init__(self, database: str, log: Path, **settings: object) -> None:
        port = free_port()
        self.url = f"http://127.0.0.1:{port}"
        self.kills: list[float] = []
        self._http = httpx.Client(timeout=5.0)
        self._replays: dict[int, float] = {}
        self._counting = threading.Thread(target=self._count, daemon=True)
        command = [sys.executable, "-m", "wrongturn_client", "serve", "--port", str(port), "--database", database]
        super().__init__(command, log, {f"WRONGTURN_{name.upper()}": str(value) for name, value in settings.items()})

    def await_ready(self, timeout_s: float = 240.0) -> None:
        until(lambda: self._get("/health/ready") is not None, timeout_s, "the service is not ready")

    def start(self) -> None:
        super().start()
        self._counting.start()

    @property
    def replays(self) -> int:
        """Episodes that were brought back in another simulator, as far as it could be asked before it was killed."""
        return int(sum(self._replays.values()))

    def driven(self) -> bool:
        """Whether episodes are open."""
        return self._figure("wrongturn_open_episodes") > 0

    def kill(self, back_s: float = _AGAIN_S) -> bool:
        when = time.time()
        killed = super().kill(back_s)
        if killed:
            self.kills.append(when)
        return killed

    def simulators(self) -> list[int]:
        return [] if self.pid is None else children(self.pid)

    def stop(self) -> int:
        status = super().stop()
        self._counting.join()
        self._http.close()
        return status

    def _count(self) -> None:
        while not self._stopping.wait(1.0):
            pid = self.pid
            replays = self._figure("wrongturn_replays_total")
            if pid is not None and pid == self.pid:
                self._replays[pid] = replays

    def _figure(self, name: str) -> float:
        lines = (self._get("/metrics") or "").splitlines()
        return next((float(line.split()[1]) for line in lines if line.startswith(f"{name} ")), 0.0)

    def _get(self, path: str) -> str | None:
        with contextlib.suppress(httpx.HTTPError):
            response = self._http.get(self.url + path)
            return response.text if response.is_success else None
        return None


def until(condition: Callable[[], bool], timeout_s: float, message: str) -> None:
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, f"{message} after {timeout_s:.0f} s"
        time.sleep(0.1)
