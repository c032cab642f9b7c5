"""Handing in: what is taken and refused, what is stored, who may see it, and what a repeat gets."""

from pathlib import Path

from app_harness import play
from model_form import model
from service_harness import expect
from submission_story import hand_in, handing_in

SHA256 = "9d8a8f3e7a0e0e7c"


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def files(folder: Path) -> list[str]:
    return sorted(file.name for file in (folder / "submissions").iterdir())


def test_a_model_is_stored_and_waits(tmp_path: Path) -> None:
    async def story() -> None:
        async with handing_in(tmp_path) as http:
            found = expect(await hand_in(http), 202)
            told = {"state": "queued", "suite": "smoke@2", "name": "mine", "owner": "ada", "size": 7, "position": 0}
            assert {name: found[name] for name in told} == told
            assert "agent" not in found
            stored = tmp_path / "submissions" / f"{found['id']}.onnx"
            assert stored.read_bytes() == b"a model"
            assert stored.stat().st_mode & 0o777 == 0o600
            assert stored.parent.stat().st_mode & 0o777 == 0o700
            assert files(tmp_path) == [stored.name]
            assert expect(await http.get(f"/v1/submissions/{found['id']}"), 200) == found
            second = expect(await hand_in(http, model(name="other")), 202)
            assert second["position"] == 1
            listed = expect(await http.get("/v1/submissions"), 200)["submissions"]
            assert listed == [second, found]
            (line,) = expect(await http.get(f"/v1/submissions/{found['id']}/log"), 200)["lines"]
            assert line["message"] == f"handed in: 7 bytes, SHA-256 {found['sha256']}"

    play(story)
