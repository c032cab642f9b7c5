"""The operator's calls of a service. They need the operator's token."""

from collections.abc import Iterator
from typing import Any
from urllib.parse import urlencode

from wrongturn_client import settings
from wrongturn_client.decoding import validated
from wrongturn_client.errors import WrongturnError
from wrongturn_client.transport import Transport, path_of
from wrongturn_protocol.administration import (
    AdminDetail,
    AdminItem,
    AdminList,
    AuditEntry,
    AuditList,
    Change,
    Deletion,
    UsageList,
)
from wrongturn_protocol.vocabulary import Collection

_PATIENCE = 300.0
"""Seconds for one attempt at a deletion, which can have much to delete."""


class Administration:
    """What the operator of one service can do. Every method raises an ApiError if the service refuses."""

    def __init__(self, url: str | None = None, token: str | None = None) -> None:
        """Create the client; the first call connects.

        Args:
            url: The service's URL; ``WRONGTURN_URL`` by default.
            token: The operator's token; by default ``WRONGTURN_OPERATOR_TOKEN``, or the file that
                ``WRONGTURN_OPERATOR_TOKEN_FILE`` names, or ``WRONGTURN_TOKEN``.

        Raises:
            WrongturnError: There is no token, or its file cannot be read.
        """
        token = token or settings.secret(settings.OPERATOR_TOKEN) or settings.token()
        if token is None:
            raise WrongturnError(
                "these calls need the operator's token: set WRONGTURN_OPERATOR_TOKEN, or WRONGTURN_OPERATOR_TOKEN_FILE "
                "to a file with it"
            )
        self._transport = Transport(url or settings.service_url() or settings.DEFAULT_URL, token, timeout=_PATIENCE)

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()

    def items(self, collection: Collection, limit: int, **filters: object) -> Iterator[AdminItem]:
        """Yield at most ``limit`` items, newest first. Filters are those of the REST call; None leaves one out."""
        for page in self._pages(AdminList, (collection.value,), limit, filters):
            yield from page.items

    def usage(self, limit: int, cursor: str | None = None) -> UsageList:
        """Return the owners with the most bytes, and the sum over all; ``cursor`` goes on after an earlier reply."""
        pages: list[UsageList] = list(self._pages(UsageList, ("usage",), limit, {}, cursor))
        owners = tuple(owner for page in pages for owner in page.owners)
        return UsageList(owners=owners, total=pages[0].total, next=pages[-1].next)

    def audit(self, limit: int, **filters: object) -> Iterator[AuditEntry]:
        """Yield what the operator did, newest first. Filters are ``target`` and ``action``."""
        for page in self._pages(AuditList, ("audit",), limit, filters):
            yield from page.entries

    def item(self, collection: Collection, item: str) -> AdminDetail:
        """Return an item with what hangs on it."""
        return validated(AdminDetail, self._call("GET", collection, item))

    def hide(self, collection: Collection, item: str, reason: str | None = None) -> Change:
        """Hide an item. Safe to call again."""
        return validated(Change, self._call("PUT", collection, item, "hidden", reason=reason))

    def unhide(self, collection: Collection, item: str, reason: str | None = None) -> Change:
        """Show an item again. Safe to call again."""
        return validated(Change, self._call("DELETE", collection, item, "hidden", reason=reason))

    def revoke(self, collection: Collection, item: str, reason: str | None = None) -> Change:
        """End the tokens of an owner and its agents, or of an agent. Safe to call again."""
        return validated(Change, self._call("DELETE", collection, item, "tokens", reason=reason))

    def delete(self, collection: Collection, item: str, *, free: bool = False, reason: str | None = None) -> Deletion:
        """Delete an item with all that hangs on it. Safe to call again."""
        given = {"free": "true"} if free else {}
        return validated(Deletion, self._call("DELETE", collection, item, reason=reason, **given))

    def _call(self, method: str, collection: Collection, *path: str, **query: str | None) -> Any:
        return self._transport.call(method, _path((collection.value, *path), query)).message()

    def _pages(
        self, kind: Any, path: tuple[str, ...], limit: int, filters: dict[str, object], cursor: str | None = None
    ) -> Iterator[Any]:
        """Yield pages until there are ``limit`` items."""
        while limit > 0:
            size = min(limit, 500)
            query = {**filters, "limit": size, "cursor": cursor}
            page = validated(kind, self._transport.call("GET", _path(path, query)).message())
            yield page
            limit -= size
            cursor = page.next
            if cursor is None:
                return


def _path(path: tuple[str, ...], query: dict[str, Any]) -> str:
    given = {
        name: str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in query.items()
        if value is not None
    }
    return path_of("v1", "admin", *path) + (f"?{urlencode(given)}" if given else "")
