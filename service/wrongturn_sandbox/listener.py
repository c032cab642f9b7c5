"""Holds the guests of a runner container: a fresh process for each connection, which ends with it."""

import contextlib
import errno
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Final, NoReturn

from wrongturn_sandbox.bubblewrap import EXPENDABLE, environment
from wrongturn_sandbox.frames import packed, send

GUEST: Final = (sys.executable, "-s", "-P", "-m", "wrongturn_sandbox", "--guest")
"""Command line of a guest, without its file descriptor."""
_MODE: Final = 0o660
_LEAVING_S: Final = 1.0
"""Seconds in which a guest whose host has left makes room for another."""
_LOG: Final = logging.getLogger(__name__)


class Listener:
    """Accepts hosts on a Unix socket and starts a guest for each."""

    def __init__(self, path: Path, most: int, command: Sequence[str] = GUEST) -> None:
        """Listen at a socket to which its owner and group may connect, for ``most`` guests at a time.

        Raises OSError if the socket cannot be made, or another listener uses it.
        """
        self._path = path
        self._most = most
        self._command = command
        self._free = threading.Semaphore(most)
        self._socket = _listen(path)

    def run(self) -> None:
        """Serve until SIGTERM or SIGINT comes, then remove the socket. The guests end with their threads."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, _stop)
        _LOG.info("listening at %s for at most %d sandboxes", self._path, self._most)
        try:
            while True:
                try:
                    connection, _ = self._socket.accept()
                except OSError as error:
                    _LOG.warning("cannot accept: %s", error)
                    time.sleep(0.1)
                    continue
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()
        finally:
            self._socket.close()
            self._path.unlink(missing_ok=True)

    def _serve(self, connection: socket.socket) -> None:
        with connection:
            if not self._free.acquire(timeout=_LEAVING_S):
                _tell(connection, {"busy": f"all {self._most} sandboxes of the runner container are taken"})
                return
            try:
                last_word = self._hold_guest(connection)
            finally:
                self._free.release()
            _tell(connection, last_word)

    def _hold_guest(self, connection: socket.socket) -> dict[str, object]:
        """Start a guest, and end it when its host leaves. Return what the host is told at the end."""
        try:
            process = subprocess.Popen(  # noqa: S603 - the command is our own
                [*EXPENDABLE, *self._command, str(connection.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(connection.fileno(),),
                env=environment(),
                cwd="/",
            )
        except OSError as error:
            _LOG.warning("cannot start a guest: %s", error)
            return {"unavailable": "the runner container cannot start a process; look at its log"}
        ended = os.pidfd_open(process.pid)
        try:
            watch = select.poll()
            watch.register(ended, select.POLLIN)
            watch.register(connection, select.POLLRDHUP)
            watch.poll()
        finally:
            os.close(ended)
        process.kill()
        return {"ended": process.wait()}


def _stop(_number: int, _frame: FrameType | None) -> NoReturn:
    raise SystemExit(0)


def _tell(connection: socket.socket, message: object) -> None:
    connection.setblocking(False)
    with contextlib.suppress(OSError):  # a host that has left need not know
        send(connection, packed(message))


def _listen(path: Path) -> socket.socket:
    """Return a socket that listens at a path, which appears only once it does."""
    _check_free(path)
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    new = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        before = os.umask(0o777 & ~_MODE)
        try:
            listening.bind(str(new))
        finally:
            os.umask(before)
        listening.listen(64)
        new.rename(path)
    except BaseException:
        listening.close()
        new.unlink(missing_ok=True)
        raise
    return listening


def _check_free(path: Path) -> None:
    """Check that nothing is at a path but a socket on which nobody listens any more. Raises FileExistsError."""
    if not path.exists():
        return
    if not path.is_socket():
        raise FileExistsError(errno.EEXIST, "another file is there")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as attempt:
        try:
            attempt.connect(str(path))
        except OSError:
            return
    raise FileExistsError(errno.EADDRINUSE, "another listener is there")
