"""The OpenAPI document names every call of the interface, and holds against requests made from it."""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from contract_document import operations
from service_harness import Agent, RunningService, problem

from wrongturn_service.api import examples

INTERFACE = {example["call"] for example in examples.load()}
PUBLIC = {
    "POST /v1/owners",
    "GET /v1/owners",
    "POST /v1/agents",
    "GET /v1/agents",
    "GET /v1/suites",
    "GET /v1/suites/{suite}",
    "GET /v1/suites/{suite}/trials",
    "GET /v1/towns",
    "GET /v1/towns/{town}",
    "GET /v1/keys",
    "GET /v1/leaderboards",
    "GET /v1/leaderboards/{suite}",
    "GET /v1/leaderboards/{suite}/compare",
    "POST /v1/judgements",
}


def test_every_call_that_has_an_example_is_there_and_no_other(document: dict[str, Any]) -> None:
    assert set(operations(document)) == INTERFACE


def test_problems_bodies_and_the_token_are_documented(document: dict[str, Any]) -> None:
    for name, operation in operations(document).items():
        assert operation["description"], name
        if "/v1/" not in name:
            continue
        refusals = [status for status in operation["responses"] if status >= "400"]
        for status in refusals:
            content = operation["responses"][status]["content"]
            assert content == {"application/problem+json": {"schema": {"$ref": "#/components/schemas/Problem"}}}, name
        assert ("security" in operation) == (name not in PUBLIC), name
        if name not in PUBLIC:
            assert {"401", "403"} <= set(refusals), name
    with_body = {name for name, operation in operations(document).items() if "requestBody" in operation}
    assert with_body == {
        "POST /v1/owners",
        "POST /v1/agents",
        "POST /v1/evaluations",
        "PUT /v1/evaluations/{evaluation}/results",
        "POST /v1/episodes",
        "POST /v1/episodes/{episode}/step",
        "POST /v1/submissions",
        "POST /v1/judgements",
        "POST /v1/whatifs",
    }


@pytest.fixture
def agent(service: RunningService) -> Iterator[Agent]:
    with service.agent() as agent:
        yield agent


def test_every_other_method_is_refused_with_those_that_are_right(
    service: RunningService, document: dict[str, Any]
) -> None:
    with httpx.Client(base_url=service.url, timeout=60) as http:
        for path, operations_there in document["paths"].items():
            right = {method.upper() for method in operations_there}
            for method in {"GET", "PUT", "POST", "DELETE", "PATCH", "OPTIONS"} - right:
                response = http.request(method, path)
                told = problem(response, 405, "method-not-allowed")
                assert set(response.headers["allow"].split(", ")) == right, (path, told)


def test_replies_with_an_id_lead_to_the_calls_that_take_it(document: dict[str, Any]) -> None:
    names = {operation["operationId"]: name for name, operation in operations(document).items()}
    links = {
        name: {names[link["operationId"]] for reply in operation["responses"].values() for link in links_of(reply)}
        for name, operation in operations(document).items()
    }
    kinds = ("evaluation", "episode", "submission")
    below = {kind: {name for name in INTERFACE if f"/{kind}s/{{{kind}}}" in name} for kind in kinds}
    assert links["POST /v1/evaluations"] == below["evaluation"]
    assert links["POST /v1/evaluations/{evaluation}/episodes"] == links["POST /v1/episodes"] == below["episode"]
    assert links["POST /v1/submissions"] == below["submission"]
    assert (len(below["evaluation"]), len(below["submission"])) == (6, 3)


def links_of(reply: dict[str, Any]) -> list[dict[str, Any]]:
    return list(reply.get("links", {}).values())


def test_the_form_of_a_submission_is_documented(document: dict[str, Any], agent: Agent) -> None:
    operation = operations(document)["POST /v1/submissions"]
    (media,) = operation["requestBody"]["content"]
    form = operation["requestBody"]["content"][media]
    assert media == "multipart/form-data"
    assert form["schema"]["required"] == ["model", "suite"]
    assert form["example"].keys() == form["schema"]["properties"].keys() == {"model", "suite", "name"}
    refusals = {"400", "401", "403", "404", "408", "409", "413", "415", "422", "429", "503", "507"}
    assert operation["responses"].keys() == refusals | {"202"}
    # What is documented as needed is all that is needed.
    with_what_is_needed = {name: (None, f"{name} x") for name in form["schema"]["required"]}
    given = {**with_what_is_needed, "suite": (None, "smoke@3")}
    found = agent.http.post("/v1/submissions", files=given)
    assert found.status_code in {202, 503}, found.text
    for left_out in given:
        fewer = {name: value for name, value in given.items() if name != left_out}
        refused = agent.http.post("/v1/submissions", files=fewer)
        if refused.status_code != 503:
            problem(refused, 422, "validation", left_out)
