"""The operator hides, revokes and deletes. Nothing of what was deleted is left, and the log says what was done."""

import contextlib
import uuid
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from app_harness import application, register, step
from service_harness import expect, problem
from sqlalchemy import select
from stored_evaluation import store_evaluation
from submission_story import agent, checked, hand_in, handing_in, running, service_of
from test_paging import pages

from wrongturn_networks import load_suite
from wrongturn_service.service import Service
from wrongturn_service.storage.models import Base

OPERATOR = "the-operators-own-token"
BEARER = {"Authorization": f"Bearer {OPERATOR}"}
SUITE = "smoke@3"
KEPT = {"audit", "held"}
"""Tables that remember what was deleted."""


@contextlib.asynccontextmanager
async def administered(folder: Path, **settings: Any) -> AsyncIterator[httpx.AsyncClient]:
    """The application with its agent "one", whose token the client sends."""
    async with application(folder, operator_token=OPERATOR, **settings) as http:
        yield http


async def admin(http: httpx.AsyncClient, method: str, path: str, **query: object) -> httpx.Response:
    params = {name: str(value) for name, value in query.items()}
    return await http.request(method, f"/v1/admin/{path}", params=params, headers=BEARER)


async def public(http: httpx.AsyncClient, path: str) -> httpx.Response:
    request = http.build_request("GET", path)
    request.headers.pop("Authorization", None)
    return await http.send(request)


async def own_id(http: httpx.AsyncClient) -> str:
    found: str = expect(await public(http, "/v1/agents?all=true"), 200)["agents"][0]["id"]
    return found


async def leftovers(service: Service, *ids: str) -> list[str]:
    """Tables and columns that name one of these ids."""
    found = []
    async with service.administration.rows._database.read() as session:
        for table in Base.metadata.sorted_tables:
            if table.name in KEPT:
                continue
            for row in (await session.execute(select(table))).mappings():
                found += [
                    f"{table.name}.{name}"
                    for name, value in row.items()
                    for one in ids
                    if one in (value.decode("latin-1") if isinstance(value, bytes) else str(value))
                ]
    return found


async def has_entry(http: httpx.AsyncClient, agent_id: str) -> bool:
    board = expect(await public(http, f"/v1/leaderboards/{SUITE}"), 200)
    return agent_id in {entry["agent"]["id"] for entry in board["entries"]}


async def test_what_is_hidden_is_seen_by_its_owner_alone(tmp_path: Path) -> None:
    async with administered(tmp_path) as http:
        service, mine = service_of(http), await own_id(http)
        evaluation = await store_evaluation(service, mine, load_suite(SUITE), trajectories=False)
        second = await store_evaluation(service, mine, load_suite(SUITE), secret="another", trajectories=False)
        episode = (await service.finished.episodes(evaluation))[0].id
        seen = [
            f"/v1/agents/{mine}",
            f"/v1/evaluations/{evaluation}",
            f"/v1/evaluations/{evaluation}/episodes",
            f"/v1/episodes/{episode}",
        ]
        pages = [f"/agents/{mine}", f"/episodes/{episode}"]
        owner = (await admin(http, "GET", "owners", name="one")).json()["items"][0]["id"]
        for collection, item in (("agents", mine), ("owners", owner)):
            for path in [*seen, *pages]:
                assert (await public(http, path)).status_code == 200, path
            assert await has_entry(http, mine)
            assert expect(await admin(http, "PUT", f"{collection}/{item}/hidden"), 200)["changed"] == 1
            assert expect(await admin(http, "PUT", f"{collection}/{item}/hidden"), 200)["changed"] == 0
            for path in [*seen, *pages, f"/v1/leaderboards/{SUITE}/compare?a=one&b=one"]:
                assert (await public(http, path)).status_code == 404, path
            assert not await has_entry(http, mine)
            assert mine not in (await public(http, "/agents")).text
            assert expect(await public(http, "/v1/agents?all=true"), 200)["agents"] == []
            summary = expect(await public(http, "/v1/leaderboards"), 200)["leaderboards"]
            assert all(board["entries"] == 0 for board in summary if board["suite"] == SUITE)
            for path in seen:
                assert (await http.get(path)).status_code == 200, path
            assert expect(await admin(http, "DELETE", f"{collection}/{item}/hidden"), 200)["changed"] == 1
        # A hidden evaluation still counts: the second one does not take its place.
        expect(await admin(http, "PUT", f"evaluations/{evaluation}/hidden", reason="driven by hand"), 200)
        assert not await has_entry(http, mine)
        assert (await public(http, f"/v1/evaluations/{second}")).status_code == 200
        assert [row["id"] for row in (await admin(http, "GET", "evaluations", hidden=True)).json()["items"]] == [
            evaluation
        ]
        log = expect(await admin(http, "GET", "audit"), 200)["entries"]
        assert [entry["action"] for entry in log] == ["hide", "unhide", "hide", "unhide", "hide"]
        assert log[0]["reason"] == "driven by hand"
        assert log[0]["name"] == "one"
        assert log[0]["actor"].startswith("operator ")


async def test_an_agent_is_deleted_with_all_that_hangs_on_it(database_url: str, tmp_path: Path) -> None:
    async with administered(tmp_path, database=database_url) as http:
        service, mine = service_of(http), await own_id(http)
        key = {"Idempotency-Key": str(uuid.uuid4())}
        done = await store_evaluation(service, mine, load_suite(SUITE))
        begun = expect(await http.post("/v1/evaluations", json={"suite": SUITE}, headers=key), 201)["id"]
        reset = await http.post(f"/v1/evaluations/{begun}/episodes", headers={"Idempotency-Key": "reset"})
        episode = expect(reset, 201)["id"]
        expect(await step(http, episode, 1), 200)
        practice = {"town": "Town01", "approach": "J3-S", "seed": 3}
        practised = expect(await http.post("/v1/episodes", json=practice, headers={"Idempotency-Key": "p"}), 201)
        assert service.episodes.open == 2
        await public(http, f"/agents/{mine}")  # pages keep what they show
        body = {"name": "other", "track": "privileged"}
        other = expect(await register(http, **body), 201)
        kept = await store_evaluation(service, other["id"], load_suite(SUITE))
        before = expect(await admin(http, "GET", f"agents/{mine}"), 200)["contents"]
        assert before["evaluations"] == 2
        assert before["replies"] == 3
        assert before["trajectories"] == len(load_suite(SUITE).episodes)

        gone = expect(await admin(http, "DELETE", f"agents/{mine}", reason="asked by mail"), 200)
        assert gone["deleted"] == before
        assert gone["name"] == "one"
        assert gone["deleted"]["owners"] == 1  # it was made with its agent
        assert sorted(gone["held"]) == ["the name 'one' of an agent", "the name 'one' of an owner"]
        assert await leftovers(service, mine, done, begun, episode, practised["id"]) == []
        assert service.episodes.open == 0
        problem(await step(http, episode, 2), 401, "unauthenticated")
        problem(await public(http, f"/v1/evaluations/{done}"), 401, "unauthenticated")
        problem(await public(http, f"/v1/agents/{mine}"), 404, "unknown-agent")
        assert not await has_entry(http, mine)
        # Others are as they were.
        assert await has_entry(http, other["id"])
        assert len(await service.finished.episodes(kept)) == len(load_suite(SUITE).episodes)

        # Again is no second deletion, and the name stays taken until the operator frees it.
        again = expect(await admin(http, "DELETE", f"agents/{mine}"), 200)
        assert set(again["deleted"].values()) == {0}
        problem(await register(http, name="One", track="camera"), 409, "agent-name-taken")
        assert expect(await admin(http, "DELETE", f"agents/{mine}", free=True), 200)["held"] == []
        expect(await register(http, name="One", track="camera"), 201)
        problem(await admin(http, "DELETE", "agents/ag_none"), 404, "unknown-agent")
        log = expect(await admin(http, "GET", "audit", target=mine), 200)["entries"]
        assert [entry["action"] for entry in log] == ["free", "delete"]
        assert log[1]["contents"] == before
        assert log[1]["reason"] == "asked by mail"


@pytest.mark.parametrize("free", [False, True])
async def test_the_place_of_a_deleted_evaluation(tmp_path: Path, free: bool) -> None:
    async with administered(tmp_path) as http:
        service, mine = service_of(http), await own_id(http)
        first = await store_evaluation(service, mine, load_suite(SUITE))
        second = await store_evaluation(service, mine, load_suite(SUITE), secret="another")
        third = await store_evaluation(service, mine, load_suite(SUITE), secret="a third")
        # One that does not count frees and holds nothing.
        assert expect(await admin(http, "DELETE", f"evaluations/{third}"), 200)["held"] == []
        assert await has_entry(http, mine)
        held = expect(await admin(http, "DELETE", f"evaluations/{first}", free=free), 200)["held"]
        assert held == ([] if free else [f"the place of agent {mine} on {SUITE}"])
        assert await leftovers(service, first, third) == []
        assert await has_entry(http, mine) is free
        assert (await service.finished.counting(mine)) == ({second} if free else set())
        expect(await admin(http, "DELETE", f"evaluations/{first}", free=True), 200)
        assert await has_entry(http, mine)


async def test_an_evaluation_that_runs_ends_when_it_is_deleted(tmp_path: Path) -> None:
    async with administered(tmp_path) as http:
        service = service_of(http)
        begun = expect(await http.post("/v1/evaluations", json={"suite": SUITE}), 201)
        row = await service.store.evaluation(begun["id"])
        assert row is not None
        expect(await admin(http, "DELETE", f"evaluations/{begun['id']}"), 200)
        # Nobody drove it, so the next one has its trials: a deletion is no way to an easier draw.
        again = expect(await http.post("/v1/evaluations", json={"suite": SUITE}), 201)["id"]
        newer = await service.store.evaluation(again)
        assert newer is not None
        assert newer.secret == row.secret
        headers = {"Idempotency-Key": "reset"}
        episode = expect(await http.post(f"/v1/evaluations/{again}/episodes", headers=headers), 201)["id"]
        expect(await step(http, episode, 1), 200)
        expect(await admin(http, "DELETE", f"evaluations/{again}"), 200)
        assert service.episodes.open == 0
        assert await leftovers(service, begun["id"], again, episode) == []
        problem(await step(http, episode, 2), 404, "unknown-episode")
        problem(await http.post(f"/v1/evaluations/{again}/episodes", headers=headers), 404, "unknown-evaluation")


async def test_an_owner_is_deleted_with_its_agents_and_submissions(database_url: str, tmp_path: Path) -> None:
    async with handing_in(tmp_path, database=database_url) as http:
        service = service_of(http)
        waiting = expect(await hand_in(http, Idempotency_Key="first"), 202)["id"]
        hers = await agent(http, "hers")
        agents = {"Authorization": f"Bearer {hers['token']}"}
        driven = expect(await http.post("/v1/evaluations", json={"suite": SUITE}, headers=agents), 201)["id"]
        await checked(http, waiting)
        evaluation, token = await running(http, waiting)
        found = expect(await admin(http, "GET", "owners", name="ADA"), 200)["items"]
        ada = found[0]["id"]
        detail = expect(await admin(http, "GET", f"owners/{ada}"), 200)
        assert {name: detail["contents"][name] for name in ("owners", "agents", "submissions", "models")} == {
            "owners": 1,
            "agents": 2,
            "submissions": 1,
            "models": 1,
        }
        assert service.submissions.files.path(waiting).is_file()
        (used,) = [one for one in expect(await admin(http, "GET", "usage"), 200)["owners"] if one["id"] == ada]
        assert used["contents"] == detail["contents"]
        gone = expect(await admin(http, "DELETE", f"owners/{ada}"), 200)
        assert gone["deleted"] == detail["contents"]
        assert not service.submissions.files.path(waiting).exists()
        assert await leftovers(service, ada, hers["id"], driven, waiting, evaluation) == []
        runner = {"Authorization": f"Bearer {token}"}
        for headers in (http.headers, agents, runner):
            refused = await http.post(f"/v1/evaluations/{evaluation}/episodes", headers=headers)
            problem(refused, 401, "unauthenticated")
        problem(await hand_in(http), 401, "unauthenticated")


async def test_a_submission_is_deleted_and_its_entry_stays(tmp_path: Path) -> None:
    async with handing_in(tmp_path) as http:
        service = service_of(http)
        submission = expect(await hand_in(http), 202)["id"]
        problem(await admin(http, "PUT", f"submissions/{submission}/hidden"), 422, "validation", "collection")
        problem(await admin(http, "DELETE", f"submissions/{submission}/tokens"), 422, "validation", "collection")
        listed = expect(await admin(http, "GET", "submissions", state="queued"), 200)["items"]
        assert [one["id"] for one in listed] == [submission]
        gone = expect(await admin(http, "DELETE", f"submissions/{submission}"), 200)["deleted"]
        assert (gone["submissions"], gone["models"]) == (1, 1)
        assert await leftovers(service, submission) == []
        problem(await http.get(f"/v1/submissions/{submission}"), 404, "unknown-submission")
        expect(await hand_in(http), 202)  # its name is free again


async def test_who_may_administer_and_what_is_refused(tmp_path: Path) -> None:
    async with administered(tmp_path) as http:
        mine = await own_id(http)
        paths = ("owners", "audit", "usage", f"agents/{mine}")
        for path in paths:
            problem(await http.get(f"/v1/admin/{path}"), 403, "forbidden")
            problem(await public(http, f"/v1/admin/{path}"), 401, "unauthenticated")
        guess = {"Authorization": "Bearer guess"}
        problem(await http.delete(f"/v1/admin/agents/{mine}", headers=guess), 401, "unauthenticated")
        problem(await http.delete(f"/v1/admin/agents/{mine}"), 403, "forbidden")
        shipped = expect(await admin(http, "GET", "owners", name="wrongturn"), 200)["items"][0]
        for method, path in (("DELETE", ""), ("PUT", "/hidden")):
            told = problem(await admin(http, method, f"owners/{shipped['id']}{path}"), 403, "forbidden")
            assert "shipped agents" in told["detail"]
        for path, query, field in (
            ("owners", {"suite": SUITE}, "query.suite"),
            ("agents", {"cursor": "nonsense"}, "query.cursor"),
            ("agents", {"cursor": "bmFuIGFnXzE="}, "query.cursor"),
            ("audit", {"cursor": "-1"}, "query.cursor"),
            ("audit", {"cursor": "bmFuIGFnXzE="}, "query.cursor"),
            ("agents", {"limit": 0}, "query.limit"),
            ("agents", {"name": "a\0b"}, "query"),
            ("cars", {}, "path.collection"),
        ):
            problem(await admin(http, "GET", path, **query), 422, "validation", field)
        for collection in ("owners", "agents", "evaluations", "submissions"):
            kind = f"unknown-{collection[:-1]}"
            assert (await admin(http, "DELETE", f"{collection}/%00")).status_code == 404
            for item in ("none", "x" * 500):
                problem(await admin(http, "GET", f"{collection}/{item}"), 404, kind)
                problem(await admin(http, "DELETE", f"{collection}/{item}"), 404, kind)
        too_long = await admin(http, "DELETE", f"agents/{mine}", reason="x" * 501)
        problem(too_long, 422, "validation", "query.reason")
        assert expect(await admin(http, "GET", "audit"), 200)["entries"] == []


async def test_lists_are_paged_and_filtered(tmp_path: Path) -> None:
    async with administered(tmp_path) as http:
        names = [f"agent {number}" for number in range(5)]
        for name in names:
            expect(await register(http, name=name, track="camera"), 201)
        with_token = httpx.AsyncClient(transport=http._transport, base_url="http://test", headers=BEARER)
        found = await pages(with_token, "/v1/admin/agents", "items", 2)
        assert [one["name"] for page in found for one in page] == [*reversed(names), "one"]
        assert len(expect(await admin(http, "GET", "agents", name="AGENT"), 200)["items"]) == 5
        assert expect(await admin(http, "GET", "agents", name="%"), 200)["items"] == []
        usage = expect(await admin(http, "GET", "usage", limit=3), 200)
        assert len(usage["owners"]) == 3
        assert usage["total"]["agents"] == 6
        rest = expect(await admin(http, "GET", "usage", cursor=usage["next"]), 200)
        assert len({one["id"] for one in usage["owners"] + rest["owners"]}) == usage["total"]["owners"]
        assert rest["next"] is None


async def test_tokens_are_revoked(tmp_path: Path) -> None:
    async with administered(tmp_path) as http:
        owner = expect(await register(http, "/v1/owners", name="ada", contact="ada@example.org"), 201)
        hers = {"Authorization": f"Bearer {owner['token']}"}
        body = {"name": "hers", "track": "camera"}
        made = expect(await http.post("/v1/agents", json=body, headers=hers), 201)
        listed = expect(await admin(http, "GET", "owners", name="ada"), 200)["items"]
        assert (listed[0]["contact"], listed[0]["token"]) == ("ada@example.org", True)
        assert expect(await admin(http, "DELETE", f"owners/{owner['id']}/tokens"), 200)["changed"] == 2
        assert expect(await admin(http, "DELETE", f"owners/{owner['id']}/tokens"), 200)["changed"] == 0
        headers = {"Authorization": f"Bearer {made['token']}"}
        problem(await http.post("/v1/evaluations", json={"suite": SUITE}, headers=headers), 401, "unauthenticated")
        problem(await http.post("/v1/agents", json=body, headers=hers), 401, "unauthenticated")
        # The operator makes new ones, and the log has that too.
        expect(await http.post(f"/v1/agents/{made['id']}/token", headers=BEARER), 201)
        expect(await http.post(f"/v1/owners/{owner['id']}/token", headers=BEARER), 201)
        log = expect(await admin(http, "GET", "audit"), 200)["entries"]
        assert [(entry["action"], entry["name"]) for entry in log] == [
            ("rotate", "ada"),
            ("rotate", "hers"),
            ("revoke", "ada"),
        ]


async def test_a_new_operators_token_needs_no_restart(tmp_path: Path) -> None:
    file = tmp_path / "operator_token"
    file.write_text(f"{OPERATOR}\n")
    async with application(tmp_path, operator_token_file=file) as http:
        expect(await admin(http, "GET", "owners"), 200)
        file.write_text("the-operators-next-token\n")
        problem(await admin(http, "GET", "owners"), 401, "unauthenticated")
        renewed = {"Authorization": "Bearer the-operators-next-token"}
        expect(await http.get("/v1/admin/owners", headers=renewed), 200)
        for content in ("", "short", "a token with spaces in it"):
            file.write_text(content)
            for token in (content or "x", OPERATOR, "the-operators-next-token"):
                headers = {"Authorization": f"Bearer {token}"}
                assert (await http.get("/v1/admin/owners", headers=headers)).status_code == 401
        file.unlink()
        problem(await http.get("/v1/admin/owners", headers=renewed), 401, "unauthenticated")
        file.write_text(OPERATOR)
        expect(await admin(http, "GET", "owners"), 200)
