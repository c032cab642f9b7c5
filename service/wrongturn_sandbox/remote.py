"""A guest in a runner container, reached over its Unix socket."""

import socket
from pathlib import Path

from wrongturn_sandbox.errors import SandboxUnavailableError


class Remote:
    """A guest behind a listener's socket. It ends with the connection.

    Raises:
        SandboxUnavailableError: Nobody listens there.
    """

    def __init__(self, path: Path) -> None:
        self.connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.pid: int | None = None
        self._path = path
        try:
            self.connection.settimeout(5)
            self.connection.connect(str(path))
        except OSError as error:
            self.connection.close()
            raise SandboxUnavailableError(
                f"the runner container cannot be reached at {path} ({error.strerror or error}); start it, and check "
                "that service and container share the socket's volume and its group",
            ) from None

    def why_not(self) -> str:
        """Return why the guest did not start, for an operator."""
        self.kill()
        return f"the runner container at {self._path} closed the connection at once; look at its log"

    def status(self) -> int | None:
        """Return None: nobody said how the guest ended."""
        return None

    def kill(self) -> None:
        """End the guest now: the listener does so when the connection is closed."""
        self.connection.close()

    def close(self) -> None:
        """End the guest."""
        self.kill()
