"""Every call has an example in the OpenAPI document, and the examples are what the service takes and replies."""

from typing import Any

import httpx
import jsonschema_rs
import pytest
from contract_document import operations
from example_story import play
from service_harness import RunningService

from wrongturn_protocol import Track
from wrongturn_protocol.observations import encode, observation_space
from wrongturn_service.api import examples

PASSING = {"position", "track", "agent", "evaluation", "finished", "episodes", "reason"}
"""Fields of a submission that come and go with its state, while the examples are played."""


def check(document: dict[str, Any], schema: dict[str, Any], value: Any) -> None:
    """Hold a value against a schema of the document."""
    jsonschema_rs.validate({**schema, "components": document["components"]}, value)


def test_every_call_has_an_example_of_its_request_and_its_reply(document: dict[str, Any]) -> None:
    for call, operation in operations(document).items():
        good = next(reply for status, reply in operation["responses"].items() if status < "300")
        for parameter in operation.get("parameters", []):
            assert "example" in parameter or not parameter["required"], (call, parameter["name"])
            if "example" in parameter:
                check(document, parameter["schema"], parameter["example"])
        body = operation.get("requestBody", {"content": {}})["content"]
        for content in (body, good.get("content", {})):
            media = [name for name in content if not name.startswith("image/")]
            assert all("example" in content[name] for name in media), call
            for name in media:
                if name != "multipart/form-data":
                    check(document, content[name].get("schema", {}), content[name]["example"])


def test_a_service_takes_the_examples_and_replies_like_them(service: RunningService) -> None:
    shown = {example["call"]: example for example in reversed(examples.load()) if "accept" not in example}
    with httpx.Client(base_url=service.url, timeout=120) as http:
        for example, response in play(http):
            call = example["call"]
            if "/submissions" in call and response.status_code in {404, 503}:
                continue  # there is no sandbox here
            assert response.status_code == example["status"], f"{call}: {response.text}"
            if call in shown and isinstance(example.get("reply"), dict):
                found, expected = response.json().keys(), shown.pop(call)["reply"].keys()
                assert found - PASSING == expected - PASSING, call


@pytest.mark.parametrize("track", list(Track))
def test_observations_hold_against_the_schema_of_their_track_and_no_other(
    document: dict[str, Any], track: Track
) -> None:
    space = observation_space(track)
    space.seed(7)
    message = encode(space.sample(), track)
    for other in Track:
        schema = {"$ref": f"#/components/schemas/{other.capitalize()}Observation"}
        if other is track:
            check(document, schema, message)
            continue
        with pytest.raises(jsonschema_rs.ValidationError):
            check(document, schema, message)
    reply = {"seq": 1, "observation": message, "terminated": False, "truncated": False, "reward": None, "verdict": None}
    check(document, {"$ref": "#/components/schemas/StepReply"}, reply)
