"""The program inside a sandbox: takes a model, then observations, and answers with the model's outputs."""

import os
import socket
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from wrongturn_sandbox.confinement import confine, end_with_parent, limit_memory, limit_processor_time
from wrongturn_sandbox.errors import ModelRefusedError
from wrongturn_sandbox.frames import CALL_MOST, MODEL_MOST, VERSION, packed, receive, send, unpacked
from wrongturn_sandbox.messages import Limits, pack_arrays, read_arrays
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
    limits = Limits(said["memory"], said["load_s"], said["step_s"], said["life_s"], said.get("gpu", False))
    try:
        from wrongturn_sandbox import session  # noqa: PLC0415 - slow, and not needed for the above

        session.warm_up(gpu=limits.gpu)
        if not limits.gpu:  # its devices are open by now
            _close_all_but(connection.fileno())
        confine(gpu=limits.gpu, life_s=limits.life_s)
        limit_memory(limits.memory)
    except Exception as error:
        send(connection, packed({"unavailable": printable(f"{type(error).__name__}: {error}")}))
        return
    send(connection, packed({"ready": VERSION, "runtime": session.RUNTIME}))
    _answer_calls(connection, limits, session.Session)


def _answer_calls(connection: socket.socket, limits: Limits, open_session: type["Session"]) -> None:
    """Answer the host's calls until it closes the connection. The host is trusted."""
    while (content := receive(connection, CALL_MOST)) is not None:
        call = unpacked(content)
        model = receive(connection, MODEL_MOST) if "load" in call else None
        limit_processor_time(limits.step_s if model is None else limits.load_s)
        reply: dict[str, Any]
        try:
            if model is not None:
                session = open_session(model, limits)
                reply = {"description": asdict(session.description)}
            else:
                reply = {"outputs": pack_arrays(session.run(read_arrays(call["run"])))}
        except ModelRefusedError as error:
            reply = {"refused": printable(str(error))}
        except MemoryError:
            reply = {"refused": out_of_memory(limits)}
        send(connection, packed(reply))


def _close_all_but(kept: int) -> None:
    """Make a socket the only way out. The host gives ``/dev/null`` as stdin."""
    os.dup2(0, 1)
    os.dup2(0, 2)
    os.closerange(3, kept)
    os.closerange(kept + 1, 1 << 16)
