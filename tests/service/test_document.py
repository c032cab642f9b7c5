"""The OpenAPI document takes a while to make; meanwhile everybody else is answered."""

import asyncio
import threading
from pathlib import Path
from typing import Any

import pytest
from app_harness import application, play
from fake_pool import FakePool

from wrongturn_service.api import documents


@pytest.mark.parametrize(("method", "status"), [("GET", 200), ("PATCH", 405)])
def test_others_are_answered_while_the_document_is_made_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str, status: int
) -> None:
    made, go_on, real = threading.Semaphore(0), threading.Event(), documents.get_openapi
    answered_meanwhile = []

    def slow(**given: Any) -> dict[str, Any]:
        made.release()
        answered_meanwhile.append(go_on.wait(120))
        return real(**given)

    monkeypatch.setattr(documents, "get_openapi", slow)

    async def story() -> None:
        async with application(tmp_path, FakePool()) as http:
            paths = {"GET": "/openapi.json", "PATCH": "/v1/agents"}
            asked = [asyncio.create_task(http.request(method, paths[method])) for _ in range(2)]
            await asyncio.to_thread(made.acquire)
            assert (await http.get("/health/live")).status_code == 200
            go_on.set()
            first, second = await asyncio.gather(*asked)
            assert first.status_code == second.status_code == status
            assert first.content == second.content
            if method == "PATCH":
                assert set(first.headers["allow"].split(", ")) == {"GET", "POST"}

    play(story)
    assert answered_meanwhile == [True]
