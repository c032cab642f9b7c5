"""Handing in: what is taken and refused, what is stored, who may see it, and what a repeat gets."""

import errno
import gzip
import os
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from model_form import form, model, part
from service_harness import expect, problem
from sqlalchemy.exc import OperationalError
from submission_story import OPERATOR, agent, checked, hand_in, owner, running, service_of, story


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


def files(http: httpx.AsyncClient) -> list[str]:
    return sorted(file.name for file in service_of(http).submissions.files.folder.iterdir())


@story()
async def test_a_model_is_stored_and_waits(http: httpx.AsyncClient, tmp_path: Path) -> None:
    found = expect(await hand_in(http), 202)
    told = {"state": "queued", "suite": "smoke@3", "name": "mine", "owner": "ada", "size": 7, "position": 0}
    assert {name: found[name] for name in told} == told
    assert "agent" not in found
    stored = tmp_path / "submissions" / f"{found['id']}.onnx"
    assert stored.read_bytes() == b"a model"
    assert stored.stat().st_mode & 0o777 == 0o600
    assert stored.parent.stat().st_mode & 0o777 == 0o700
    assert files(http) == [stored.name]
    assert expect(await http.get(f"/v1/submissions/{found['id']}"), 200) == found
    second = expect(await hand_in(http, model(name="other")), 202)
    assert second["position"] == 1
    listed = expect(await http.get("/v1/submissions"), 200)["submissions"]
    assert listed == [second, found]
    (line,) = expect(await http.get(f"/v1/submissions/{found['id']}/log"), 200)["lines"]
    assert line["message"] == f"Handed in: 7 bytes, SHA-256 {found['sha256']}"


def is_model(handle: int) -> bool:
    return ".part" in str(Path(f"/proc/self/fd/{handle}").readlink())


NAMELESS = form(part("suite", b"smoke@3"), part("model", b"m"))


REFUSED = [
    (model(suite="none@1"), 404, "unknown-suite", "suite"),
    (model(name=""), 422, "validation", "name"),
    (model(name="../x"), 422, "validation", "name"),
    (model(name="x" * 65), 422, "validation", "name"),
    (NAMELESS, 422, "validation", "name"),
    (model(name="Taken"), 409, "agent-name-taken", "name"),
    (model(name="WAITING"), 409, "agent-name-taken", "name"),
    (model(b"m" * 2049), 413, "body-too-large", "model"),
    (b"no form", 400, "malformed-body", None),
]


@story(model_limit=2048)
async def test_what_is_refused_leaves_nothing(http: httpx.AsyncClient) -> None:
    await agent(http, "taken")
    waits = expect(await hand_in(http, model(name="waiting")), 202)
    for body, status, kind, path in REFUSED:
        problem(await hand_in(http, body), status, kind, path)
        assert files(http) == [f"{waits['id']}.onnx"]
    assert len(expect(await http.get("/v1/submissions"), 200)["submissions"]) == 1


@story(submissions_per_owner=2)
async def test_an_owner_has_so_many_open_ones(http: httpx.AsyncClient) -> None:
    first = expect(await hand_in(http, model(name="a"), Idempotency_Key="a"), 202)
    expect(await hand_in(http, model(name="b"), Idempotency_Key="b"), 202)
    # Without a key the body is not read; with one it might be a repeat.
    for headers in ({}, {"Idempotency_Key": "c"}):
        refused = await hand_in(http, model(name="c"), **headers)
        assert problem(refused, 429, "rate-limited")["position"] == 1
        assert refused.headers["retry-after"]
    assert expect(await hand_in(http, model(name="a"), Idempotency_Key="a"), 202) == first
    other = bearer(await owner(http, "bob"))
    expect(await hand_in(http, model(name="c"), **other), 202)
    expect(await http.delete(f"/v1/submissions/{first['id']}"), 200)
    expect(await hand_in(http, model(name="d")), 202)
    assert len(files(http)) == 3


@story()
async def test_a_repeat_gets_the_stored_reply(http: httpx.AsyncClient) -> None:
    first = expect(await hand_in(http, Idempotency_Key="k"), 202)
    # The parts may come in another order, with another boundary.
    turned = form(part("model", b"a model"), part("name", b"mine"), part("suite", b"smoke@3"))
    assert expect(await hand_in(http, turned, Idempotency_Key="k"), 202) == first
    other = turned.replace(b"a-boundary", b"another")
    kind = {"Content_Type": "multipart/form-data; boundary=another"}
    assert expect(await hand_in(http, other, Idempotency_Key="k", **kind), 202) == first
    for changed in (model(b"another"), model(name="another"), model(suite="wrong-command@3")):
        problem(await hand_in(http, changed, Idempotency_Key="k"), 422, "idempotency-key-reused")
    problem(await hand_in(http, Idempotency_Key="\t"), 422, "validation", "Idempotency-Key")
    # The key is the token's own.
    bob = bearer(await owner(http, "bob"))
    problem(await hand_in(http, Idempotency_Key="k", **bob), 409, "agent-name-taken")
    assert files(http) == [f"{first['id']}.onnx"]
    assert len(expect(await http.get("/v1/submissions"), 200)["submissions"]) == 1


@story()
async def test_an_agent_hands_its_own_model_in(http: httpx.AsyncClient) -> None:
    mine = await agent(http, "mine")
    as_agent = bearer(mine["token"])
    problem(await hand_in(http, model(name="other"), **as_agent), 422, "validation", "name")
    found = expect(await hand_in(http, NAMELESS, **as_agent), 202)
    assert (found["name"], found["agent"], found["track"], found["owner"]) == ("mine", mine["id"], "camera", "ada")
    refused = problem(await hand_in(http, NAMELESS, **as_agent), 409, "evaluation-open", "suite")
    assert "first evaluation counts" in refused["detail"]
    # On another suite it may.
    expect(await hand_in(http, model(suite="wrong-command@3"), **as_agent), 202)
    begun = expect(await http.post("/v1/evaluations", json={"suite": "navigation@1"}, headers=as_agent), 201)
    problem(await hand_in(http, model(suite="navigation@1"), **as_agent), 409, "evaluation-open", "suite")
    expect(await http.delete(f"/v1/evaluations/{begun['id']}", headers=as_agent), 200)
    expect(await hand_in(http, model(suite="navigation@1"), **as_agent), 202)
    blind = await agent(http, "blind", "state")
    refused = problem(await hand_in(http, NAMELESS, **bearer(blind["token"])), 422, "track-not-available")
    assert "takes agents of the tracks" in refused["detail"]
    assert len(files(http)) == 3
    # An agent that was there before stays when its submission is cancelled.
    expect(await http.delete(f"/v1/submissions/{found['id']}", headers=as_agent), 200)
    expect(await http.get(f"/v1/agents/{mine['id']}"), 200)


@story()
async def test_who_may_see_it(http: httpx.AsyncClient) -> None:
    mine, sibling = await agent(http, "mine"), await agent(http, "sibling")
    by_agent = expect(await hand_in(http, NAMELESS, **bearer(mine["token"])), 202)
    by_owner = expect(await hand_in(http, model(name="new")), 202)
    bob = await owner(http, "bob")
    both, one = {by_agent["id"], by_owner["id"]}, {by_agent["id"]}
    ada = http.headers["Authorization"].removeprefix("Bearer ")
    sees = {ada: both, OPERATOR: both, mine["token"]: one, sibling["token"]: set(), bob: set()}
    for token, seen in sees.items():
        listed = expect(await http.get("/v1/submissions", headers=bearer(token)), 200)["submissions"]
        assert {row["id"] for row in listed} == seen
        for name in both:
            for path in ("", "/log"):
                found = await http.get(f"/v1/submissions/{name}{path}", headers=bearer(token))
                if name in seen:
                    expect(found, 200)
                else:
                    problem(found, 403, "forbidden")
            if name not in seen:
                problem(await http.delete(f"/v1/submissions/{name}", headers=bearer(token)), 403, "forbidden")
        problem(await http.get("/v1/submissions/su_none", headers=bearer(token)), 404, "unknown-submission")
    for call in (("GET", ""), ("GET", f"/{by_owner['id']}"), ("DELETE", f"/{by_owner['id']}")):
        for header in ({"Authorization": ""}, bearer("nobody's")):
            refused = await http.request(call[0], f"/v1/submissions{call[1]}", headers=header)
            problem(refused, 401, "unauthenticated")
    # What the operator cancels says so.
    gone = await http.delete(f"/v1/submissions/{by_owner['id']}", headers=bearer(OPERATOR))
    assert expect(gone, 200)["reason"] == "cancelled by the operator, as asked"


@story()
async def test_one_that_waits_is_cancelled_without_a_trace(http: httpx.AsyncClient) -> None:
    first = expect(await hand_in(http), 202)
    gone = expect(await http.delete(f"/v1/submissions/{first['id']}"), 200)
    assert (gone["state"], gone["reason"]) == ("cancelled", "cancelled by its owner, as asked")
    assert "position" not in gone
    assert expect(await http.delete(f"/v1/submissions/{first['id']}"), 200) == gone
    second = expect(await hand_in(http), 202)
    token = await checked(http, second["id"])
    practice = {"suite": "smoke@3", "trial": (await http.get("/v1/suites/smoke@3/trials")).json()["trials"][0]["id"]}
    episode = expect(await http.post("/v1/episodes", json=practice, headers=bearer(token)), 201)["id"]
    shown = expect(await http.get(f"/v1/submissions/{second['id']}"), 200)
    problem(await hand_in(http), 409, "evaluation-open")
    assert service_of(http).episodes.open == 1
    expect(await http.delete(f"/v1/submissions/{second['id']}"), 200)
    assert service_of(http).episodes.open == 0
    problem(await http.get(f"/v1/agents/{shown['agent']}"), 404, "unknown-agent")
    assert await service_of(http).store.episode(episode) is None
    problem(await http.get(f"/v1/episodes/{episode}", headers=bearer(token)), 401, "unauthenticated")
    expect(await hand_in(http), 202)


@pytest.mark.parametrize("driven", [False, True])
@story()
async def test_one_that_runs_is_cancelled_as_its_evaluation_is_closed(http: httpx.AsyncClient, driven: bool) -> None:
    found = expect(await hand_in(http), 202)
    await checked(http, found["id"])
    evaluation, token = await running(http, found["id"])
    shown = expect(await http.get(f"/v1/submissions/{found['id']}"), 200)
    assert (shown["state"], shown["evaluation"], shown["finished"]) == ("running", evaluation, 0)
    assert shown["episodes"] > 0
    episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes", headers=bearer(token)), 201)
    if driven:
        step = {"seq": 1, "action": {"steer": 0.0, "throttle": 0.0, "brake": 0.0}}
        expect(await http.post(f"/v1/episodes/{episode['id']}/step", json=step, headers=bearer(token)), 200)
    gone = expect(await http.delete(f"/v1/submissions/{found['id']}"), 200)
    assert gone["state"] == "cancelled"
    if driven:
        # Nobody drove the trials that the closing aborted.
        assert gone["finished"] == 0
        assert gone["episodes"] > 0
        assert files(http) == [f"{found['id']}.onnx"]
        closed = expect(await http.get(f"/v1/evaluations/{evaluation}"), 200)
        assert closed["state"] == "finished"
        problem(await hand_in(http), 409, "evaluation-open")
    else:
        assert "evaluation" not in gone
        assert files(http) == []
        problem(await http.get(f"/v1/evaluations/{evaluation}", headers=bearer(token)), 401, "unauthenticated")
        expect(await hand_in(http), 202)


@story()
async def test_a_disk_that_fails(http: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch) -> None:
    for call, number, status in (("write", errno.ENOSPC, 507), ("fsync", errno.EDQUOT, 507), ("open", errno.EIO, 503)):
        real = getattr(os, call)

        def fail_or_not(*arguments: Any, call: str = call, number: int = number, real: Any = real, **named: Any) -> Any:
            # Other parts of the service open and write files too.
            ours = ".part" in str(arguments[0]) if call == "open" else is_model(arguments[0])
            if not ours:
                return real(*arguments, **named)
            raise OSError(number, os.strerror(number))

        with monkeypatch.context() as patched:
            patched.setattr(os, call, fail_or_not)
            refused = await hand_in(http)
        told = problem(refused, status, "storage-failed")
        assert "hand it in" in told["detail"]
        assert files(http) == []
    expect(await hand_in(http), 202)


@pytest.mark.parametrize(("total", "reserve"), [(1 << 40, 1 << 30), (1 << 30, (1 << 30) // 20)])
@story()
async def test_uploads_leave_a_reserve_of_the_disk(
    http: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch, total: int, reserve: int
) -> None:
    body = model()
    for free, fits in ((reserve + len(body) - 1, False), (reserve + len(body), True)):
        disk = SimpleNamespace(total=total, used=total - free, free=free)
        with monkeypatch.context() as patched:
            patched.setattr(shutil, "disk_usage", lambda _, disk=disk: disk)
            answer = await hand_in(http, body)
        if fits:
            expect(answer, 202)
            continue
        told = problem(answer, 507, "storage-failed")
        assert "disk of the service is full" in told["detail"]
        assert answer.headers["connection"] == "close"
        assert files(http) == []


@pytest.mark.parametrize("encoding", ["gzip", "br", "identity, gzip"])
@story()
async def test_a_compressed_form_is_refused_with_the_remedy(http: httpx.AsyncClient, encoding: str) -> None:
    refused = await hand_in(http, gzip.compress(model()), Content_Encoding=encoding)
    assert "without compression" in problem(refused, 415, "unsupported-media-type")["detail"]
    assert refused.headers["accept-encoding"] == "identity"
    expect(await hand_in(http, Content_Encoding="identity"), 202)


@story()
async def test_a_database_that_fails_leaves_no_model(http: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch) -> None:

    async def fail(*_: object, **__: object) -> None:
        raise OperationalError("INSERT", {}, Exception("disk I/O error"))

    with monkeypatch.context() as patched:
        patched.setattr(service_of(http).submissions.rows, "add", fail)
        problem(await hand_in(http), 503, "storage-failed")
    assert files(http) == []
    expect(await hand_in(http), 202)
