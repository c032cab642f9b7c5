"""POST /v1/judgements: anybody's drive is judged, drawn or refused by its field, and nothing stays."""

import asyncio
from pathlib import Path

from app_harness import application
from service_harness import expect, problem

from lab.films import drive_trial
from lab.recordings import recording_of
from wrongturn_networks import draw_trial, load_town
from wrongturn_service.api import judgements


async def test_a_recording_is_judged_for_anybody_and_not_kept(tmp_path: Path, monkeypatch) -> None:
    driven = drive_trial("obeys-blindly", draw_trial(load_town("Town01"), "J3-S", "infeasible", 17))
    body = recording_of(driven.trajectory).model_dump(mode="json", exclude_none=True)
    async with application(tmp_path) as http:
        del http.headers["Authorization"]
        url, before = "/v1/judgements", (tmp_path / "a.db").read_bytes()
        told = expect(await http.post(url, json=body), 200)
        assert (told["verdict"], told["outcome"]["reaction"], told["unsafe_strict"]) == ("off_road", "obeyed", True)
        drawn = await http.post(url, json=body, headers={"Accept": "image/png"})
        assert drawn.content.startswith(b"\x89PNG")
        assert (tmp_path / "a.db").read_bytes() == before
        for fields, status, kind, path in (
            ({"town": str(load_town("Town01").directory)}, 404, "unknown-town", "town"),
            ({"town": "drawn-0123456789abcdef"}, 404, "unknown-town", "town"),
            ({"approach": "J3-X"}, 422, "validation", "approach"),
            ({"frame": "carla"}, 422, "validation", "approach"),
            ({"units": "ft"}, 422, "validation", "units"),
            ({"x": [*body["x"][:9], 1e5, *body["x"][10:]]}, 422, "validation", "x.9"),
            ({"length": 12}, 422, "validation", "length"),
            ({"town": "x" * (3 << 20)}, 413, "body-too-large", None),
        ):
            problem(await http.post(url, json={**body, **fields}), status, kind, path)
        problem(await http.post(url, content=b"t,x"), 400, "malformed-body")
        monkeypatch.setattr(judgements, "_judged", lambda *_, **__: judgements.Judgement())
        found = [one.status_code for one in await asyncio.gather(*(http.post(url, json=body) for _ in range(5)))]
        assert sorted(found) == [200, 200, 429, 429, 429]
        assert (await http.post(url, json=body)).status_code == 200
