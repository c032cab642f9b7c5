"""The OpenAPI document. Routes add their bodies, problems and tokens from their dependencies."""

import asyncio
import json
import tomllib
from collections.abc import Callable
from importlib.resources import files
from typing import Any, Final, Literal

from fastapi import FastAPI, Request, Response
from fastapi.openapi.utils import get_openapi
from fastapi.routing import APIRoute
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

from wrongturn_protocol import (
    AgentRegistration,
    EvaluationRequest,
    OwnerRegistration,
    PracticeRequest,
    Problem,
    Recording,
    ResultsRequest,
    StepRequest,
    Track,
    WhatIfRequest,
)
from wrongturn_protocol.observations import FIELDS, json_schema
from wrongturn_service.api.dependencies import Body, RequestKey, ServiceDep, Token, accepted
from wrongturn_service.api.examples import add_examples
from wrongturn_service.encoding import Encoding
from wrongturn_service.service import Service

WORDS: Final[dict[str, dict[str, str]]] = tomllib.loads(
    (files("wrongturn_service.api") / "words.toml").read_text("utf-8")
)
"""Meanings of problems, statuses and parameters, and of the groups of calls."""
OBSERVATIONS: Final = {
    track: f"{track.capitalize()}Observation" for track in sorted(Track, key=lambda track: -len(FIELDS[track]))
}
"""Name of each track's schema. One with more keys comes first: generated clients take the first that fits."""
_REFERENCE = "#/components/schemas/{model}"
_INPUTS: list[tuple[Any, Literal["validation"]]] = [
    *((model, "validation") for model in (AgentRegistration, EvaluationRequest, OwnerRegistration, PracticeRequest)),
    *((model, "validation") for model in (Recording, ResultsRequest, StepRequest, WhatIfRequest, Problem)),
]
WITHOUT_TOKEN_TOO: Final[dict[str, Any]] = {"openapi_extra": {"security": [{}]}}
"""Keyword arguments of a route that shows a finished evaluation, or an episode of one, without a token too."""
_MADE = {
    "/v1/agents": "agent",
    "/v1/owners": "owner",
    "/v1/evaluations": "evaluation",
    "/v1/evaluations/{evaluation}/episodes": "episode",
    "/v1/episodes": "episode",
    "/v1/whatifs": "episode",
    "/v1/submissions": "submission",
}
"""What a POST creates. Calls below its path take the id."""


def described(
    message: type[BaseModel] | None,
    *problems: int,
    status: int = 200,
    media: str = "application/json",
    tagged: bool = False,
) -> dict[str, Any]:
    """Return the keyword arguments of a route that document its replies; :class:`Route` adds more.

    ``status`` is that of a good reply. Without a message it has no body, or one of the ``media`` type. A ``tagged``
    reply has an ETag, so that a caller that has it already gets 304.
    """
    good: dict[str, Any] = {"description": "As asked"}
    if message is not None:
        good["model"] = message
    elif media.startswith("image/"):  # generators of clients know no schema for it
        good["description"] = f"A picture, {media}"
    elif status != 204:
        good["content"] = {media: {}}
    responses = {status: good, **{code: _problem(code) for code in (*problems, 503)}}
    if tagged:
        responses[304] = {"description": "If-None-Match names the reply's ETag"}
    # A plain Response, so that FastAPI adds no JSON to the document.
    return {"status_code": status, "response_model": None, "response_class": Response, "responses": responses}


def _problem(status: int) -> dict[str, Any]:
    schema = {"$ref": _REFERENCE.format(model=Problem.__name__)}
    return {"description": WORDS["statuses"][str(status)], "content": {"application/problem+json": {"schema": schema}}}


class Route(APIRoute):
    """A route whose document follows from what it declares: body, token, key and encoding."""

    def __init__(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:
        super().__init__(path, endpoint, **options)
        for dependency in self.dependant.dependencies:
            match dependency.call:
                case Body() as body:
                    self._add_body(body)
                case Token():
                    self._add_problems(401, 403)
                case call if call is RequestKey:
                    self._add_problems(422)
                case call if call is accepted:
                    self._add_problems(406)
        self.responses = dict(sorted(self.responses.items(), key=lambda item: str(item[0])))

    def _add_body(self, body: Body[Any]) -> None:
        self._add_problems(400, 408, 413, 415, 422)
        content = {"application/json": {"schema": {"$ref": _REFERENCE.format(model=body.model.__name__)}}}
        self.openapi_extra = {"requestBody": {"required": True, "content": content}}

    def _add_problems(self, *statuses: int) -> None:
        for status in statuses:
            self.responses.setdefault(status, _problem(status))


async def document(app: FastAPI, service: Service) -> bytes:
    """Return the OpenAPI document as JSON. It is made once, in a thread: that takes up to a second."""
    return await service.documents.get("openapi", lambda: asyncio.to_thread(lambda: json.dumps(built(app)).encode()))


async def serve_document(request: Request, service: ServiceDep) -> Response:
    """Serve ``GET /openapi.json``."""
    return Response(await document(request.app, service), media_type=Encoding.JSON)


def built(app: FastAPI) -> dict[str, Any]:
    """Return the OpenAPI document of the application."""
    found = get_openapi(
        title=app.title,
        version=app.version,
        description=app.description,
        routes=app.routes,
        servers=app.servers or None,
        tags=[{"name": name, "description": meaning} for name, meaning in WORDS["groups"].items()],
    )
    about = "WS /v1/drive, a WebSocket for many episodes at once. OpenAPI cannot describe it."
    found["externalDocs"] = {"description": about, "url": "docs#websocket"}
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    _, definitions = models_json_schema(_INPUTS, ref_template=_REFERENCE)
    for name, schema in definitions.get("$defs", {}).items():
        schemas.setdefault(name, schema)
    # FastAPI's own errors, which this service never sends.
    schemas.pop("HTTPValidationError", None)
    schemas.pop("ValidationError", None)
    for path, operations in found["paths"].items():
        for method, operation in operations.items():
            operation["operationId"] = name = WORDS["operations"][f"{method.upper()} {path}"]
            operation["summary"] = name.replace("_", " ").capitalize()
            refused = operation["responses"].get("422", {}).get("content", {})
            if "application/json" in refused:
                del operation["responses"]["422"]
            for parameter in operation.get("parameters", []):
                parameter.setdefault("description", WORDS["parameters"].get(parameter["name"], ""))
    _add_observations(schemas)
    add_examples(found["paths"])
    _link(found["paths"])
    return found


def _add_observations(schemas: dict[str, Any]) -> None:
    """Add a schema for each track, and name them where an observation is sent."""

    def reference(name: str) -> dict[str, str]:
        return {"$ref": _REFERENCE.format(model=name)}

    for track, name in OBSERVATIONS.items():
        schemas[name] = json_schema(track)
    observation = {
        "description": "What the agent is shown, by its track; with a rig, the keys that the rig names.",
        "oneOf": [reference(name) for name in OBSERVATIONS.values()],
    }
    for reply in ("EpisodeReply", "StepReply"):
        schemas[reply]["properties"]["observation"] = observation
    last = schemas["EpisodeDetail"]["properties"]["last_reply"]
    last["anyOf"] = [reference("EpisodeReply"), reference("StepReply"), {"type": "null"}]


def _link(paths: dict[str, Any]) -> None:
    """Link each reply with an id to the calls that take it."""
    for path, made in _MADE.items():
        replies = paths[path]["post"]["responses"]
        replies["201" if "201" in replies else "202"]["links"] = {
            operation["operationId"]: {
                "operationId": operation["operationId"],
                "parameters": {made: "$response.body#/id"},
            }
            for below, operations in paths.items()
            if below.startswith(f"/v1/{made}s/{{{made}}}")
            for operation in operations.values()
        }
