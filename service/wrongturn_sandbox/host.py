"""The trusted side of a sandbox: opens one, hands it a model and observations, and distrusts what it says."""

import contextlib
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, NoReturn, TypeVar

from numpy.typing import NDArray

from wrongturn_sandbox import bubblewrap, frames, reasons
from wrongturn_sandbox.bubblewrap import Bubblewrap
from wrongturn_sandbox.errors import ModelRefusedError, SandboxBusyError, SandboxLostError, SandboxUnavailableError
from wrongturn_sandbox.frames import MODEL_MOST, REPLY_MOST, VERSION, CutOffError, DeadlineError, FrameError
from wrongturn_sandbox.messages import Description, Limits, pack_arrays, read_arrays, read_description, read_reply

_T = TypeVar("_T")
_Bytes = bytes | bytearray | memoryview
START_S: Final = 60.0
"""Seconds that a sandbox may take to start. It takes half a second on a quiet machine."""


class Remote:
    """A guest behind a listener's socket. Raises SandboxUnavailableError if nobody listens there."""

    def __init__(self, path: Path) -> None:
        self.connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._path = path
        try:
            self.connection.settimeout(5)
            self.connection.connect(str(path))
        except OSError as error:
            self.connection.close()
            raise SandboxUnavailableError(
                f"the runner container cannot be reached at {path} ({error.strerror or error}); start it, and check "
                "that service and container share the socket's volume and its group"
            ) from None

    def why_not(self) -> str:
        """End the guest, and return why it did not start, for an operator."""
        self.close()
        return f"the runner container at {self._path} closed the connection at once; look at its log"

    def status(self) -> int | None:
        """Return None: nobody said how the guest ended."""
        return None

    def close(self) -> None:
        """End the guest now: the listener does so when the connection is closed."""
        self.connection.close()


class Sandbox(contextlib.AbstractContextManager["Sandbox", None]):
    """One model in a sandbox. Open it by :func:`open_sandbox`, use it as a context manager.

    After any error the sandbox is closed. It belongs to the thread that opened it: a guest under bubblewrap ends when
    that thread ends.
    """

    def __init__(self, guest: Bubblewrap | Remote, limits: Limits) -> None:
        self._guest = guest
        self._limits = limits
        self.runtime = ""
        """Names and versions of the guest's libraries: ``onnxruntime 1.31.1, onnx 1.23.2``."""

    def load(self, model: bytes | bytearray | memoryview) -> Description:
        """Check and load a model's file. Call it once. Raises ModelRefusedError, SandboxLostError."""
        if len(model) > MODEL_MOST:
            raise self._refused(f"the file has {len(model)} bytes; at most {MODEL_MOST} are allowed")
        parts = (frames.packed({"load": len(model)}), model)
        late = f"the model took longer than {self._limits.load_s:g} s to load; make it smaller or simpler"
        return self._call(parts, "description", read_description, self._limits.load_s, late)

    def run(self, inputs: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Return the model's outputs for one step's inputs, by name. Each array has the batch axis.

        Raises ModelRefusedError, SandboxLostError, and ValueError if an input's type does not go into a sandbox.
        """
        call = frames.packed({"run": pack_arrays(inputs)})
        late = f"a step of the model took longer than {self._limits.step_s:g} s; make it smaller or simpler"
        return self._call((call,), "outputs", read_arrays, self._limits.step_s, late)

    def close(self) -> None:
        """End the sandbox. Safe to call more than once."""
        self._guest.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def begin(self) -> None:
        """Tell the guest its limits, and wait until it is ready. Raises SandboxUnavailableError."""
        begin = {"begin": VERSION, **asdict(self._limits)}
        try:
            kind, said = self._exchange((frames.packed(begin),), time.monotonic() + START_S)
        except DeadlineError:
            raise SandboxUnavailableError(f"the sandbox did not start within {START_S:g} s") from None
        except FrameError:
            kind, said = "nonsense", None
        if kind == "busy":
            raise SandboxBusyError(reasons.printable(said))
        if kind == "unavailable":
            raise SandboxUnavailableError(f"the sandbox does not start: {reasons.printable(said)}")
        if kind != "ready" or said.get("ready") != VERSION:
            raise SandboxUnavailableError(self._guest.why_not())
        self.runtime = reasons.printable(said.get("runtime"))

    def _call(
        self, parts: tuple[_Bytes, ...], wanted: str, read: Callable[[object], _T], seconds: float, late: str
    ) -> _T:
        if self._guest.connection.fileno() < 0:
            raise SandboxLostError("the sandbox is closed; open another one")
        try:
            kind, said = self._exchange(parts, time.monotonic() + seconds)
            if kind == wanted:
                return read(said)
        except DeadlineError:
            raise self._refused(late) from None
        except FrameError as error:
            raise self._refused(_nonsense(error)) from None
        if kind == "refused":
            raise self._refused(reasons.printable(said))
        if kind == "ended":
            self._ended(said)
        raise self._refused(_nonsense(f"{kind} instead of {wanted}"))

    def _exchange(self, parts: tuple[_Bytes, ...], deadline: float) -> tuple[str, Any]:
        """Send frames and return the reply, "ended" if there is none. Raises DeadlineError, FrameError."""
        connection = self._guest.connection
        try:
            with contextlib.suppress(OSError):  # the guest has ended, and its listener may have said how
                for part in parts:
                    frames.send(connection, part, deadline)
            content = frames.receive(connection, REPLY_MOST, deadline)
        except (OSError, CutOffError):
            content = None
        return ("ended", None) if content is None else read_reply(frames.unpacked(content))

    def _ended(self, said: object) -> NoReturn:
        status = said if type(said) is int else self._guest.status()
        self.close()
        why = reasons.ending(status, self._limits)
        if why is None:
            raise SandboxLostError("the sandbox was ended from outside")
        raise ModelRefusedError(why)

    def _refused(self, reason: str) -> ModelRefusedError:
        self.close()
        return ModelRefusedError(reason)


def open_sandbox(path: Path | None, limits: Limits) -> Sandbox:
    """Open a sandbox that is ready to take a model.

    ``path`` is the Unix socket of a runner container, or None for bubblewrap on this machine. Raises SandboxBusyError,
    SandboxUnavailableError.
    """
    sandbox = Sandbox(Bubblewrap(gpu=limits.gpu) if path is None else Remote(path), limits)
    try:
        sandbox.begin()
    except BaseException:
        sandbox.close()
        raise
    return sandbox


def probe(path: Path | None, *, gpu: bool = False) -> str:
    """Open a sandbox as :func:`open_sandbox`, close it, and return what it is: ``bubblewrap 0.8.0 (…)``.

    A container whose sandboxes are all taken works, and says so.
    """
    try:
        with open_sandbox(path, Limits(memory=1 << 28, gpu=gpu)) as sandbox:
            name = bubblewrap.version() if path is None else "runner container"
            return f"{name} ({sandbox.runtime})"
    except SandboxBusyError as error:
        return f"runner container ({error})"


def _nonsense(error: object) -> str:
    return f"the sandbox gave an answer that does not follow its protocol ({reasons.printable(str(error))})"
