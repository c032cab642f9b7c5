"""Each mistake of a caller gets its named problem and status, and nothing recorded is lost by it."""

import gzip
import json
from collections.abc import Iterator
from typing import Any

import httpx
import msgpack
import pytest
from service_harness import GAS, OPERATOR, Agent, RunningService, expect, patiently, problem

from wrongturn_protocol import ProblemType

STEP = {"seq": 1, "action": GAS}
JUNCTION = {"town": "junctions", "approach": "J1-S", "seed": 1}


@pytest.fixture(scope="module")
def agent(service: RunningService) -> Iterator[Agent]:
    """One for all, since nobody gets anywhere here."""
    with service.agent() as agent:
        yield agent


@pytest.fixture(scope="module")
def started(agent: Agent) -> str:
    return str(agent.practise()["id"])


@pytest.fixture
def episode(agent: Agent, started: str) -> Iterator[str]:
    """An episode before its first step, and still so after the test: whatever was refused was not done."""
    yield started
    assert expect(agent.http.get(f"/v1/episodes/{started}"), 200)["seq"] == 0


def raw_step(agent: Agent, episode: str, body: str | bytes, content_type: str = "application/json") -> httpx.Response:
    content = body.encode() if isinstance(body, str) else body
    return agent.http.post(f"/v1/episodes/{episode}/step", content=content, headers={"Content-Type": content_type})


@pytest.mark.parametrize(
    ("method", "path", "kind"),
    [
        ("GET", "/v1/suites/nope@1", "unknown-suite"),
        ("GET", "/v1/suites/nope@1/trials", "unknown-suite"),
        ("GET", "/v1/suites/%00", "unknown-route"),
        ("GET", "/v1/agents/%00", "unknown-route"),
        ("GET", "/v1/episodes/ep%00/trajectory", "unknown-route"),
        ("GET", "/agents/%00", "unknown-route"),
        ("GET", "/v1/suites/..%2F..%2Fetc", "unknown-route"),
        ("GET", "/v1/towns/Town99", "unknown-town"),
        ("GET", "/v1/agents/nobody", "unknown-agent"),
        ("GET", "/v1/leaderboards/nope@1", "unknown-suite"),
        ("GET", "/v1/evaluations/none", "unknown-evaluation"),
        ("DELETE", "/v1/evaluations/none", "unknown-evaluation"),
        ("POST", "/v1/evaluations/none/episodes", "unknown-evaluation"),
        ("GET", "/v1/evaluations/none/episodes?state=open", "unknown-evaluation"),
        ("GET", "/v1/episodes/none", "unknown-episode"),
        ("GET", "/v1/episodes/none/trajectory", "unknown-episode"),
        ("GET", "/v1/episodes/none/camera/0", "unknown-episode"),
        ("GET", "/v1/episodes/none/view", "unknown-episode"),
        ("GET", "/v1/episodes/none/picture.png", "unknown-episode"),
        ("DELETE", "/v1/episodes/none", "unknown-episode"),
        ("POST", "/v1/agents/nobody/token", "unknown-agent"),
        ("GET", "/problems/none", "unknown-route"),
        ("GET", "/nowhere", "unknown-route"),
        ("GET", "/v1/suites/", "unknown-route"),
    ],
)
def test_what_is_unknown_is_named(agent: Agent, method: str, path: str, kind: str) -> None:
    # The operator may look for any agent.
    headers = {"Authorization": f"Bearer {OPERATOR}"} if kind == "unknown-agent" else None
    problem(agent.http.request(method, path, headers=headers), 404, kind)


def test_text_that_no_database_takes_is_refused(agent: Agent) -> None:
    problem(agent.http.get("/v1/leaderboards/smoke@3/compare?a=%00&b=x"), 422, "validation", "query")
    nul = "a\0b"
    problem(agent.http.post("/v1/owners", json={"name": "nul", "contact": nul}), 422, "validation", "contact")
    for field, value in (("description", nul), ("homepage", "http://" + nul)):
        body = {"name": "nul", "track": "state", field: value}
        problem(agent.http.post("/v1/agents", json=body), 422, "validation", field)


@pytest.mark.parametrize(
    ("body", "status", "kind", "path"),
    [
        ({"suite": "nope@1", "trial": "x"}, 404, "unknown-suite", "suite"),
        ({"suite": "smoke@3", "trial": "nope"}, 404, "unknown-trial", "trial"),
        ({"town": "Town99", "approach": "J3-S"}, 404, "unknown-town", "town"),
        ({"town": "Town01", "approach": "J99-N"}, 404, "unknown-approach", "approach"),
        ({"town": "Town01", "approach": "J3-S", "fault": "nope"}, 422, "validation", "fault"),
        ({"town": "Town01", "approach": "J3-S", "fault": "custom"}, 422, "fault-not-applicable", "fault"),
        (
            {"town": "Town01", "approach": "J3-S", "fault": {"kind": "late", "dose": 99}},
            422,
            "fault-not-applicable",
            None,
        ),
        ({"town": "Town01", "approach": "J3-S", "track": "nope"}, 422, "validation", "track"),
        ({"town": "Town01", "approach": "J3-S", "seed": -1}, 422, "validation", "seed"),
        ({"town": "Town01", "approach": "J3-S", "seed": 2**63}, 422, "validation", "seed"),
        ({"town": "Town01", "approach": "J3-S", "seed": 1.5}, 422, "validation", "seed"),
        ({"town": "Town01", "approach": "J3-S", "route": 4}, 422, "validation", "route"),
        ({"town": "Town01", "approach": "J3-S", "weather": "Snow"}, 422, "validation", "weather"),
        ({"town": "Town01"}, 422, "validation", "body"),
        ({"suite": "smoke@3"}, 422, "validation", "body"),
        ({}, 422, "validation", "body"),
        ({"town": "Town01", "approach": "J3-S", "extra": 1}, 422, "validation", "extra"),
        ({"town": "x" * 10_000, "approach": "J3-S"}, 404, "unknown-town", "town"),
        ({"town": "Town01", "task": "wander"}, 422, "validation", "task"),
        ({"town": "Town01", "task": "navigation", "fault": "infeasible"}, 422, "validation", "body"),
        ({"town": "Town01", "task": "navigation", "route": 1}, 422, "validation", "body"),
        ({"town": "Town01", "task": "cruise", "approach": "J1-S"}, 422, "validation", "body"),
        ({"suite": "smoke@3", "trial": "x", "task": "navigation"}, 422, "validation", "body"),
        ({"town": "Atlantis", "task": "navigation"}, 404, "unknown-town", "town"),
        ({"town": "Town01", "task": "navigation", "approach": "J99-S"}, 404, "unknown-approach", "approach"),
        ({**JUNCTION, "traffic": {"vehicles": -1}}, 422, "validation", "traffic.vehicles"),
        ({**JUNCTION, "traffic": {"vehicles": 201}}, 422, "validation", "traffic.vehicles"),
        ({**JUNCTION, "traffic": {"vehicles": 200}}, 422, "validation", "traffic.vehicles"),  # no room
        ({**JUNCTION, "traffic": {"pedestrians": 1.5}}, 422, "validation", "traffic.pedestrians"),
        ({**JUNCTION, "traffic": {"pedestrians": "many"}}, 422, "validation", "traffic.pedestrians"),
        ({**JUNCTION, "traffic": {"bicycles": 1}}, 422, "validation", "traffic.bicycles"),
        ({**JUNCTION, "traffic": 20}, 422, "validation", "traffic"),
        ({"suite": "smoke@3", "trial": "x", "traffic": {"vehicles": 5}}, 422, "validation", "body"),
    ],
)
def test_a_practice_episode_that_cannot_be(
    agent: Agent, body: dict[str, Any], status: int, kind: str, path: str | None
) -> None:
    told = problem(agent.http.post("/v1/episodes", json=body), status, kind, path)
    assert len(json.dumps(told)) < 5000


def test_a_route_that_the_approach_lacks(agent: Agent) -> None:
    refused = []
    for route in (1, 2, 3):
        body = {"town": "Town01", "approach": "J3-S", "route": route}
        response = patiently(lambda body=body: agent.http.post("/v1/episodes", json=body))
        if response.status_code != 201:
            refused.append(problem(response, 422, "validation", "route"))
        else:
            agent.http.delete(f"/v1/episodes/{response.json()['id']}")
    assert len(refused) == 1


@pytest.mark.parametrize("suite", ["nope@1", "smoke@99", "smoke", ""])
def test_an_evaluation_of_an_unknown_suite(agent: Agent, suite: str) -> None:
    problem(agent.http.post("/v1/evaluations", json={"suite": suite}), 404, "unknown-suite", "suite")


def test_an_evaluation_in_a_track_that_the_suite_lacks(service: RunningService) -> None:
    with service.agent(track="state") as agent:
        problem(agent.http.post("/v1/evaluations", json={"suite": "smoke@3"}), 422, "track-not-available", "suite")


@pytest.mark.parametrize(
    "value", ["NaN", "Infinity", "-Infinity", "1e999", "1.0001", "-1.0001", "null", '"0"', "true", "[]"]
)
def test_an_action_that_is_none(agent: Agent, episode: str, value: str) -> None:
    for field in GAS:
        action = {**dict.fromkeys(GAS, "0"), field: value}
        text = ", ".join(f'"{name}": {number}' for name, number in action.items())
        response = raw_step(agent, episode, f'{{"seq": 1, "action": {{{text}}}}}')
        problem(response, 422, "validation", f"action.{field}")
        assert not any(word in response.text for word in ("NaN", "Infinity", "1e999"))


def test_a_step_with_wrong_fields(agent: Agent, episode: str) -> None:
    for body, path in (
        ({"seq": 1, "action": {"steer": 0, "throttle": 0}}, "action.brake"),
        ({"seq": 1, "action": {**GAS, "gear": 1}}, "action.gear"),
        ({"action": GAS}, "seq"),
        ({"seq": 1}, "action"),
        *(({"seq": seq, "action": GAS}, "seq") for seq in (0, -1, "1", 1.5, True, None)),
    ):
        problem(agent.http.post(f"/v1/episodes/{episode}/step", json=body), 422, "validation", path)
    for value in (float("nan"), float("inf"), "0", None, 2):
        packed = msgpack.packb({"seq": 1, "action": {**GAS, "steer": value}})
        problem(raw_step(agent, episode, packed, "application/msgpack"), 422, "validation", "action.steer")
    for seq in (10**400, 2**64):
        problem(raw_step(agent, episode, json.dumps({"seq": seq, "action": GAS})), 409, "sequence-gap")


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b"nonsense",
        b'{"seq": 1, "action": }',
        b'{"seq": 1} {"seq": 2}',
        b"\xff\xfe",
        b'{"seq": "\xe9"}',
        b"[" * 4000,
        b'{"a":' * 800,
    ],
    ids=["empty", "cut off", "word", "no value", "two", "no utf-8", "latin-1", "deep list", "deep object"],
)
def test_a_body_that_is_no_json(agent: Agent, episode: str, body: bytes) -> None:
    problem(raw_step(agent, episode, body), 400, "malformed-body")
    problem(agent.http.post("/v1/episodes", content=body), 400, "malformed-body")
    problem(agent.http.post("/v1/evaluations", content=body), 400, "malformed-body")
    problem(agent.http.post("/v1/agents", content=body), 400, "malformed-body")


def test_bodies_that_are_no_message(agent: Agent, episode: str) -> None:
    for packed in (b"", b"\xc1", b"\x81\xa3seq", b"\x91" * 4000, b"\x81\x90\x01"):
        problem(raw_step(agent, episode, packed, "application/msgpack"), 400, "malformed-body")
    for body in ("NaN", "Infinity", "-Infinity", "[]", "3", '"word"', "null", '{"seq": NaN, "action": NaN}'):
        response = raw_step(agent, episode, body)
        problem(response, 422, "validation")
        assert "NaN" not in response.text


def test_another_content_type(agent: Agent, episode: str) -> None:
    problem(raw_step(agent, episode, json.dumps(STEP), "text/plain"), 415, "unsupported-media-type")
    response = agent.http.post("/v1/evaluations", data={"suite": "smoke@3"})
    problem(response, 415, "unsupported-media-type")
    # msgpack is for episodes alone.
    response = agent.http.post("/v1/evaluations", content=b"\x80", headers={"Content-Type": "application/msgpack"})
    problem(response, 415, "unsupported-media-type")


def test_a_compressed_body(agent: Agent) -> None:
    body = gzip.compress(b'{"suite": "smoke@3"}')
    for sent in ({"Content-Encoding": "gzip"}, [("Content-Encoding", "identity"), ("Content-Encoding", "br")]):
        response = agent.http.post("/v1/evaluations", content=body, headers=sent)
        told = problem(response, 415, "unsupported-media-type")
        assert "without compression" in str(told)
        assert response.headers["Accept-Encoding"] == "identity"
    plain = agent.http.post("/v1/evaluations", json={"suite": "nope@1"}, headers={"Content-Encoding": "Identity"})
    problem(plain, 404, "unknown-suite")


def test_an_encoding_that_is_not_spoken(agent: Agent, episode: str) -> None:
    response = agent.http.get(f"/v1/episodes/{episode}", headers={"Accept": "image/png"})
    problem(response, 406, "not-acceptable")


def test_a_body_that_is_too_large(agent: Agent, episode: str) -> None:
    for path, limit in {
        "/v1/owners": 8192,
        "/v1/agents": 32768,
        "/v1/evaluations": 4096,
        "/v1/episodes": 16384,
        f"/v1/episodes/{episode}/step": 4096,
    }.items():
        headers = {"Content-Type": "application/json"}
        problem(agent.http.post(path, content=b" " * limit, headers=headers), 400, "malformed-body")
        told = problem(agent.http.post(path, content=b" " * (limit + 1), headers=headers), 413, "body-too-large")
        assert str(limit) in told["detail"]

    def pieces() -> Any:
        for _ in range(5):
            yield b" " * 1024 * 1024

    response = agent.http.post(
        f"/v1/episodes/{episode}/step", content=pieces(), headers={"Content-Type": "application/json"}
    )
    problem(response, 413, "body-too-large")


TOKEN_CALLS = [
    ("POST", "/v1/evaluations"),
    ("GET", "/v1/evaluations/{evaluation}"),
    ("DELETE", "/v1/evaluations/{evaluation}"),
    ("POST", "/v1/evaluations/{evaluation}/episodes"),
    ("GET", "/v1/evaluations/{evaluation}/episodes?state=open"),
    ("PUT", "/v1/evaluations/{evaluation}/results"),
    ("POST", "/v1/episodes"),
    ("POST", "/v1/episodes/{episode}/step"),
    ("GET", "/v1/episodes/{episode}"),
    ("GET", "/v1/episodes/{episode}/trajectory"),
    ("GET", "/v1/episodes/{episode}/camera/0"),
    ("GET", "/v1/episodes/{episode}/view"),
    ("GET", "/v1/episodes/{episode}/picture.png"),
    ("DELETE", "/v1/episodes/{episode}"),
    ("POST", "/v1/agents/{agent}/token"),
    ("DELETE", "/v1/agents/{agent}/token"),
]
BODIES = {
    "/v1/evaluations": {"suite": "smoke@3"},
    "/v1/evaluations/{evaluation}/results": {"episodes": []},
    "/v1/episodes": {"town": "Town01", "approach": "J3-S"},
    "/v1/episodes/{episode}/step": STEP,
}


@pytest.fixture(scope="module")
def owned(service: RunningService) -> Any:
    """Things of an agent whom no test disturbs."""
    with service.agent() as owner:
        evaluation = owner.evaluate()["id"]
        episode = expect(owner.reset(evaluation), 201)["id"]
        yield {"agent": owner.id, "evaluation": evaluation, "episode": episode}
        # Still open and as it was.
        assert expect(owner.http.get(f"/v1/episodes/{episode}"), 200)["state"] == "open"


@pytest.mark.parametrize(("method", "path"), TOKEN_CALLS)
def test_a_call_without_a_good_token(service: RunningService, owned: dict[str, str], method: str, path: str) -> None:
    with httpx.Client(base_url=service.url, timeout=60) as http:
        for header in (None, "", "Bearer", "Bearer nope", "Basic abc", "Bearer \xe9"):
            headers = {} if header is None else {"Authorization": header.encode("latin-1")}
            response = http.request(method, path.format(**owned), headers=headers, json=BODIES.get(path))
            problem(response, 401, "unauthenticated")
            assert response.headers["www-authenticate"].startswith("Bearer")


@pytest.mark.parametrize(("method", "path"), [call for call in TOKEN_CALLS if "{" in call[1]])
def test_a_call_with_anothers_token(agent: Agent, owned: dict[str, str], method: str, path: str) -> None:
    response = agent.http.request(method, path.format(**owned), json=BODIES.get(path))
    problem(response, 403, "forbidden")


def test_every_problem_is_explained(agent: Agent) -> None:
    for kind in ProblemType:
        response = agent.http.get(f"/problems/{kind}")
        assert response.status_code == 200
        assert len(response.text) > 30
