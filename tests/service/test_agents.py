"""Registration, tokens, and that a request that is sent again does nothing again."""

import uuid
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest
import service_harness
from service_harness import Agent, RunningService, expect, problem

OPERATOR = {"Authorization": f"Bearer {service_harness.OPERATOR}"}


def name() -> str:
    return f"agent {uuid.uuid4().hex[:10]}"


def test_an_agent_is_registered_and_listed(http: httpx.Client) -> None:
    body = {
        "name": name(),
        "track": "camera",
        "description": "tries",
        "homepage": "https://example.org:8000/@x?a=b@c",
        "trained_on_faults": True,
    }
    agent = expect(http.post("/v1/agents", json=body), 201)
    token = agent.pop("token")
    assert token.startswith("wt_")
    assert agent == {**body, "id": agent["id"], "kind": "submitted", "owner": body["name"]}
    assert expect(http.get(f"/v1/agents/{agent['id']}"), 200) == agent
    listed = expect(http.get("/v1/agents", params={"all": True, "limit": 500}), 200)["agents"]
    assert agent in listed
    assert token not in str(listed)


def test_a_name_is_taken_once(http: httpx.Client) -> None:
    taken = name()
    expect(http.post("/v1/agents", json={"name": taken, "track": "camera"}), 201)
    problem(http.post("/v1/agents", json={"name": taken, "track": "camera"}), 409, "agent-name-taken")
    problem(http.post("/v1/agents", json={"name": taken.upper(), "track": "camera"}), 409, "agent-name-taken")


@pytest.mark.parametrize(
    ("body", "path"),
    [
        ({"track": "camera"}, "name"),
        ({"name": "", "track": "camera"}, "name"),
        ({"name": "x" * 65, "track": "camera"}, "name"),
        ({"name": "<script>", "track": "camera"}, "name"),
        ({"name": "x", "track": "radar"}, "track"),
        ({"name": "x", "track": "camera", "homepage": "javascript:alert(1)"}, "homepage"),
        ({"name": "x", "track": "camera", "homepage": "https://example.org@elsewhere.example/"}, "homepage"),
        ({"name": "x", "track": "camera", "homepage": "https://elsewhere.example\\@example.org"}, "homepage"),
        ({"name": "x", "track": "camera", "homepage": "https:///x"}, "homepage"),
        ({"name": "x", "track": "camera", "description": "x" * 2001}, "description"),
        ({"name": "x", "track": "camera", "kind": "winner"}, "kind"),
        ({"name": "x", "track": "camera", "trained_on_faults": "perhaps"}, "trained_on_faults"),
    ],
)
def test_a_registration_that_is_none(http: httpx.Client, body: dict[str, str], path: str) -> None:
    told = problem(http.post("/v1/agents", json=body), 422, "validation", path)
    if isinstance(body.get("name"), str) and path == "name":
        assert "beginning with a letter or digit" in told["detail"]
    if path == "homepage":
        assert "without a user" in told["detail"]


def test_a_token_is_rotated_and_revoked(service: RunningService, agent: Agent, other: Agent) -> None:
    url = f"/v1/agents/{agent.id}/token"
    agent.evaluate()
    problem(other.http.post(url), 403, "forbidden")
    key = {"Idempotency-Key": str(uuid.uuid4())}
    lost = expect(agent.http.post(url, headers=key), 201)
    # The reply may have been lost: the repeat comes with the old token, which opens nothing else any more.
    rotated = expect(agent.http.post(url, headers=key), 201)
    assert lost["token"] != rotated["token"]
    with Agent(service.url, lost) as ended:
        problem(ended.http.post("/v1/evaluations", json={"suite": "smoke@3"}), 401, "unauthenticated")
    problem(agent.http.post("/v1/evaluations", json={"suite": "smoke@3"}), 401, "unauthenticated")
    with Agent(service.url, rotated) as renewed:
        renewed.evaluate("wrong-command@3")
        assert renewed.http.delete(url).status_code == 204
        problem(renewed.http.post("/v1/evaluations", json={"suite": "smoke@3"}), 401, "unauthenticated")
        problem(renewed.http.delete(url), 401, "unauthenticated")
    with httpx.Client(base_url=service.url, timeout=60) as operator:
        fresh = expect(operator.post(url, headers=OPERATOR), 201)
        assert operator.delete(url, headers=OPERATOR).status_code == 204
    with Agent(service.url, fresh) as revoked:
        problem(revoked.http.post("/v1/evaluations", json={"suite": "smoke@3"}), 401, "unauthenticated")


def test_a_registration_again_by_its_key(service: RunningService, http: httpx.Client) -> None:
    key = {"Idempotency-Key": str(uuid.uuid4())}
    body = {"name": name(), "track": "camera"}
    with ThreadPoolExecutor(4) as threads:
        replies = list(threads.map(lambda _: expect(http.post("/v1/agents", json=body, headers=key), 201), range(4)))
    assert len({reply["id"] for reply in replies}) == 1
    told = problem(http.post("/v1/agents", json={**body, "name": name()}, headers=key), 422, "idempotency-key-reused")
    assert told["errors"][0]["path"] == "Idempotency-Key"
    tokens = [reply["token"] for reply in replies]
    asked = [
        http.delete(f"/v1/agents/{replies[0]['id']}/token", headers={"Authorization": f"Bearer {t}"}) for t in tokens
    ]
    assert sorted(reply.status_code for reply in asked) == [204, 401, 401, 401], "the last token is good"
    # Nothing on the disk tells the token.
    for path in service.database.parent.glob("wrongturn.db*"):
        assert replies[0]["token"].encode() not in path.read_bytes()


def test_keys_belong_to_their_owners(agent: Agent, other: Agent) -> None:
    key = {"Idempotency-Key": "the same word"}
    one = expect(agent.http.post("/v1/evaluations", json={"suite": "smoke@3"}, headers=key), 201)
    again = expect(agent.http.post("/v1/evaluations", json={"suite": "smoke@3"}, headers=key), 201)
    another = expect(other.http.post("/v1/evaluations", json={"suite": "smoke@3"}, headers=key), 201)
    assert one == again
    assert one["id"] != another["id"]
    response = agent.http.post("/v1/evaluations", json={"suite": "wrong-command@3"}, headers=key)
    problem(response, 422, "idempotency-key-reused")


@pytest.mark.parametrize("key", ["", "x" * 256, "\xe9", "a\tb"])
def test_a_key_that_is_none(agent: Agent, key: str) -> None:
    headers = {"Idempotency-Key": key.encode("latin-1")}
    response = agent.http.post("/v1/evaluations", json={"suite": "smoke@3"}, headers=headers)
    problem(response, 422, "validation", "Idempotency-Key")
