"""The program inside a sandbox: takes a model, then observations, and answers with the model's outputs."""

import os
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from wrongturn_sandbox.confinement import confine, end_with_parent, limit_memory, limit_processor_time
from wrongturn_sandbox.errors import ModelRefusedError
from wrongturn_sandbox.frames import CALL_MOST, MODEL_MOST, VERSION, packed, receive, send, unpacked
from wrongturn_sandbox.messages import Limits, pack_arrays, pack_description, read_arrays
from wrongturn_sandbox.reasons import out_of_memory, printable

if TYPE_CHECKING:
    from wrongturn_sandbox.session import Session


def serve(descriptor: int) -> None:
    """Serve the host at the other end of a socket, given by its file descriptor, then end this process."""
    end_with_parent()
    connection = socket.socket(fileno=descriptor)
    content = receive(connection, CALL_MOST)
    if content is not None:
        begin(connection, unpacked(content))
    os._exit(0)  # leave no time to what a model may have left in this process


def begin(connection: socket.socket, said: dict[str, Any]) -> None:
    """Load the runtime, give up all rights, say that this guest is ready, and answer calls."""
    if said.get("begin") != VERSION:
        words = f"host and guest speak versions {said.get('begin')} and {VERSION}; install the same version for both"
        send(connection, packed({"unavailable": words}))
        return
    limits = Limits(said["memory"], said["load_s"], said["step_s"])
    try:
        from wrongturn_sandbox import session  # noqa: PLC0415 - slow, and not needed for the above

        session.warm_up()
        _close_all_but(connection.fileno())
        confine()
        limit_memory(limits.memory)
    except Exception as error:
        send(connection, packed({"unavailable": printable(f"{type(error).__name__}: {error}")}))
        return
    send(connection, packed({"ready": VERSION, "runtime": session.RUNTIME}))
    _Guest(connection, limits, session.Session).answer_calls()


class _Guest:
    """Answers the host's calls. It trusts the host."""

    def __init__(self, connection: socket.socket, limits: Limits, open_session: type["Session"]) -> None:
        self._connection = connection
        self._limits = limits
        self._open_session = open_session
        self._session: Session

    def answer_calls(self) -> None:
        """Answer calls until the host closes the connection."""
        while (content := receive(self._connection, CALL_MOST)) is not None:
            call = unpacked(content)
            if "load" in call:
                model = receive(self._connection, MODEL_MOST)
                if model is None:
                    return
                reply = self._blamed(self._limits.load_s, self._load, model)
            else:
                reply = self._blamed(self._limits.step_s, self._run, call["run"])
            send(self._connection, packed(reply))

    def _load(self, content: bytearray) -> dict[str, Any]:
        self._session = self._open_session(content, self._limits)
        return {"description": pack_description(self._session.description)}

    def _run(self, inputs: Any) -> dict[str, Any]:
        return {"outputs": pack_arrays(self._session.run(read_arrays(inputs)))}

    def _blamed(self, seconds: float, call: Callable[[Any], dict[str, Any]], argument: Any) -> dict[str, Any]:
        limit_processor_time(seconds)
        try:
            return call(argument)
        except ModelRefusedError as error:
            return {"refused": printable(error.reason)}
        except MemoryError:
            return {"refused": out_of_memory(self._limits)}


def _close_all_but(kept: int) -> None:
    """Make a socket the only way out. The host gives ``/dev/null`` as stdin."""
    os.dup2(0, 1)
    os.dup2(0, 2)
    os.closerange(3, kept)
    os.closerange(kept + 1, 1 << 16)
