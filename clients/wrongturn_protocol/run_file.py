"""The file that ``wrongturn run --json`` writes: an evaluation with every episode."""

import errno
import gzip
import io
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Literal, Self

from pydantic import ValidationError

from wrongturn_protocol.accounts import AgentDetail
from wrongturn_protocol.catalogue import Sha256
from wrongturn_protocol.results import EpisodeResult, EvaluationDetail, Metrics
from wrongturn_protocol.vocabulary import EvaluationState

GZIP: Final = b"\x1f\x8b"
"""First bytes of a file that is compressed by gzip."""
LARGEST: Final = 1 << 30
"""Most bytes of a file, unpacked."""
UNREADABLE: Final = (OSError, EOFError, zlib.error)
"""Errors of :func:`read_unpacked`."""
_REMEDY: Final = "write it with 'wrongturn run --json FILE', or again with 'wrongturn run --resume ID --json FILE'"


class RunFormatError(ValueError):
    """A file of a run cannot be read, or is none. The text is one line for a user."""


def read_unpacked(path: Path) -> bytes:
    """Return the content of a file, plain or gzip; raise :data:`UNREADABLE`, also beyond :data:`LARGEST`."""
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if content.startswith(GZIP):
        # Not all at once: a small file may unpack to any size.
        with gzip.GzipFile(fileobj=io.BytesIO(content)) as packed:
            content = packed.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise OSError(errno.EFBIG, f"unpacked it has more than {LARGEST >> 20} MiB")
    return content


def reason_of(error: Exception) -> str:
    """Return in words why a file could not be read."""
    return (isinstance(error, OSError) and error.strerror) or str(error)


class DrivenEpisode(EpisodeResult):
    """A finished episode with its trajectory."""

    trajectory: dict[str, Any] | None = None
    """The trajectory as ``GET /v1/episodes/{id}/trajectory`` gives it. None for an episode that ended without one."""


class RunFile(EvaluationDetail):
    """A finished evaluation, its agent, and every episode. ``replay`` and ``results`` read it."""

    state: Literal[EvaluationState.FINISHED]
    metrics: Metrics
    suite_sha256: Sha256
    """Checksum of the suite, as the service has it."""
    driver: AgentDetail
    """The agent. Its id is ``agent``."""
    episodes: tuple[DrivenEpisode, ...]
    """The trials and twins, in the order in which they were driven."""

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a file, plain or compressed by gzip; raise RunFormatError if it is something else."""
        try:
            content = read_unpacked(path)
        except UNREADABLE as error:
            raise RunFormatError(f"{path}: cannot be read ({reason_of(error)}); {_REMEDY}") from error
        return cls.from_json(content, str(path))

    @classmethod
    def from_json(cls, content: bytes, name: str = "run file") -> Self:
        """Return the run in a file's content, or raise RunFormatError, which calls the file ``name``."""
        try:
            return cls.model_validate_json(content)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False)[0]
            field = ".".join(map(str, first["loc"])) or "the file"
            raise RunFormatError(f"{name}: {field}: {first['msg']}; {_REMEDY}") from error

    def by_trial(self) -> Mapping[str, DrivenEpisode]:
        """Return the episodes by trial id."""
        return {episode.trial: episode for episode in self.episodes}
