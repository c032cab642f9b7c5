"""Every operation of the OpenAPI document in use: schemathesis' boundary cases for each, and walks along its links."""

from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import httpx
import pytest
from served_app import ServedApp

from wrongturn_protocol import ProblemType
from wrongturn_service.submissions import availability

KINDS = {f"/problems/{kind}" for kind in ProblemType} - {"/problems/internal"}
UNCHECKED = {
    # A DELETE ends an evaluation or an episode; what came of it can still be read.
    "use_after_free",
    # A schema cannot say all that makes a request good: names that exist, a key that is new.
    "positive_data_acceptance",
}
OUT_OF_REACH = {
    # These would take the token away from the other cases.
    "POST /v1/agents/{agent}/token",
    "DELETE /v1/agents/{agent}/token",
    # It needs two agents with finished evaluations.
    "GET /v1/leaderboards/{suite}/compare",
    # They need an episode that was driven to its end.
    "GET /v1/episodes/{episode}/camera/{sheet}",
    "GET /v1/episodes/{episode}/picture.png",
    "POST /v1/whatifs",
    # An agent's token, which each case sends, does not open these.
    "POST /v1/agents",
    "POST /v1/keys",
    "POST /v1/owners",
    "POST /v1/owners/{owner}/token",
    "DELETE /v1/owners/{owner}/token",
    "GET /v1/admin/usage",
    "GET /v1/admin/audit",
    "GET /v1/admin/{collection}",
    "GET /v1/admin/{collection}/{item}",
    "PUT /v1/admin/{collection}/{item}/hidden",
    "DELETE /v1/admin/{collection}/{item}/hidden",
    "DELETE /v1/admin/{collection}/{item}/tokens",
    "DELETE /v1/admin/{collection}/{item}",
}
"""Operations that no case need have success with; the tests beside this one do."""
SUITE = "smoke@3"


@pytest.fixture
def served(tmp_path: Path) -> Iterator[ServedApp]:
    # It does not listen by itself, so it starts no runners.
    with patch.object(availability, "probe", lambda _: "a sandbox of the test"):
        served = ServedApp(tmp_path, slots=32)
        try:
            yield served
        finally:
            served.close()


def schema_of(served: ServedApp) -> Any:
    """The document, with examples that exist: else it would be luck which operations have success."""
    import schemathesis  # it takes a second, which tests of other files need not wait for

    with httpx.Client(base_url=served.url, timeout=60) as http:
        registered = http.post("/v1/agents", json={"name": "walker", "track": "privileged"}).json()
        http.headers["Authorization"] = f"Bearer {registered['token']}"
        trial = http.get(f"/v1/suites/{SUITE}/trials").json()["trials"][0]
        practice = {"town": trial["town"], "approach": trial["approach"]}
        evaluation = http.post("/v1/evaluations", json={"suite": SUITE}).json()["id"]
        # Driven, so that a DELETE leaves it there to be read.
        driven = http.post(f"/v1/evaluations/{evaluation}/episodes").json()["id"]
        step = {"seq": 1, "action": {"steer": 0.0, "throttle": 1.0, "brake": 0.0}}
        assert http.post(f"/v1/episodes/{driven}/step", json=step).status_code == 200
        submission = http.post("/v1/submissions", data={"suite": "navigation@1"}, files={"model": b"a model"})
        assert submission.status_code == 202
        parameters = {
            "submission": submission.json()["id"],
            "agent": registered["id"],
            "owner": http.get("/v1/owners").json()["owners"][0]["id"],
            "suite": SUITE,
            "town": trial["town"],
            "evaluation": evaluation,
            "episode": http.post("/v1/episodes", json=practice).json()["id"],
            "kind": ProblemType.UNKNOWN_SUITE,
        }
        document = http.get("/openapi.json").json()
    for operations in document["paths"].values():
        for operation in operations.values():
            for parameter in operation.get("parameters", []):
                if parameter["name"] in parameters:
                    parameter["example"] = parameters[parameter["name"]]
    bodies = {
        ("/v1/evaluations", "post"): {"suite": "navigation@1"},
        ("/v1/evaluations/{evaluation}/results", "put"): {"episodes": []},
        ("/v1/episodes", "post"): practice,
        ("/v1/episodes/{episode}/step", "post"): step,
    }
    for (path, method), body in bodies.items():
        document["paths"][path][method]["requestBody"]["content"]["application/json"]["example"] = body
    form = document["paths"]["/v1/submissions"]["post"]["requestBody"]["content"]["multipart/form-data"]
    form["example"] = {"model": "a model", "suite": "wrong-command@3"}
    config = schemathesis.Config.from_dict(
        {
            "headers": {"Authorization": f"Bearer {registered['token']}"},
            "continue-on-failure": True,
            "request-timeout": 60,
            "generation": {"max-examples": 5, "deterministic": True, "database": "none"},
            "checks": {
                "negative_data_rejection": {"expected-statuses": ["4xx", 503]},
                **{name: {"enabled": False} for name in UNCHECKED},
            },
            "phases": {"fuzzing": {"enabled": False}},
            "operations": [{"include-path": "/v1/agents/{agent}/token", "enabled": False}],
        }
    )
    config.projects.default.base_url = served.url
    return schemathesis.openapi.from_dict(document, config=config)


def test_boundary_cases_and_links(served: ServedApp) -> None:
    served.beside(lambda: use(served))
    assert not [error for error in served.errors if error["event"] == "internal error"]


def is_busy(response: Any) -> bool:
    """Whether it is a server error that may be: no simulator is free, or towns are built; and when to come again."""
    return (
        response is not None
        and response.status_code == 503
        and response.json()["type"] in {"/problems/simulators-busy", "/problems/towns-not-built"}
        and "retry-after" in response.headers
    )


def use(served: ServedApp) -> None:
    """Let schemathesis do what it can think of; nothing may be wrong, and each call has to have been reached."""
    schema = schema_of(served)
    statuses = walk(schema)
    for label, found in sorted(statuses.items()):
        print(label, dict(sorted(found.items())))
    print(sum(sum(found.values()) for found in statuses.values()), "calls")
    operations = {found.ok().label for found in schema.get_all_operations()}
    reached = {label for label, found in statuses.items() if any(status < 300 for status in found)}
    assert operations - reached <= OUT_OF_REACH


def walk(schema: Any) -> dict[str, Counter[int]]:
    """How often each operation answered with which status."""
    from schemathesis.engine import Status, events, from_schema

    statuses: defaultdict[str, Counter[int]] = defaultdict(Counter)
    wrong: list[str] = []
    for event in from_schema(schema).execute():
        if isinstance(event, events.NonFatalError | events.FatalError):
            wrong.append(repr(event))
        if not isinstance(event, events.ScenarioFinished):
            continue
        for name, case in event.recorder.cases.items():
            label = case.value.operation.label
            interaction = event.recorder.interactions.get(name)
            response = None if interaction is None else interaction.response
            wrong += [
                f"{label}: {check.name}: {check.failure_info and check.failure_info.failure}"
                for check in event.recorder.checks.get(name, [])
                if check.status is Status.FAILURE and not (check.name == "not_a_server_error" and is_busy(response))
            ]
            if response is None:
                continue
            statuses[label][response.status_code] += 1
            if response.status_code >= 400:
                told = response.json()
                assert told["type"] in KINDS
                assert told["status"] == response.status_code
    assert not wrong, "\n".join(wrong)
    return statuses
