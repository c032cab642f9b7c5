"""The OpenAPI document takes a while to make; meanwhile everybody else is answered."""

import asyncio
import threading
from pathlib import Path
from typing import Any

import pytest
from app_harness import application

from wrongturn_service.api import documents


async def test_others_are_answered_while_the_document_is_made_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, go_on, real = threading.Semaphore(0), threading.Event(), documents.get_openapi
    answered_meanwhile = []

    def slow(**given: Any) -> dict[str, Any]:
        made.release()
        answered_meanwhile.append(go_on.wait(120))
        return real(**given)

    monkeypatch.setattr(documents, "get_openapi", slow)

    async with application(tmp_path) as http:
        asked = [asyncio.create_task(http.get(path)) for path in ("/openapi.json", "/openapi.json", "/docs")]
        await asyncio.to_thread(made.acquire)
        assert (await http.get("/health/live")).status_code == 200
        go_on.set()
        first, second, page = await asyncio.gather(*asked)
        assert first.status_code == second.status_code == page.status_code == 200
        assert first.content == second.content
        refused = await http.patch("/v1/agents")
        assert (refused.status_code, refused.headers["allow"]) == (405, "GET, POST")
    assert answered_meanwhile == [True]
