"""Owners answer for agents: who may register one, what its token opens, and who sees what of it."""

import uuid
from pathlib import Path

import httpx
import pytest
import service_harness
from app_harness import application, register
from service_harness import expect, problem

OPERATOR = {"Authorization": f"Bearer {service_harness.OPERATOR}"}


def name() -> str:
    return f"owner {uuid.uuid4().hex[:10]}"


def bearer(registered: dict[str, str]) -> dict[str, str]:
    return {"Authorization": f"Bearer {registered['token']}"}


def test_an_owner_is_registered_and_its_contact_is_nobodys(http: httpx.Client) -> None:
    wanted = name()
    owner = expect(http.post("/v1/owners", json={"name": wanted, "contact": "us@example.org"}), 201)
    assert set(owner) == {"id", "name", "token"}
    shown = {"id": owner["id"], "name": wanted}
    assert expect(http.get(f"/v1/owners/{owner['id']}"), 200) == shown
    assert shown in expect(http.get("/v1/owners?limit=500"), 200)["owners"]
    assert "us@example.org" not in http.get("/v1/owners?limit=500").text
    problem(http.get("/v1/owners/ow_none"), 404, "unknown-owner")
    problem(http.post("/v1/owners", json={"name": wanted.upper()}), 409, "owner-name-taken")
    problem(http.post("/v1/owners", json={"name": "<b>"}), 422, "validation", "name")


def test_an_owners_agents(http: httpx.Client) -> None:
    owner = expect(http.post("/v1/owners", json={"name": name()}), 201)
    agents = [
        expect(http.post("/v1/agents", json={"name": name(), "track": track}, headers=bearer(owner)), 201)
        for track in ("camera", "privileged")
    ]
    assert [agent["owner"] for agent in agents] == [owner["name"]] * 2
    assert expect(http.get(f"/v1/agents/{agents[0]['id']}"), 200)["owner"] == owner["name"]
    kind = {"name": name(), "track": "camera", "kind": "exploit"}
    problem(http.post("/v1/agents", json=kind, headers=bearer(owner)), 403, "forbidden")
    # An agent's token registers nobody, and an owner's drives nothing.
    body = {"name": name(), "track": "camera"}
    told = problem(http.post("/v1/agents", json=body, headers=bearer(agents[0])), 403, "forbidden")
    assert "agent's token" in told["detail"]
    problem(http.post("/v1/agents", json=body, headers={"Authorization": "Bearer guess"}), 401, "unauthenticated")
    problem(http.post("/v1/evaluations", json={"suite": "smoke@3"}, headers=bearer(owner)), 401, "unauthenticated")
    # The same tokens register no owner either.
    another = {"name": name()}
    told = problem(http.post("/v1/owners", json=another, headers=bearer(agents[0])), 403, "forbidden")
    assert "register an owner without a token" in told["detail"]
    problem(http.post("/v1/owners", json=another, headers={"Authorization": "Bearer guess"}), 401, "unauthenticated")
    problem(http.post("/v1/owners", json=another, headers={"Authorization": "Basic guess"}), 401, "unauthenticated")
    assert another["name"] not in {one["name"] for one in expect(http.get("/v1/owners?limit=500"), 200)["owners"]}
    for call in (http.post, http.delete):
        told = problem(call(f"/v1/owners/{owner['id']}/token", headers=bearer(agents[0])), 403, "forbidden")
        assert "send this owner's own token, or the operator's" in told["detail"]


def test_an_owner_renews_and_revokes_its_agents_tokens(http: httpx.Client) -> None:
    owner, stranger = (expect(http.post("/v1/owners", json={"name": name()}), 201) for _ in range(2))
    agent = expect(http.post("/v1/agents", json={"name": name(), "track": "camera"}, headers=bearer(owner)), 201)
    url = f"/v1/agents/{agent['id']}/token"
    problem(http.post(url, headers=bearer(stranger)), 403, "forbidden")
    fresh = expect(http.post(url, headers=bearer(owner)), 201)
    problem(http.delete(url, headers=bearer(agent)), 401, "unauthenticated")
    assert http.delete(url, headers=bearer(owner)).status_code == 204
    problem(http.delete(url, headers=bearer(fresh)), 401, "unauthenticated")


def test_an_owners_token_is_rotated_and_revoked(http: httpx.Client) -> None:
    owner, stranger = (expect(http.post("/v1/owners", json={"name": name()}), 201) for _ in range(2))
    url = f"/v1/owners/{owner['id']}/token"
    problem(http.post(url), 401, "unauthenticated")
    problem(http.post(url, headers=bearer(stranger)), 403, "forbidden")
    key = {"Idempotency-Key": str(uuid.uuid4())}
    lost = expect(http.post(url, headers={**bearer(owner), **key}), 201)
    rotated = expect(http.post(url, headers={**bearer(owner), **key}), 201)
    assert (rotated["id"], rotated["name"]) == (owner["id"], owner["name"])
    body = {"name": name(), "track": "camera"}
    for ended in (owner, lost):
        problem(http.post("/v1/agents", json=body, headers=bearer(ended)), 401, "unauthenticated")
    assert http.delete(url, headers=bearer(rotated)).status_code == 204
    problem(http.post(url, headers={**bearer(owner), **key}), 401, "unauthenticated")
    problem(http.post("/v1/agents", json=body, headers=bearer(rotated)), 401, "unauthenticated")
    fresh = expect(http.post(url, headers=OPERATOR), 201)
    assert expect(http.post("/v1/agents", json=body, headers=bearer(fresh)), 201)["owner"] == owner["name"]


def test_an_agent_without_an_owner_gets_one_of_its_name(http: httpx.Client) -> None:
    body = {"name": name(), "track": "camera"}
    agent = expect(http.post("/v1/agents", json=body), 201)
    assert agent["owner"] == body["name"]
    problem(http.post("/v1/owners", json={"name": body["name"]}), 409, "owner-name-taken")
    owner = expect(http.post("/v1/owners", json={"name": name()}), 201)
    problem(http.post("/v1/agents", json={"name": owner["name"], "track": "camera"}), 409, "owner-name-taken")
    own = expect(http.post("/v1/agents", json={"name": owner["name"], "track": "camera"}, headers=bearer(owner)), 201)
    assert own["owner"] == owner["name"]


def test_shipped_agents_belong_to_wrongturn(http: httpx.Client) -> None:
    for kind, owner in (("baseline", "Wrongturn"), ("exploit", "Wrongturn"), ("submitted", None)):
        body = {"name": name(), "track": "camera", "kind": kind}
        agent = expect(http.post("/v1/agents", json=body, headers=OPERATOR), 201)
        assert agent["owner"] == (owner or body["name"])
    problem(http.post("/v1/owners", json={"name": "wrongturn"}), 409, "owner-name-taken")
    problem(http.post("/v1/agents", json={"name": "Wrongturn", "track": "camera"}), 409, "owner-name-taken")


@pytest.mark.parametrize("taken", ["operator", "Admin", "ow_ae118531a1c30f924bef7819"])
def test_names_that_mislead_are_reserved(http: httpx.Client, taken: str) -> None:
    owner = expect(http.post("/v1/owners", json={"name": name()}), 201)
    agent = {"name": taken, "track": "camera"}
    problem(http.post("/v1/owners", json={"name": taken}), 409, "owner-name-taken")
    problem(http.post("/v1/agents", json=agent), 409, "agent-name-taken")
    told = problem(http.post("/v1/agents", json=agent, headers=bearer(owner)), 409, "agent-name-taken")
    assert "is reserved" in told["detail"]


@pytest.mark.parametrize("taken", ["careful", "Carefu1", "PPO image"])
def test_names_of_shipped_agents_are_for_the_operator(http: httpx.Client, taken: str) -> None:
    told = problem(http.post("/v1/agents", json={"name": taken, "track": "camera"}), 409, "agent-name-taken")
    assert "comes with Wrongturn" in told["detail"]


def test_a_registration_again_by_its_key(http: httpx.Client) -> None:
    key = {"Idempotency-Key": str(uuid.uuid4())}
    body, agent = {"name": name()}, {"name": name(), "track": "camera"}
    lost = expect(http.post("/v1/owners", json=body, headers=key), 201)
    owner = expect(http.post("/v1/owners", json=body, headers=key), 201)
    assert owner["id"] == lost["id"]
    problem(http.post("/v1/agents", json=agent, headers=bearer(lost)), 401, "unauthenticated")
    registered = expect(http.post("/v1/agents", json=agent, headers={**bearer(owner), **key}), 201)
    # A token that was revoked does not come back by the key of its registration.
    assert http.delete(f"/v1/agents/{registered['id']}/token", headers=OPERATOR).status_code == 204
    problem(http.post("/v1/agents", json=agent, headers={**bearer(owner), **key}), 409, "agent-name-taken")
    expect(http.post(f"/v1/owners/{owner['id']}/token", headers=OPERATOR), 201)
    problem(http.post("/v1/owners", json=body, headers=key), 409, "owner-name-taken")


async def test_where_the_operator_registers_owners_they_register_agents(tmp_path: Path) -> None:
    async with application(tmp_path, registration="operator", operator_token="secret") as http:
        body = {"name": "one", "track": "camera"}
        problem(await register(http, **body), 403, "registration-closed")
        problem(await register(http, "/v1/owners", name="us"), 403, "registration-closed")
        operator = {"Authorization": "Bearer secret"}
        owner = expect(await http.post("/v1/owners", json={"name": "us"}, headers=operator), 201)
        expect(await http.post("/v1/agents", json=body, headers=bearer(owner)), 201)
