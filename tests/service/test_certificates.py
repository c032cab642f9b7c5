"""The key that signs certificates lasts, can be rotated, and is in backups."""

import asyncio
import os
from pathlib import Path
from typing import Any

import httpx
import pytest
from app_harness import application
from postgres_server import PostgresServer, programs
from service_harness import OPERATOR, expect, problem

from wrongturn_service.errors import StartupError
from wrongturn_service.storage.backup import back_up, restore


async def test_the_key_stays_until_it_is_rotated_and_backups_keep_it(
    database_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    monkeypatch.setenv("PATH", f"{programs()}{os.pathsep}{os.environ['PATH']}")
    operator = {"Authorization": f"Bearer {OPERATOR}"}

    async def keys(http: httpx.AsyncClient, path: str = "/v1/keys") -> Any:
        return expect(await http.get(path, headers=operator), 200)

    def running(url: str = database_url, **settings: Any) -> Any:
        return application(tmp_path, database=url, registration="operator", operator_token=OPERATOR, **settings)

    async with running() as http:
        (first,) = (await keys(http))["keys"]
        new = expect(await http.post("/v1/keys?reason=old", headers=operator), 201)
        problem(await http.post("/v1/keys"), 401, "unauthenticated")
        (entry,) = (await keys(http, "/v1/admin/audit?action=rotate"))["entries"]
        assert (entry["collection"], entry["target"], entry["reason"]) == ("keys", "key 2", "old")
    await asyncio.to_thread(back_up, database_url, tmp_path / "backup")
    other = f"sqlite+aiosqlite:///{tmp_path / 'other.db'}"
    if "postgresql" in database_url:
        server: PostgresServer = request.getfixturevalue("postgres")
        other = await asyncio.to_thread(server.new_database)
    await asyncio.to_thread(restore, other, tmp_path / "backup", tmp_path)
    file = tmp_path / "key"

    async with running(other) as http:
        signing, retired = (await keys(http))["keys"]
        assert (signing, retired["key"]) == (new, first["key"])
        assert retired["retired"] is not None
    file.write_text("1" * 64)
    async with running(other, signing_key_file=file) as http:
        assert len((await keys(http))["keys"]) == 3
        problem(await http.post("/v1/keys", headers=operator), 422, "validation", "WRONGTURN_SIGNING_KEY_FILE")
        file.write_text("2" * 64)
        expect(await http.post("/v1/keys", headers=operator), 201)
        assert [key["retired"] is None for key in (await keys(http))["keys"]] == [True, False, False, False]
    for content, why in (("1" * 64, "retired"), ("no-key-of-any-kind", "hexadecimal")):
        file.write_text(content)
        with pytest.raises(StartupError, match=f"WRONGTURN_SIGNING_KEY_FILE: .*{why}"):
            async with running(other, signing_key_file=file):
                pass
