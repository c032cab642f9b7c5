"""Models on disk through the life of a service: parts of uploads, old models, restores, and ends half-way."""

import os
import time
from pathlib import Path

import httpx
import pytest
from model_form import model
from service_harness import expect, problem
from sqlalchemy import update
from submission_story import checked, driven, hand_in, handing_in, running, service_of, story

from wrongturn_protocol import SubmissionState
from wrongturn_service.storage.backup import back_up, restore
from wrongturn_service.storage.models import SubmissionRow
from wrongturn_service.storage.submissions import SubmissionStore
from wrongturn_service.submissions.files import ArrivingModel, ModelFiles
from wrongturn_service.submissions.operations import NO_MODEL

_DAY_S = 86400.0


def files(home: Path) -> list[str]:
    return sorted(file.name for file in (home / "submissions").iterdir())


async def test_a_start_deletes_what_uploads_left(tmp_path: Path) -> None:
    folder = tmp_path / "submissions"
    folder.mkdir()
    for name in ("su_1.part", "su_2.onnx", "notes.txt", "mine.onnx"):
        (folder / name).write_text(name)

    async with handing_in(tmp_path):
        # A model without a row may belong to a newer database than the one that was put back.
        assert files(tmp_path) == ["mine.onnx", "notes.txt", "su_2.onnx"]


def test_a_start_leaves_what_another_service_receives(tmp_path: Path) -> None:
    folder = ModelFiles(tmp_path)
    folder.prepare()
    arriving = ArrivingModel(folder, "su_1")
    arriving.begin()
    ModelFiles(tmp_path).prepare()
    assert files(tmp_path) == ["su_1.part"]
    assert arriving._handle is not None
    os.close(arriving._handle)
    ModelFiles(tmp_path).prepare()
    assert files(tmp_path) == []


@story(submission_keep_days=3)
async def test_models_and_logs_are_kept_for_some_days(http: httpx.AsyncClient, tmp_path: Path) -> None:
    submissions = service_of(http).submissions
    names = ("old", "new", "open", "useless")
    ids = {name: expect(await hand_in(http, model(name=name)), 202)["id"] for name in names}
    for name in ("old", "new"):
        await driven(http, ids[name])
        await submissions.end(ids[name], SubmissionState.FAILED, "as the test wants")
    await _age(submissions.rows, ids["old"], 3.1)
    # The service died before it could delete the model.
    await submissions.rows.set_state(ids["useless"], SubmissionState.CANCELLED, reason="cut off")
    for name, days in (("su_lost", 3.1), ("su_late", 2.9), ("operators", 99)):
        file = tmp_path / "submissions" / f"{name}.onnx"
        file.write_text(name)
        os.utime(file, (time.time() - days * _DAY_S,) * 2)
    os.utime(submissions.files.path(ids["open"]), (0, 0))
    await submissions.purge()
    left = {f"{ids['new']}.onnx", f"{ids['open']}.onnx", "su_late.onnx", "operators.onnx"}
    assert set(files(tmp_path)) == left
    shown = expect(await http.get(f"/v1/submissions/{ids['old']}"), 200)
    assert shown["reason"] == "as the test wants"
    logs = {name: expect(await http.get(f"/v1/submissions/{ids[name]}/log"), 200)["lines"] for name in names}
    assert [bool(logs[name]) for name in names] == [False, True, True, True]


async def _age(rows: SubmissionStore, submission: str, days: float) -> None:
    """Let a submission have ended so many days ago."""
    async with rows._database.write() as session:
        then = time.time() - days * _DAY_S
        await session.execute(update(SubmissionRow).where(SubmissionRow.id == submission).values(ended=then))


async def test_a_restored_submission_without_its_model_has_failed(tmp_path: Path) -> None:
    url = f"sqlite+aiosqlite:///{tmp_path / 'a.db'}"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    ids: dict[str, str] = {}

    async with handing_in(tmp_path) as http:
        for name in ("queued", "checked", "running", "driven", "kept"):
            ids[name] = expect(await hand_in(http, model(name=name)), 202)["id"]
        ids["ada"] = http.headers["Authorization"].removeprefix("Bearer ")
        for name in ("checked", "running"):
            await checked(http, ids[name])
        await service_of(http).submissions.rows.set_state(ids["checked"], SubmissionState.CHECKED)
        await running(http, ids["running"])
        await driven(http, ids["driven"])
        back_up(url, tmp_path / "backup")
    restore(f"sqlite+aiosqlite:///{elsewhere / 'a.db'}", tmp_path / "backup", elsewhere)
    kept = elsewhere / "submissions" / f"{ids['kept']}.onnx"
    kept.parent.mkdir()
    kept.write_bytes((tmp_path / "submissions" / kept.name).read_bytes())
    async with handing_in(elsewhere, ids["ada"]) as http:
        listed = expect(await http.get("/v1/submissions"), 200)["submissions"]
        states = {row["name"]: (row["state"], row.get("reason")) for row in listed}
        gone = ("failed", NO_MODEL)
        assert states == {"queued": gone, "checked": gone, "running": gone, "driven": gone, "kept": ("queued", None)}
        # Names are free again, but for the agent whose evaluation counts.
        for name in ("queued", "checked", "running"):
            expect(await hand_in(http, model(name=name)), 202)
        problem(await hand_in(http, model(name="driven")), 409, "evaluation-open")
        closed = next(row for row in listed if row["name"] == "driven")
        assert closed["finished"] == 0
        assert closed["episodes"] > 0
        assert expect(await http.get(f"/v1/evaluations/{closed['evaluation']}"), 200)["state"] == "finished"


@pytest.mark.parametrize("drives", [False, True])
async def test_an_end_that_was_cut_off_is_made_up_for_at_the_start(tmp_path: Path, drives: bool) -> None:
    """The service dies between the state and the rest: the evaluation is closed, or the agent deleted, later."""
    ids: dict[str, str] = {}

    async with handing_in(tmp_path) as http:
        ids["ada"] = http.headers["Authorization"].removeprefix("Bearer ")
        ids["submission"] = expect(await hand_in(http), 202)["id"]
        if drives:
            ids["evaluation"] = await driven(http, ids["submission"])
        else:
            await checked(http, ids["submission"])
        rows = service_of(http).submissions.rows
        assert await rows.set_state(ids["submission"], SubmissionState.CANCELLED, reason="cut off")
    async with handing_in(tmp_path, ids["ada"]) as http:
        shown = expect(await http.get(f"/v1/submissions/{ids['submission']}"), 200)
        assert (shown["state"], shown["reason"]) == ("cancelled", "cut off")
        if drives:
            assert expect(await http.get(f"/v1/evaluations/{ids['evaluation']}"), 200)["state"] == "finished"
            problem(await hand_in(http), 409, "evaluation-open")
        else:
            assert "agent" not in shown
            expect(await hand_in(http), 202)
