"""Structured logs: one JSON object per line on stderr. Stdout has only the line that the service is ready."""

import itertools
import logging
import secrets
import sys
import time
from collections.abc import Callable
from typing import Final

import structlog

_START: Final = secrets.token_hex(4)
_numbers = itertools.count(1)
_SUBJECTS: Final = {"evaluations": "evaluation", "episodes": "episode", "submissions": "submission"}
_LONGEST: Final = 64


def begin_request(path: str = "") -> str:
    """Add a new request id, and the episode, evaluation or submission of its path, to all log lines that follow.

    The id is a random prefix of this start, and a number.
    """
    request_id = f"{_START}-{next(_numbers)}"
    structlog.contextvars.clear_contextvars()
    parts = path.split("/", 4)
    subject = _SUBJECTS.get(parts[2]) if len(parts) > 3 else None
    about = {} if subject is None else {subject: parts[3][:_LONGEST]}
    structlog.contextvars.bind_contextvars(request=request_id, **about)
    return request_id


class LogThrottle:
    """Lets one log line of a kind through in so many seconds, of events that strangers can cause without end."""

    def __init__(self, seconds: float = 10.0, clock: Callable[[], float] = time.monotonic) -> None:
        self._seconds = seconds
        self._clock = clock
        self._quiet: dict[object, tuple[float, int]] = {}
        """For each kind until when nothing is logged, and how many were not logged since."""

    def others(self, kind: object) -> int | None:
        """Return how many of a kind were not logged since the last that was; None if this one is not logged either.

        There have to be few kinds: each takes memory for good.
        """
        now = self._clock()
        until, unsaid = self._quiet.get(kind, (now, 0))
        if now < until:
            self._quiet[kind] = until, unsaid + 1
            return None
        self._quiet[kind] = now + self._seconds, 0
        return unsaid


_LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


def configure(level: str) -> None:
    """Configure structlog, and send the standard library's logs to the same stream."""
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        # Without local variables: they include requests, and so tokens.
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
        )
    )
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)
