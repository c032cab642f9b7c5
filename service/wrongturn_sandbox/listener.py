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
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Final, NoReturn

from wrongturn_sandbox.bubblewrap import environment
from wrongturn_sandbox.frames import packed, send

GUEST: Final = (sys.executable, "-s", "-P", "-m", "wrongturn_sandbox", "--guest")
"""Command line of a guest, without its file descriptor."""
_MODE: Final = 0o660
_LOG: Final = logging.getLogger(__name__)


@dataclass
class _Guest:
    process: subprocess.Popen[bytes]
    ended: int
    """File descriptor that can be read once the process has ended."""
    connection: socket.socket
    """Its host. Kept to notice when the host leaves, and to tell it how the guest ended."""
    leaving: bool = False
    """Whether its host has left, so that it ends in a moment."""


class Listener:
    """Accepts hosts on a Unix socket and starts a guest for each.

    Args:
        path: Where to make the socket. Its owner and group may connect.
        most: Guests at a time. One host more is told so and turned away.
        command: Command line of a guest; the file descriptor of its socket follows.

    Raises:
        OSError: The socket cannot be made, or another listener uses it.
    """

    def __init__(self, path: Path, most: int, command: Sequence[str] = GUEST) -> None:
        self._path = path
        self._most = most
        self._command = command
        self._guests: dict[int, _Guest] = {}
        self._poll = select.poll()
        self._socket = _listen(path)

    def run(self) -> None:
        """Serve until SIGTERM or SIGINT comes, then end all guests and remove the socket."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, _stop)
        self._poll.register(self._socket, select.POLLIN)
        _LOG.info("listening at %s for at most %d sandboxes", self._path, self._most)
        try:
            while True:
                ready = [descriptor for descriptor, _ in self._poll.poll()]
                for descriptor in ready:
                    self._attend(descriptor)
                if self._socket.fileno() in ready:
                    self._accept()
        finally:
            for guest in self._guests.values():
                guest.process.kill()
                guest.process.wait()
            self._socket.close()
            self._path.unlink(missing_ok=True)

    def _attend(self, descriptor: int) -> None:
        for guest in list(self._guests.values()):
            if descriptor == guest.ended:
                self._bury(guest)
            elif descriptor == guest.connection.fileno():
                self._poll.unregister(guest.connection)
                guest.leaving = True
                guest.process.kill()

    def _accept(self) -> None:
        if len(self._guests) >= self._most and any(guest.leaving for guest in self._guests.values()):
            self._poll.unregister(self._socket)  # the host waits for the place of one that leaves
            return
        try:
            connection, _ = self._socket.accept()
        except OSError as error:
            _LOG.warning("cannot accept: %s", error)
            time.sleep(0.1)
            return
        if len(self._guests) >= self._most:
            _tell(connection, {"busy": f"all {self._most} sandboxes of the runner container are taken"})
            connection.close()
            return
        try:
            process = subprocess.Popen(  # noqa: S603 - the command is our own
                [*self._command, str(connection.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(connection.fileno(),),
                env=environment(),
                cwd="/",
            )
        except OSError as error:
            _LOG.warning("cannot start a guest: %s", error)
            _tell(connection, {"unavailable": "the runner container cannot start a process; look at its log"})
            connection.close()
            return
        ended = os.pidfd_open(process.pid)
        self._guests[process.pid] = _Guest(process, ended, connection)
        self._poll.register(ended, select.POLLIN)
        self._poll.register(connection, select.POLLRDHUP)

    def _bury(self, guest: _Guest) -> None:
        del self._guests[guest.process.pid]
        status = guest.process.wait()
        self._poll.register(self._socket, select.POLLIN)
        self._poll.unregister(guest.ended)
        os.close(guest.ended)
        with contextlib.suppress(KeyError):
            self._poll.unregister(guest.connection)
        _tell(guest.connection, {"ended": status})
        guest.connection.close()


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
    """Check that nothing is at a path but a socket on which nobody listens any more.

    Raises:
        FileExistsError: Something else is there.
    """
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
