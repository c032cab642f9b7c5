"""``Idempotency-Key``: a repeat of a creating request gets the stored reply, so that nothing is created twice."""

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
from wrongturn_service.tokens import digest, seal

HEADER = "Idempotency-Key"
_LONGEST = 255


@dataclass(frozen=True)
class Once:
    """One request under its key.

    Attributes:
        stored: the reply to its first time, where there was one.
        key: what the client sent; None where it sent none, and then nothing is stored.
        scope: whose key it is.
        fingerprint: SHA-256 of what was asked for.
    """

    stored: IdempotencyRow | None
    key: str | None
    scope: str
    fingerprint: str

    def remember(
        self,
        status: int,
        content_type: str,
        token: str | None = None,
    ) -> Callable[[bytes], IdempotencyRow] | None:
        """What makes of a reply's body the row that is stored; None without a key.

        Args:
            status: of the reply.
            content_type: of the reply.
            token: what belongs in the reply and must not be readable in the database.
        """
        key = self.key
        if key is None:
            return None

        def row(body: bytes) -> IdempotencyRow:
            return IdempotencyRow(
                scope=self.scope,
                key_sha256=digest(key),
                request_sha256=self.fingerprint,
                status=status,
                content_type=content_type,
                body=body,
                sealed_token=None if token is None else seal(token, key),
                created=time.time(),
            )

        return row


class Idempotency:
    """Looks keys up, and lets two requests with the same key in one after the other."""

    def __init__(self, store: Store) -> None:
        self._store = store
        # Each lives as long as a request holds it or waits for it. Its own locked() would not do to tell when that is:
        # it is false while the lock passes from one to the next.
        self._locks: WeakValueDictionary[tuple[str, str], asyncio.Lock] = WeakValueDictionary()

    @contextlib.asynccontextmanager
    async def once(self, key: str | None, scope: str, call: str, body: bytes) -> AsyncIterator[Once]:
        """Handle one request.

        Args:
            key: the header's value.
            scope: whose key it is: another's key of the same name is another key.
            call: method and path.
            body: the request, in a canonical form.

        Raises:
            InvalidRequestError: the key is no key.
            ServiceError: it was used for another request.
        """
        fingerprint = hashlib.sha256(call.encode("utf-8", "surrogatepass") + b"\n" + body).hexdigest()
        if key is None:
            yield Once(None, None, scope, fingerprint)
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
            stored = await self._store.reply(scope, digest(key))
            if stored is not None and stored.request_sha256 != fingerprint:
                message = "was used for another request before; take a new key for each request"
                raise ServiceError(
                    ProblemType.IDEMPOTENCY_KEY_REUSED,
                    f"{HEADER}: {message}",
                    status=422,
                    errors=[FieldError(path=HEADER, message=message)],
                )
            yield Once(stored, key, scope, fingerprint)
