"""``Idempotency-Key``: a repeated request gets the stored reply, so nothing is created twice.

Tokens are not stored. A repeated registration or rotation makes a new token, and the one before ends.
"""

import asyncio
import contextlib
import hashlib
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from weakref import WeakValueDictionary

from wrongturn_protocol import FieldError, ProblemType
from wrongturn_service.errors import InvalidRequestError, ServiceError
from wrongturn_service.storage.models import IdempotencyRow
from wrongturn_service.storage.store import Store
from wrongturn_service.tokens import digest

HEADER = "Idempotency-Key"
_LONGEST = 255


class StoredReplyError(Exception):
    """The request was answered before under its key; that reply is sent again."""

    def __init__(self, stored: IdempotencyRow) -> None:
        super().__init__("answered before")
        self.stored = stored


@dataclass(frozen=True)
class IdempotentRequest:
    """A request with its key, or without one.

    Attributes:
        key: The client's key. None if it sent none; then no reply is stored.
        scope: Whose key it is.
        fingerprint: SHA-256 of the request.
    """

    key: str | None
    scope: str
    fingerprint: str

    def row(self, body: bytes, status: int, media: str, *, with_token: bool = False) -> IdempotencyRow | None:
        """Return the row to store for a reply. None without a key.

        ``with_token``: the reply also has a token, without which the body is stored.
        """
        if self.key is None:
            return None
        return IdempotencyRow(
            scope=self.scope,
            key_sha256=digest(self.key),
            request_sha256=self.fingerprint,
            status=status,
            content_type=media,
            body=body,
            with_token=with_token,
            created=time.time(),
        )


class Idempotency:
    """Looks up keys, and runs requests with the same key one after the other."""

    def __init__(self, store: Store) -> None:
        self._store = store
        # A lock lives as long as a request holds it or waits for it. locked() could not tell: it is false while the
        # lock passes from one request to the next.
        self._locks: WeakValueDictionary[tuple[str, str], asyncio.Lock] = WeakValueDictionary()

    @contextlib.asynccontextmanager
    async def once(
        self, key: str | None, scope: str, call: str, body: bytes, line: asyncio.Semaphore | None = None
    ) -> AsyncIterator[IdempotentRequest]:
        """Handle a request in the block: its method and path, and its body in canonical form.

        ``scope`` says whose key it is; the same key in another scope is another key. The look-up waits for ``line``.

        Raises:
            StoredReplyError: The request was answered before.
            InvalidRequestError: The key has a wrong form.
            ServiceError: The key was used for another request.
        """
        fingerprint = hashlib.sha256(call.encode("utf-8", "surrogatepass") + b"\n" + body).hexdigest()
        if key is None:
            yield IdempotentRequest(None, scope, fingerprint)
            return
        if not (0 < len(key) <= _LONGEST and key.isascii() and key.isprintable()):
            raise InvalidRequestError(
                HEADER, f"has to be 1 to {_LONGEST} printable ASCII characters; use a random UUID"
            )
        async with self._locks.setdefault((scope, key), asyncio.Lock()):
            async with line or contextlib.nullcontext():
                stored = await self._store.reply(scope, digest(key))
            if stored is not None and stored.request_sha256 == fingerprint:
                raise StoredReplyError(stored)
            if stored is not None:
                message = "was used for another request; use a new key for each request"
                errors = [FieldError(path=HEADER, message=message)]
                kind = ProblemType.IDEMPOTENCY_KEY_REUSED
                raise ServiceError(kind, f"{HEADER}: {message}", status=422, errors=errors)
            yield IdempotentRequest(key, scope, fingerprint)
