"""A service of one's own for as long as a ``with`` block lasts."""

import contextlib
import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self

from wrongturn_client.errors import LocalServiceError

READY: Final = "Wrongturn is ready at "
"""How the line begins by which ``wrongturn serve`` tells its URL."""
_TAIL: Final = 15
"""Lines of the service's stderr that an error shows."""


class LocalService:
    """Runs ``wrongturn serve`` on a loopback port in a process of its own.

    The service's package has to be installed, but is not imported here.

    Example:
        >>> with LocalService() as service:  # doctest: +SKIP
        ...     Client(service.url).suites()
    """

    def __init__(
        self,
        *,
        database: str | None = None,
        port: int = 0,
        environment: Mapping[str, str] | None = None,
        log: Path | None = None,
        start_timeout: float = 180.0,
        stop_timeout: float = 20.0,
    ) -> None:
        """Describe the service; entering the context starts it.

        Args:
            database: SQLAlchemy's URL; the service's own default where None.
            port: 0 takes a free one.
            environment: added to this process's environment.
            log: a file that gets the service's stderr.
            start_timeout: seconds until it must be ready; the first start on a machine compiles its arithmetic.
            stop_timeout: seconds that it gets for a clean stop.
        """
        self.url = ""
        """Where the service answers, once started."""
        self._database = database
        self._port = port
        self._environment = dict(environment or {})
        self._log = log
        self._start_timeout = start_timeout
        self._stop_timeout = stop_timeout
        self._process: subprocess.Popen[str] | None = None
        self._tail: deque[str] = deque(maxlen=_TAIL)
        self._ready = threading.Event()
        self._readers: list[threading.Thread] = []

    @property
    def pid(self) -> int:
        """The process's number.

        Raises:
            LocalServiceError: it is not running.
        """
        if self._process is None:
            raise LocalServiceError("the service is not running; use LocalService in a with block")
        return self._process.pid

    def __enter__(self) -> Self:
        """Start the service and wait until it is ready.

        Raises:
            LocalServiceError: it ended, or was not ready in time; shows the last lines that it wrote to stderr.
        """
        command = [sys.executable, "-m", "wrongturn_client", "serve", "--host", "127.0.0.1", "--port", str(self._port)]
        if self._database is not None:
            command += ["--database", self._database]
        # A process group of its own: Ctrl-C reaches this process alone, which then stops the service in good order.
        self._process = subprocess.Popen(  # noqa: S603 - our own program
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env={**os.environ, **self._environment},
            process_group=0,
        )
        for read, stream in ((self._read_stdout, self._process.stdout), (self._read_stderr, self._process.stderr)):
            thread = threading.Thread(target=read, args=(stream,), daemon=True)
            thread.start()
            self._readers.append(thread)
        try:
            in_time = self._ready.wait(self._start_timeout)
        except BaseException:
            self.stop()
            raise
        if not self.url:
            ended = in_time and self._ended()
            self.stop()
            what = (
                f"ended with status {self._process.returncode} before it was ready"
                if ended
                else f"was not ready within {self._start_timeout:.0f} s"
            )
            tail = "".join(f"\n  {line}" for line in self._tail)
            raise LocalServiceError(
                f"'wrongturn serve' {what}; " + (f"it last said:{tail}" if tail else "it said nothing on stderr"),
            )
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Stop the service."""
        self.stop()

    def stop(self) -> None:
        """End the service by SIGTERM, and by SIGKILL where it does not heed that; again is no harm."""
        if self._process is None:
            return
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(self._stop_timeout)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        for thread in self._readers:
            thread.join(timeout=2.0)
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def _ended(self) -> bool:
        """Whether a process that has closed its stdout ends by itself."""
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(self._stop_timeout)
        return self._process.returncode is not None

    def _read_stdout(self, stream: IO[str]) -> None:
        for line in stream:
            if line.startswith(READY) and not self.url:
                self.url = line.removeprefix(READY).strip().rstrip("/")
                self._ready.set()
        self._ready.set()  # the end of the output: the process is gone, or never will be ready

    def _read_stderr(self, stream: IO[str]) -> None:
        log = self._log.open("a", encoding="utf-8") if self._log is not None else None
        try:
            for line in stream:
                self._tail.append(line.rstrip())
                if log is not None:
                    log.write(line)
                    log.flush()
        finally:
            if log is not None:
                log.close()
