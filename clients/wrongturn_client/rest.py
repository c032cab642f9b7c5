"""REST calls with typed replies: one item, a list by pages, and one that creates."""

import uuid
from collections.abc import Iterator
from typing import Any, Final, TypeVar
from urllib.parse import urlencode

from pydantic import BaseModel

from wrongturn_client.decoding import validated
from wrongturn_client.evaluation import EpisodePage
from wrongturn_client.transport import Transport, path_of
from wrongturn_protocol import AgentList, OwnerList, SubmissionList

M = TypeVar("M", bound=BaseModel)
L = TypeVar("L", AgentList, OwnerList, EpisodePage, SubmissionList)
_PAGE: Final = "500"
"""Items of a list that are asked for at a time."""


class RestCalls:
    """Base of what calls a service."""

    _transport: Transport

    @property
    def url(self) -> str:
        """The service's URL."""
        return self._transport.url

    def _get(self, kind: type[M], *path: str, query: str = "") -> M:
        return validated(kind, self._transport.call("GET", path_of("v1", *path) + query).message())

    def _pages(self, kind: type[L], *path: str, **query: str) -> Iterator[L]:
        """Yield the pages of a list, each when the one before was read."""
        query = {"limit": _PAGE, **query}
        while True:
            page = self._get(kind, *path, query="?" + urlencode(query))
            yield page
            if page.next is None:
                return
            query["cursor"] = page.next

    def _create(self, kind: type[M], body: Any, *path: str) -> M:
        headers = {"Idempotency-Key": str(uuid.uuid4())}
        reply = self._transport.call("POST", path_of("v1", *path), body=body, headers=headers)
        return validated(kind, reply.message())
