"""A local service that runs as long as a ``with`` block, or until it is stopped."""

import atexit
import contextlib
import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Final, Self

from wrongturn_client.errors import LocalServiceError
from wrongturn_client.settings import OPERATOR_TOKEN

READY: Final = "Wrongturn is ready at "
"""Begin of the line in which ``wrongturn serve`` prints its URL."""
ENDS_WITH_PARENT: Final = "WRONGTURN_ENDS_WITH_PARENT"
"""Environment variable that tells ``wrongturn serve`` to stop at the end of its stdin, a pipe from its parent."""
_COMPILING: Final = "wrongturn: compiling"
_START_S: Final = 180.0
"""Seconds until it must be ready. The first start on a machine compiles code and takes longer."""
_STOP_S: Final = 20.0
"""Seconds for a clean stop."""
_TAIL: Final = 15
"""Number of lines of the service's stderr in an error."""
FOR_ONE_COMMAND: Final = {
    f"{OPERATOR_TOKEN}_FILE": "",
    "WRONGTURN_DATABASE_PASSWORD_FILE": "",
    "WRONGTURN_METRICS_PORT": "",
    "WRONGTURN_REGISTRATION": "open",
    "WRONGTURN_SUBMISSIONS": "0",
}
"""Settings of a service that a command starts for itself, in place of those that are meant for a service that stays."""


class LocalService:
    """Runs ``wrongturn serve`` on a loopback port in its own process.

    The package ``wrongturn-service`` must be installed, but is not imported here.

    Example:
        >>> with LocalService() as service:  # doctest: +SKIP
        ...     Client(service.url).suites()

    In a notebook, where one cell starts it and others use it:
        >>> service = LocalService().start()  # doctest: +SKIP
        >>> service.stop()  # doctest: +SKIP
    """

    def __init__(
        self,
        *,
        database: str | None = None,
        port: int = 0,
        environment: Mapping[str, str] | None = None,
        log: Path | None = None,
    ) -> None:
        """Store the settings; ``start``, or entering a ``with`` block, starts the service.

        ``database`` is an SQLAlchemy URL, by default the service's own; port 0 is a free one. ``environment`` is added
        to that of this process; ``log`` is a file for the service's stderr.
        """
        self.url = ""
        """The service's URL, once it is started."""
        self._command = [sys.executable, "-m", "wrongturn_client", "serve", "--host", "127.0.0.1", "--port", str(port)]
        if database is not None:
            self._command += ["--database", database]
        self._environment = dict(environment or {})
        self._log = log
        self._process: subprocess.Popen[str] | None = None
        self._tail: deque[str] = deque(maxlen=_TAIL)
        self._ready = threading.Event()
        self._readers: list[threading.Thread] = []

    @property
    def pid(self) -> int:
        """Id of the service's process.

        Raises:
            LocalServiceError: The service is not running.
        """
        if self._process is None:
            raise LocalServiceError("the service is not running; use LocalService in a with block, or call start")
        return self._process.pid

    def __enter__(self) -> Self:
        """Start the service and wait until it is ready; raises as :meth:`start`."""
        return self.start()

    def start(self) -> Self:
        """Start the service, wait until it is ready, and return this object.

        It runs until :meth:`stop`, or until this process exits or is killed.

        Raises:
            LocalServiceError: It runs already. Or it ended, or was not ready in time; the error then shows its last
                lines on stderr.
        """
        if self._process is not None and self._process.poll() is None:
            raise LocalServiceError(f"the service runs already, at {self.url}; stop it first")
        self.url = ""
        self._ready.clear()
        self._tail.clear()
        # In its own process group, so that Ctrl-C reaches only this process, which then stops the service cleanly.
        self._process = process = subprocess.Popen(  # noqa: S603 - our own program
            self._command,
            stdin=subprocess.PIPE,  # nothing is written: its end tells the service that this process is gone
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env={**os.environ, **self._environment, ENDS_WITH_PARENT: "1"},
            process_group=0,
        )
        atexit.register(self.stop)
        both = ((self._read_stdout, process.stdout), (self._read_stderr, process.stderr))
        self._readers = [threading.Thread(target=read, args=(stream,), daemon=True) for read, stream in both]
        try:
            for reader in self._readers:
                reader.start()
            self._await_url(process)
        except BaseException:
            self.stop()
            raise
        return self

    def _await_url(self, process: subprocess.Popen[str]) -> None:
        what = f"was not ready within {_START_S:.0f} s"
        if self._ready.wait(_START_S) and not self.url:  # it has closed its stdout
            with contextlib.suppress(subprocess.TimeoutExpired):
                what = f"ended with status {process.wait(_STOP_S)} before it was ready"
        if not self.url:
            self.stop()  # first, so that all that it said is there
            tail = "".join(f"\n  {line}" for line in self._tail)
            said = f"it last said:{tail}" if tail else "it said nothing on stderr"
            raise LocalServiceError(f"'wrongturn serve' {what}; {said}")

    def __exit__(self, *_: object) -> None:
        """Stop the service."""
        self.stop()

    def stop(self) -> None:
        """Stop the service with SIGTERM, or with SIGKILL if that takes too long. Safe to call more than once."""
        atexit.unregister(self.stop)
        if self._process is None:
            return
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        for reader in self._readers:
            reader.join(timeout=2.0)
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def _read_stdout(self, stream: IO[str]) -> None:
        for line in stream:
            if line.startswith(READY) and not self.url:
                self.url = line.removeprefix(READY).strip().rstrip("/")
                self._ready.set()
        self._ready.set()  # after the last line: the process is gone, or will never be ready

    def _read_stderr(self, stream: IO[str]) -> None:
        with contextlib.nullcontext() if self._log is None else self._log.open("a", encoding="utf-8") as log:
            for line in stream:
                self._tail.append(line.rstrip())
                if line.startswith(_COMPILING):  # otherwise nothing would say why the first start takes minutes
                    sys.stderr.write(line)
                if log is not None:
                    log.write(line)
                    log.flush()
