"""``Idempotency-Key``: a repeated request gets the stored reply, so nothing is created twice.

Tokens are not stored. A repeated registration or rotation makes a new token, and the one before ends.
"""

import asyncio
import contextlib
import hashlib
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass
from weakref import WeakValueDictionary

from wrongturn_protocol import FieldError, ProblemType
from wrongturn_service.errors import InvalidRequestError, ServiceError
from wrongturn_service.storage.models import IdempotencyRow
from wrongturn_service.storage.store import Store
from wrongturn_service.tokens import digest

HEADER = "Idempotency-Key"
_LONGEST = 255


@dataclass(frozen=True)
class IdempotentRequest:
    """A request with its key.

    Attributes:
        stored: The stored reply if the request was answered before.
        key: The client's key. None if it sent none; then no reply is stored.
        scope: Whose key it is.
        fingerprint: SHA-256 of the request.
    """

    stored: IdempotencyRow | None
    key: str | None
    scope: str
    fingerprint: str

    def remember(
        self, status: int, content_type: str, *, with_token: bool = False
    ) -> Callable[[bytes], IdempotencyRow] | None:
        """Return a function that makes the row to store from a reply's body. None without a key.

        ``with_token``: the reply also has a token, without which the body is stored.
        """
        key = self.key
        if key is None:
            return None
        return lambda body: IdempotencyRow(
            scope=self.scope,
            key_sha256=digest(key),
            request_sha256=self.fingerprint,
            status=status,
            content_type=content_type,
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
        """Handle a request in the block.

        Args:
            key: The header's value.
            scope: Whose key it is. The same key in another scope is another key.
            call: Method and path.
            body: The request in canonical form.
            line: What the look-up waits for.

        Raises:
            InvalidRequestError: The key has a wrong form.
            ServiceError: The key was used for another request.
        """
        fingerprint = hashlib.sha256(call.encode("utf-8", "surrogatepass") + b"\n" + body).hexdigest()
        if key is None:
            yield IdempotentRequest(None, None, scope, fingerprint)
            return
        if not (0 < len(key) <= _LONGEST and key.isascii() and key.isprintable()):
            raise InvalidRequestError(
                HEADER, f"has to be 1 to {_LONGEST} printable ASCII characters; use a random UUID"
            )
        name = (scope, key)
        lock = self._locks.get(name)
        if lock is None:
            lock = self._locks[name] = asyncio.Lock()
        async with lock:
            async with line or contextlib.nullcontext():
                stored = await self._store.reply(scope, digest(key))
            if stored is not None and stored.request_sha256 != fingerprint:
                message = "was used for another request; use a new key for each request"
                raise ServiceError(
                    ProblemType.IDEMPOTENCY_KEY_REUSED,
                    f"{HEADER}: {message}",
                    status=422,
                    errors=[FieldError(path=HEADER, message=message)],
                )
            yield IdempotentRequest(stored, key, scope, fingerprint)
