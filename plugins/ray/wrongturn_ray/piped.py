"""Runs a program on a node whose stdin and stdout are the service's: ``python -m wrongturn_ray.piped``.

The arguments are ``HOST:PORT``, where the service expects this process, and the arguments of Python for the program.
The program gets few of the node's variables. It is told by the end of its stdin that the service is gone.
"""

import contextlib
import os
import select
import socket
import ssl
import subprocess
import sys
from typing import Final

from wrongturn_ray.connecting import connect
from wrongturn_service.child_environment import NICE, child_environment

_PART: Final = 1 << 16
_GRACE_S: Final = 2.0
"""Seconds in which the program has to end after its stdin."""


def main() -> int:
    """Run the program that the command line names, and return its status."""
    address, *command = sys.argv[1:]
    os.nice(NICE)
    with connect(address) as service:
        ours, theirs = socket.socketpair()
        with theirs:
            # It inherits the files of this process's folder. Sockets are not inherited.
            process = subprocess.Popen(  # noqa: S603 - a program of ours
                [sys.executable, *command],
                stdin=theirs.fileno(),
                stdout=theirs.fileno(),
                env=child_environment(),
                close_fds=False,
            )
        with ours, contextlib.suppress(ConnectionError, TimeoutError):
            _carry(service, ours)
        try:
            status = process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            status = process.wait()
        return status if status >= 0 else 128 - status  # as a shell tells of signals


def _carry(service: socket.socket, program: socket.socket) -> None:
    """Carry what either side says to the other, until one of them ends."""
    while True:
        ready, _, _ = select.select([service, program], [], [])
        if program in ready:
            if not (data := program.recv(_PART)):
                return
            service.sendall(data)
        if service in ready:
            service.setblocking(False)  # under TLS there may be something to read, but nothing that was said
            try:
                if not (data := service.recv(_PART)):
                    return
            except (BlockingIOError, ssl.SSLWantReadError):
                continue
            finally:
                service.setblocking(True)
            program.sendall(data)


if __name__ == "__main__":
    sys.exit(main())
