"""The OpenAPI document: bodies that are parsed by hand, problems, the token."""

import re
import threading
from functools import lru_cache
from typing import Any, Final, Literal

from fastapi import FastAPI, Request, Response
from fastapi.openapi.utils import get_openapi
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from pydantic.json_schema import models_json_schema
from starlette.routing import compile_path

from wrongturn_protocol import (
    AgentRegistration,
    EvaluationRequest,
    PracticeRequest,
    Problem,
    ResultsRequest,
    StepRequest,
)
from wrongturn_service.idempotency import HEADER

_MAKING: Final = threading.Lock()
_REFERENCE = "#/components/schemas/{model}"
_BODIES: tuple[type[BaseModel], ...] = (
    AgentRegistration,
    EvaluationRequest,
    PracticeRequest,
    ResultsRequest,
    StepRequest,
)
_INPUTS: list[tuple[Any, Literal["validation"]]] = [(model, "validation") for model in (*_BODIES, Problem)]
_MEANING = {
    400: "Malformed body",
    401: "No token, or none that is known",
    403: "Another's",
    404: "Unknown",
    406: "No encoding that the client takes",
    408: "The body did not come in time",
    409: "Does not fit what was said before",
    410: "The episode is lost; its trial runs again",
    413: "The body is too large",
    415: "Another content type",
    422: "A field is wrong",
    429: "Too many; come back after Retry-After",
    503: "Not now; come back after Retry-After",
}
_BODY_PROBLEMS = (400, 408, 413, 415, 422)
_MADE = {
    "/v1/agents": "agent",
    "/v1/evaluations": "evaluation",
    "/v1/evaluations/{evaluation}/episodes": "episode",
    "/v1/episodes": "episode",
}
"""What a POST makes, whose id the calls below its own path take."""


def described(
    reply: type[BaseModel] | None,
    *problems: int,
    status: int = 200,
    body: type[BaseModel] | None = None,
    token: bool = False,
    binary: bool = False,
    creates: bool = False,
    media: str = "application/json",
) -> dict[str, Any]:
    """The keyword arguments of a route that document it.

    Args:
        reply: the message of a good reply; None for one without a body, or of another media type.
        problems: statuses of problems that are the route's own.
        status: of a good reply.
        body: the request's message.
        token: whether the owner's token is needed.
        binary: whether msgpack is spoken too.
        creates: whether it takes an idempotency key.
        media: of a reply that is no message.
    """
    statuses = set(problems) | {503}
    statuses |= set(_BODY_PROBLEMS) if body is not None else set()
    statuses |= {401, 403} if token else set()
    statuses |= {422} if creates else set()
    statuses |= {406} if binary else set()
    problem = {"schema": {"$ref": _REFERENCE.format(model=Problem.__name__)}}
    responses: dict[int | str, dict[str, Any]] = {
        code: {"description": _MEANING[code], "content": {"application/problem+json": problem}}
        for code in sorted(statuses)
    }
    good: dict[str, Any] = {"description": "As asked"}
    if reply is not None:
        good["model"] = reply
        if binary:
            good["content"] = {"application/msgpack": {"schema": {"type": "string", "format": "binary"}}}
    elif status != 204:
        good["content"] = {media: {}}
    responses[status] = good
    extra: dict[str, Any] = {}
    if body is not None:
        schema = {"schema": {"$ref": _REFERENCE.format(model=body.__name__)}}
        content = {"application/json": schema}
        if binary:
            content["application/msgpack"] = {"schema": {"type": "string", "format": "binary"}}
        extra["requestBody"] = {"required": True, "content": content}
    if token:
        extra["security"] = [{"token": []}]
    if creates:
        extra["parameters"] = [
            {
                "name": HEADER,
                "in": "header",
                "description": "A random UUID: a repeat with the same key gives the stored reply",
                "schema": {"type": "string", "minLength": 1, "maxLength": 255, "pattern": "^[ -~]+$"},
            },
        ]
    return {"status_code": status, "response_model": None, "responses": responses, "openapi_extra": extra}


def document(app: FastAPI) -> dict[str, Any]:
    """The OpenAPI document of the application; made once, which takes up to a second: not in the event loop."""
    with _MAKING:
        if app.openapi_schema is None:
            app.openapi_schema = _built(app)
    return app.openapi_schema


def serve_document(request: Request) -> Response:
    """``GET /openapi.json``; a plain function, so that it has a thread to itself."""
    return JSONResponse(document(request.app))


def _built(app: FastAPI) -> dict[str, Any]:
    found = get_openapi(title=app.title, version=app.version, description=app.description, routes=app.routes)
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    _, definitions = models_json_schema(
        _INPUTS,
        ref_template=_REFERENCE,
    )
    for name, schema in definitions.get("$defs", {}).items():
        schemas.setdefault(name, schema)
    # FastAPI's own shape of errors, which this service never sends.
    schemas.pop("HTTPValidationError", None)
    schemas.pop("ValidationError", None)
    for path in found["paths"].values():
        for operation in path.values():
            refused = operation["responses"].get("422", {}).get("content", {})
            if "application/json" in refused:
                del operation["responses"]["422"]
    _link(found["paths"])
    found["components"]["securitySchemes"] = {
        "token": {"type": "http", "scheme": "bearer", "description": "From POST /v1/agents"},
    }
    return found


def _link(paths: dict[str, Any]) -> None:
    """Tell of each reply with an id which calls take it."""
    for path, made in _MADE.items():
        paths[path]["post"]["responses"]["201"]["links"] = {
            operation["operationId"]: {
                "operationId": operation["operationId"],
                "parameters": {made: "$response.body#/id"},
            }
            for below, operations in paths.items()
            if below.startswith(f"/v1/{made}s/{{{made}}}")
            for operation in operations.values()
        }


def methods_at(app: FastAPI, path: str) -> list[str]:
    """The methods that a path takes, as the document has them; not in the event loop either."""
    return [
        method.upper()
        for template, operations in document(app)["paths"].items()
        if _pattern(template).fullmatch(path)
        for method in operations
    ]


@lru_cache(maxsize=128)
def _pattern(template: str) -> re.Pattern[str]:
    return compile_path(template)[0]
