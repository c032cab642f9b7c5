"""Structured logs: one JSON object a line on stderr, so that stdout is free for the ready line."""

import itertools
import logging
import secrets
import sys
from typing import Final

import structlog

_START: Final = secrets.token_hex(4)
_numbers = itertools.count(1)
_SUBJECTS: Final = {"evaluations": "evaluation", "episodes": "episode"}
_LONGEST: Final = 64


def begin_request(path: str = "") -> str:
    """Let what is logged from here on carry a new request's id, and the episode or evaluation that its path names.

    Args:
        path: of the request; ``/v1/episodes/{id}/…`` and ``/v1/evaluations/{id}/…`` name something.

    Returns:
        The request's id: the service's start and a number.
    """
    request_id = f"{_START}-{next(_numbers)}"
    structlog.contextvars.clear_contextvars()
    parts = path.split("/", 4)
    subject = _SUBJECTS.get(parts[2]) if len(parts) > 3 else None
    about = {} if subject is None else {subject: parts[3][:_LONGEST]}
    structlog.contextvars.bind_contextvars(request=request_id, **about)
    return request_id


_LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


def configure(level: str) -> None:
    """Set structlog up for this process, and let the standard library's loggers end in the same stream.

    Args:
        level: the least level that is logged: ``debug``, ``info``, ``warning`` or ``error``.
    """
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        # Without the frames' locals: requests are among them, and with those their tokens.
        structlog.processors.ExceptionRenderer(structlog.tracebacks.ExceptionDictTransformer(show_locals=False)),
    ]
    structlog.configure(
        processors=[*shared, structlog.processors.JSONRenderer()],
        wrapper_class=structlog.make_filtering_bound_logger(_LEVELS[level]),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
        cache_logger_on_first_use=False,
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                structlog.processors.JSONRenderer(),
            ],
        ),
    )
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
