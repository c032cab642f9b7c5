"""Takes models in: from the network to the disk, while they are counted and hashed.

The event loop only passes pieces on. A few threads parse, hash and write, so that an upload holds up nobody else.
"""

import asyncio
import contextlib
import errno
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Final, TypeVar

import structlog

from wrongturn_protocol import ProblemType
from wrongturn_service.api.body import in_time
from wrongturn_service.episodes.open_episode import stopping
from wrongturn_service.errors import ServiceError, UnavailableError, too_many
from wrongturn_service.submissions.files import ArrivingModel, ModelFiles
from wrongturn_service.submissions.form import AROUND, Form, boundary_of, too_large

_T = TypeVar("_T")
_PART: Final = 1024 * 1024
"""Bytes that a thread takes at a time."""
_THREADS: Final = 2
_FULL: Final = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_COME_BACK_S: Final = 30
_OWNERS: Final = 4
"""Owners of one address that may upload as much as they like at a time."""


@dataclass(frozen=True, slots=True)
class Upload:
    """A form that has arrived."""

    fields: dict[str, str]
    """Values of the fields beside the model, by name."""
    sha256: str
    size: int
    """Bytes of the model."""
    keep: Callable[[], Awaitable[None]]
    """Puts the model on disk for good. Without that it is deleted."""


class Uploads:
    """Takes models in."""

    def __init__(self, files: ModelFiles, *, limit: int, patience_s: float, each: int) -> None:
        """Create the threads.

        A model has at most ``limit`` bytes, and 64 KiB of it come within ``patience_s``. An owner has ``each`` uploads
        at a time, an address four times as many.
        """
        self._files = files
        self._limit = limit
        self._patience_s = patience_s
        self._each = each
        self._under_way: Counter[str] = Counter()
        """Uploads by owner and by address. An id never looks like an address."""
        # Threads of its own: slow disks must not take those that other calls need.
        self._threads = ThreadPoolExecutor(_THREADS, "upload")
        self._closed = False

    def close(self) -> None:
        """End the threads. Uploads under way fail, and leave nothing."""
        self._closed = True
        self._threads.shutdown(wait=False)

    def boundary(self, length: int | None, content_type: str) -> bytes:
        """Check the head of a request, before its body is read, and return the body's boundary.

        Raises ServiceError if the body is too large (413), of another type (415), or without a boundary (400).
        """
        if length is not None and length > self._limit + AROUND:
            raise too_large(self._limit)
        return boundary_of(content_type)

    async def check_disk(self, length: int | None) -> None:
        """Check, before a body is read, that the disk has room for it, or for the largest model if nobody said.

        Raises ServiceError if the disk would be too full (507).
        """
        await self._work(self._files.check_room, self._limit if length is None else length)

    @contextlib.contextmanager
    def one(self, owner: str, address: str) -> Iterator[None]:
        """Count an upload of an owner and an address while the block runs. Raises UnavailableError beyond a limit."""
        for who, name, most in ((owner, "owner", self._each), (address, "address", _OWNERS * self._each)):
            if self._under_way[who] >= most:
                detail = f"{most} uploads of this {name} are under way, which is the limit; send this one after them"
                raise too_many(detail, retry_after_s=_COME_BACK_S)
        self._under_way.update((owner, address))
        try:
            yield
        finally:
            self._under_way -= Counter((owner, address))

    @contextlib.asynccontextmanager
    async def receive(
        self,
        submission_id: str,
        boundary: bytes,
        body: AsyncIterator[bytes],
        look: Callable[[dict[str, str]], Awaitable[None]],
    ) -> AsyncIterator[Upload]:
        """Read a body to its end. When the block ends, the model is deleted unless it was kept.

        ``look`` gets the fields before the model with its first bytes; what it raises ends the reading.

        Raises:
            ServiceError: The client is too slow (408), the body is malformed (400) or too large (413), a field is wrong
                (422), or the disk is full (507).
            UnavailableError: The disk failed.
        """
        model = ArrivingModel(self._files, submission_id)
        try:
            await self._work(model.begin)
            form, looked = Form(boundary, self._limit, model.write), False
            async for part in _parts(body, self._patience_s):
                await self._work(form.feed, part)
                if form.size and not looked:
                    await look(form.fields())
                    looked = True
            fields = await self._work(form.end)
            yield Upload(fields, model.hash.hexdigest(), form.size, partial(self._work, model.keep))
        finally:
            await asyncio.to_thread(model.close)

    async def _work(self, call: Callable[..., _T], *arguments: object) -> _T:
        """Run a call in a thread. A failure of the disk becomes a ServiceError."""
        if self._closed:
            raise stopping()
        loop = asyncio.get_running_loop()
        under_way = loop.run_in_executor(self._threads, partial(call, *arguments))
        try:
            return await asyncio.shield(under_way)
        except asyncio.CancelledError:
            # The thread goes on, so its file has to stay open until it is done.
            await asyncio.wait([under_way])
            raise
        except OSError as error:
            raise _failed(error) from error


async def _parts(body: AsyncIterator[bytes], patience_s: float) -> AsyncIterator[bytes]:
    """Yield a body in large parts. Raises ServiceError if the client is too slow."""
    part = bytearray()
    async for piece in in_time(body, patience_s):
        part += piece
        if len(part) >= _PART:
            yield bytes(part)
            part.clear()
    yield bytes(part)


def _failed(error: OSError) -> ServiceError:
    """Return the error that the client gets when the disk fails."""
    structlog.get_logger("submissions").error("a model could not be stored", reason=str(error))
    if error.errno in _FULL:
        return ServiceError(
            ProblemType.STORAGE_FAILED,
            "the disk of the service is full, so the model was not kept; tell the operator, and hand it in later",
            status=507,
        )
    return UnavailableError(
        ProblemType.STORAGE_FAILED,
        "the service could not store the model, and nothing was kept; hand it in again later, or tell the operator",
        retry_after_s=_COME_BACK_S,
    )
