"""A runner's token is good for its submission alone: every call with it, over HTTP and the socket, and its end."""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from drive_socket import DriveSocket
from model_form import TYPE, model
from service_harness import COAST, expect, problem
from submission_story import TakingService, agent, begun, checked, hand_in, looked_at, running, service_of, story
from test_submissions import NAMELESS, bearer
from websockets.exceptions import ConnectionClosed, InvalidStatus

from wrongturn_protocol import SubmissionState
from wrongturn_service.api import examples
from wrongturn_service.api.documents import built
from wrongturn_service.submissions.operations import OverError

STEP = {"seq": 1, "action": COAST}
RECORD: dict[str, Any] = {"episodes": []}


async def targets(http: httpx.AsyncClient) -> tuple[dict[str, dict[str, str]], dict[str, str]]:
    """By the state of a submission: ids of what belongs to it and what does not; and the runners' tokens."""
    stranger = await agent(http, "stranger")
    as_stranger = bearer(stranger["token"])
    foreign = expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}, headers=as_stranger), 201)["id"]
    foreign_episode = expect(await http.post(f"/v1/evaluations/{foreign}/episodes", headers=as_stranger), 201)["id"]
    other = {"evaluation": foreign, "episode": foreign_episode, "agent": stranger["id"]}
    found = {"other": other}
    tokens = {}
    for state in ("queued", "running"):
        submission = expect(await hand_in(http, model(name=state)), 202)["id"]
        tokens[state] = await checked(http, submission)
        if state == "queued":
            reset = await http.post("/v1/episodes", json=PRACTICE, headers=bearer(tokens[state]))
        else:
            evaluation, tokens[state] = await running(http, submission)
            reset = await http.post(f"/v1/evaluations/{evaluation}/episodes", headers=bearer(tokens[state]))
        shown = expect(await http.get(f"/v1/submissions/{submission}"), 200)
        own = {"agent": shown["agent"], "submission": submission, "episode": expect(reset, 201)["id"]}
        own["evaluation"] = shown.get("evaluation", foreign)
        found[state] = own
    owners = expect(await http.get("/v1/owners"), 200)["owners"]
    for own in found.values():
        own["owner"] = next(one["id"] for one in owners if one["name"] == "ada")
        own |= {"suite": "smoke@3", "town": "Town01", "kind": "validation", "sheet": "0"}
        own |= {"collection": "agents", "item": stranger["id"]}
        own.setdefault("submission", found["running"]["submission"])
    return found, tokens


PRACTICE = {"town": "Town01", "approach": "J3-S", "seed": 3}
BODIES: dict[str, Any] = {
    "POST /v1/owners": {"name": "new owner"},
    "POST /v1/agents": {"name": "new agent", "track": "camera"},
    "POST /v1/evaluations": {"suite": "wrong-command@3"},
    "POST /v1/episodes": PRACTICE,
    "POST /v1/episodes/{episode}/step": STEP,
    "PUT /v1/evaluations/{evaluation}/results": RECORD,
    "POST /v1/whatifs": {"episode": "ep_0", "at": 1.0},
    "POST /v1/judgements": next(one["request"] for one in examples.load() if one["call"] == "POST /v1/judgements"),
}
OF_EPISODES = {
    "GET /v1/episodes/{episode}": {200},
    "POST /v1/episodes/{episode}/step": {200},
    "GET /v1/episodes/{episode}/trajectory": {409},  # it is open
    "GET /v1/episodes/{episode}/camera/{sheet}": {409},
    "GET /v1/episodes/{episode}/picture.png": {409},
    "DELETE /v1/episodes/{episode}": {204},
}
GOOD_FOR = {
    "queued": {**OF_EPISODES, "POST /v1/episodes": {201}, "POST /v1/whatifs": {404}},  # there is no such episode
    "running": {
        **OF_EPISODES,
        "GET /v1/evaluations/{evaluation}": {200},
        "GET /v1/evaluations/{evaluation}/certificate": {409},
        "GET /v1/evaluations/{evaluation}/episodes": {200},
        "POST /v1/evaluations/{evaluation}/episodes": {201},
        "PUT /v1/evaluations/{evaluation}/results": {200},
    },
}
"""What a runner's token is good for, with the statuses of good replies."""


@pytest.mark.parametrize("state", ["queued", "running"])
@story(max_open=198)
async def test_every_call_with_a_runners_token(http: httpx.AsyncClient, state: str) -> None:
    found, tokens = await targets(http)
    operations = {
        f"{method.upper()} {path}": operation
        for path, methods in built(http.app)["paths"].items()  # type: ignore[attr-defined]
        for method, operation in methods.items()
    }
    # They take no token, or show nothing secret to anybody.
    public = {name for name in operations if name.startswith("GET") and "security" not in operations[name]}
    public |= {"GET /v1/agents/{agent}", "GET /v1/owners/{owner}", "POST /v1/judgements"}
    listed = list(operations)
    # What ends an episode comes last.
    listed.sort(key=lambda name: name.startswith("DELETE /v1/episodes"))
    assert set(listed) >= public | GOOD_FOR[state].keys() | BODIES.keys()
    for name in listed:
        for whose in ("other", "queued", "running"):
            method, _, path = name.partition(" ")
            for parameter, value in found[whose].items():
                path = path.replace(f"{{{parameter}}}", value)
            headers = {**bearer(tokens[state]), "Idempotency-Key": f"{name} {whose}"}
            given: dict[str, Any] = {"json": BODIES[name]} if name in BODIES else {}
            if name == "POST /v1/submissions":
                given = {"content": model(name="by a runner")}
                headers["Content-Type"] = TYPE
            if path.endswith("/compare"):
                path += "?a=x&b=y"
            reply = await http.request(method, path, headers=headers, **given)
            if name == "GET /metrics":
                problem(reply, 401, "unauthenticated")
            elif name in public:
                assert reply.status_code in {200, 404}, (name, reply.text)
            elif name in GOOD_FOR[state] and (whose == state or "{" not in name):
                assert reply.status_code in GOOD_FOR[state][name], (name, whose, reply.text)
            else:
                told = problem(reply, 403, "forbidden")
                assert told["detail"], name
    row = await service_of(http).submissions.rows.get(found["running"]["submission"])
    assert row is not None
    assert row.state == "running"


@story()
async def test_the_agents_own_token_drives_nothing_that_was_handed_in(http: httpx.AsyncClient) -> None:
    mine = bearer((await agent(http, "mine"))["token"])
    submission = expect(await hand_in(http, NAMELESS, **mine), 202)["id"]
    await checked(http, submission)
    evaluation, token = await running(http, submission)
    episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes", headers=bearer(token)), 201)["id"]
    expect(await http.get(f"/v1/evaluations/{evaluation}", headers=mine), 200)
    expect(await http.get(f"/v1/episodes/{episode}", headers=mine), 200)
    for method, path, body in (
        ("POST", f"/v1/evaluations/{evaluation}/episodes", None),
        ("PUT", f"/v1/evaluations/{evaluation}/results", RECORD),
        ("DELETE", f"/v1/evaluations/{evaluation}", None),
        ("POST", f"/v1/episodes/{episode}/step", STEP),
        ("DELETE", f"/v1/episodes/{episode}", None),
    ):
        problem(await http.request(method, path, json=body, headers=mine), 403, "forbidden")
    told = problem(await http.post("/v1/evaluations", json={"suite": "smoke@3"}, headers=mine), 409, "evaluation-open")
    assert "cancel its submission" in told["detail"]
    # It may practise meanwhile, and the runner has nothing to do with that.
    practice = expect(await http.post("/v1/episodes", json=PRACTICE, headers=mine), 201)["id"]
    for method, path in (("POST", "/step"), ("DELETE", ""), ("GET", "")):
        body = STEP if path else None
        refused = await http.request(method, f"/v1/episodes/{practice}{path}", json=body, headers=bearer(token))
        problem(refused, 403, "forbidden")
    # With the submission its evaluation is the agent's again.
    expect(await http.delete(f"/v1/submissions/{submission}"), 200)
    expect(await http.post("/v1/evaluations", json={"suite": "smoke@3"}, headers=mine), 201)


@story()
async def test_it_ends_with_the_state(http: httpx.AsyncClient) -> None:
    submission = expect(await hand_in(http), 202)["id"]
    rows = service_of(http).submissions.rows
    first = await checked(http, submission)

    async def good(token: str, status: int = 201) -> None:
        assert (await http.post("/v1/episodes", json=PRACTICE, headers=bearer(token))).status_code == status

    await good(first)
    second = await service_of(http).submissions.give_token(submission)
    await good(first, 401)
    await good(second)
    assert await rows.set_state(submission, SubmissionState.CHECKED)
    await good(second, 401)
    evaluation, third = await running(http, submission)
    await good(third, 403)
    path = f"/v1/evaluations/{evaluation}/episodes"
    expect(await http.post(path, headers=bearer(third)), 201)
    await service_of(http).submissions.end(submission, SubmissionState.FAILED, "as the test wants")
    problem(await http.post(path, headers=bearer(third)), 401, "unauthenticated")
    with pytest.raises(OverError):
        await service_of(http).submissions.give_token(submission)


@pytest.fixture(scope="module")
def taking(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TakingService]:
    service = TakingService(tmp_path_factory.mktemp("taking"), slots=16)
    yield service
    service.close()


def test_the_socket_with_a_runners_token(taking: TakingService) -> None:
    ada = taking.owner("ada")
    head = {**bearer(ada), "Content-Type": TYPE}
    submission = expect(httpx.post(f"{taking.url}/v1/submissions", content=model(), headers=head, timeout=60), 202)[
        "id"
    ]
    token = taking.do(looked_at(taking.parts, submission))
    with taking.agent() as other, DriveSocket(taking, token) as drive:
        foreign = other.evaluate()["id"]
        strange = other.practise()["id"]
        status, told, *_ = drive.one("practise", PRACTICE, None)
        assert status == 201
        practice = told["id"]
        assert drive.one("step", practice, 1, 0.0, 0.0, 0.0)[0] == 200
        assert drive.one("look", practice)[0] == 200
        refused = (("next", foreign, None), ("step", strange, 1, 0.0, 0.0, 0.0), ("look", strange), ("abort", strange))
        for call in refused:
            assert drive.one(*call)[0] == 403, call
        taking.do(taking.parts.episodes.lose(submission))
        # It changes its state, and the open connection is closed at its next message.
        evaluation, token = taking.do(begun(taking.parts, submission))
        drive.send(["step", practice, 2, 0.0, 0.0, 0.0])
        _, results = drive.receive()
        assert results[0][0] == 401
        with pytest.raises(ConnectionClosed):
            drive.receive()
        with DriveSocket(taking, token) as runs:
            status, told, *_ = runs.one("next", evaluation, None)
            assert status == 201
            assert runs.one("step", told["id"], 1, 0.0, 0.0, 0.0)[0] == 200
            for call in (
                *refused,
                ("practise", PRACTICE, None),
                ("look", practice),
                ("step", practice, 2, 0.0, 0.0, 0.0),
            ):
                assert runs.one(*call)[0] == 403, call
            assert runs.one("abort", told["id"])[0] == 204
            expect(httpx.delete(f"{taking.url}/v1/submissions/{submission}", headers=bearer(ada), timeout=60), 200)
            runs.send(["next", evaluation, None])
            assert runs.receive()[1][0][0] == 401
            with pytest.raises(ConnectionClosed):
                runs.receive()
    with pytest.raises(InvalidStatus) as caught:
        DriveSocket(taking, token)
    assert caught.value.response.status_code == 401
