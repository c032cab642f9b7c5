"""The operator's calls of a service. They need the operator's token."""

from collections.abc import Iterator
from typing import Any

from wrongturn_client import settings
from wrongturn_client.closing import Closing
from wrongturn_client.errors import WrongturnError
from wrongturn_client.rest import RestCalls
from wrongturn_client.transport import Transport
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
from wrongturn_protocol.certificates import SigningKey
from wrongturn_protocol.vocabulary import Collection

_PATIENCE = 300.0
"""Seconds for one attempt at a deletion, which can have much to delete."""


class Administration(RestCalls, Closing):
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
        self._transport = Transport(url or settings.service_url(), token, timeout=_PATIENCE)

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()

    def items(self, collection: Collection, limit: int, **filters: Any) -> Iterator[AdminItem]:
        """Yield at most ``limit`` items, newest first. Filters are those of the REST call; None leaves one out."""
        for page in self._pages(AdminList, "admin", collection.value, most=limit, **filters):
            yield from page.items

    def usage(self, limit: int, cursor: str | None = None) -> UsageList:
        """Return the owners with the most bytes, and the sum over all; ``cursor`` goes on after an earlier reply."""
        pages = list(self._pages(UsageList, "admin", "usage", most=limit, cursor=cursor))
        owners = tuple(owner for page in pages for owner in page.owners)
        return UsageList(owners=owners, total=pages[0].total, next=pages[-1].next)

    def audit(self, limit: int, **filters: Any) -> Iterator[AuditEntry]:
        """Yield what the operator did, newest first. Filters are ``target`` and ``action``."""
        for page in self._pages(AuditList, "admin", "audit", most=limit, **filters):
            yield from page.entries

    def item(self, collection: Collection, item: str) -> AdminDetail:
        """Return an item with what hangs on it."""
        return self._get(AdminDetail, "admin", collection.value, item)

    def hide(self, collection: Collection, item: str, reason: str | None = None) -> Change:
        """Hide an item. Safe to call again."""
        return self._call(Change, "PUT", "admin", collection.value, item, "hidden", reason=reason)

    def unhide(self, collection: Collection, item: str, reason: str | None = None) -> Change:
        """Show an item again. Safe to call again."""
        return self._call(Change, "DELETE", "admin", collection.value, item, "hidden", reason=reason)

    def revoke(self, collection: Collection, item: str, reason: str | None = None) -> Change:
        """End the tokens of an owner and its agents, or of an agent. Safe to call again."""
        return self._call(Change, "DELETE", "admin", collection.value, item, "tokens", reason=reason)

    def rotate_key(self, reason: str | None = None) -> SigningKey:
        """Let the service sign certificates with a new key, and return it."""
        return self._call(SigningKey, "POST", "keys", reason=reason)

    def delete(self, collection: Collection, item: str, *, free: bool = False, reason: str | None = None) -> Deletion:
        """Delete an item with all that hangs on it. Safe to call again."""
        return self._call(Deletion, "DELETE", "admin", collection.value, item, reason=reason, free=free or None)
