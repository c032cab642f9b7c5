"""The page that documents every call, made from the OpenAPI document.

It is our own. Swagger UI, RapiDoc and Scalar fail axe-core (contrast, landmarks, names of buttons), are blank without
JavaScript, and weigh 0.9 to 3.6 MB.
"""

import asyncio
import json
import re
import shlex
from typing import Any, Final

from fastapi import APIRouter, Request, Response
from markupsafe import Markup, escape

from wrongturn_service.api.dependencies import ServiceDep
from wrongturn_service.api.documents import OBSERVATIONS, WORDS, document
from wrongturn_service.web.page import page, public_url, templates

router = APIRouter(include_in_schema=False)
_CODE: Final = re.compile(r":\w+:`~?(?:[\w.]*\.)?(\w+)`|``(.+?)``|`(.+?)`")


@router.api_route("/docs", methods=["GET", "HEAD"])
async def docs(request: Request, service: ServiceDep) -> Response:
    """Show the documentation of every call."""
    found = await document(request.app, service)
    calls = await service.documents.get("docs", lambda: asyncio.to_thread(_calls, found))
    return page(request, "rest.html", calls=calls, url=public_url(request))


def _calls(document: bytes) -> Markup:
    """Return the part of the page that is the same for every address."""
    found = json.loads(document)
    schemas = found["components"]["schemas"]
    text = (
        templates()
        .get_template("rest_calls.html")
        .render(
            groups=_groups(found["paths"]),
            meanings=WORDS["groups"],
            schemas=schemas,
            tracks={track: schemas[name] for track, name in OBSERVATIONS.items()},
            pretty=_pretty,
            prose=_prose,
        )
    )
    return Markup(text)  # noqa: S704 -- rendered with autoescape


def _groups(paths: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Return the calls by tag, in the order of the page."""
    found: dict[str, list[dict[str, Any]]] = {tag: [] for tag in WORDS["groups"]}
    for path, operations in paths.items():
        for method, operation in operations.items():
            found.setdefault(operation["tags"][0], []).append(_call(method.upper(), path, operation))
    for calls in found.values():
        calls.sort(key=lambda call: (call["path"].count("/"), call["path"], call["method"] != "POST"))
    return {tag: calls for tag, calls in found.items() if calls}


def _call(method: str, path: str, operation: dict[str, Any]) -> dict[str, Any]:
    """Return what the page shows of a call: its operation, and what can be read off it."""
    security, replies = operation.get("security", []), operation["responses"]
    status = next(status for status in replies if status < "300")
    media, body = _content(operation.get("requestBody", {}))
    return {
        "id": re.sub(r"\W+", "-", f"{method} {path}").strip("-").lower(),
        "method": method,
        "path": path,
        "operation": operation,
        "lead": re.split(r"(?<=\.)\s", str(operation["description"]), maxsplit=1)[0],
        "needs_token": bool(security) and {} not in security,
        "media": media,
        "body": body,
        "status": status,
        "reply": _content(replies[status])[1],
        "refusals": {status: reply["description"] for status, reply in replies.items() if status >= "400"},
        "curl": _curl(method, path, operation, media, body.get("example")),
    }


def _curl(method: str, path: str, operation: dict[str, Any], media: str | None, example: Any) -> str:
    """Return a call with the values of its example as a command."""
    query = []
    for parameter in operation.get("parameters", []):
        if "example" in parameter:
            value = str(parameter["example"])
            path = path.replace(f"{{{parameter['name']}}}", value)
            if parameter["in"] == "query":
                query.append(f"{parameter['name']}={value.replace(' ', '+')}")
    url = f"$WRONGTURN_URL{path}" + (f"?{'&'.join(query)}" if query else "")
    lines = [f'curl -X {method} "{url}"' if method != "GET" else f'curl "{url}"']
    if operation.get("security"):
        lines.append('-H "Authorization: Bearer $WRONGTURN_TOKEN"')
    if media == "multipart/form-data":
        lines += [
            f"-F {name}={'@my_agent.onnx' if name == 'model' else shlex.quote(example[name])}" for name in example
        ]
    elif example is not None:
        lines += ['-H "Content-Type: application/json"', f"-d {shlex.quote(json.dumps(example))}"]
    return " \\\n  ".join(lines)


def _content(part: dict[str, Any]) -> tuple[str | None, dict[str, Any]]:
    """Return the media type of a body or reply that people read, with its schema and example; None without any."""
    contents = part.get("content", {})
    media = next(iter(contents), None)
    return media, contents.get(media, {})


def _pretty(value: Any) -> str:
    """Return a value as JSON whose lists of numbers stand in one line each."""
    if isinstance(value, str):
        return value
    text = json.dumps(value, indent=2)
    return re.sub(
        r"\[[^\[\]{}]*\]", lambda found: re.sub(r"\s+", " ", found.group()).replace("[ ", "[").replace(" ]", "]"), text
    )


def _prose(text: str) -> Markup:
    """Return a docstring as paragraphs."""
    paragraphs = [
        _CODE.sub(lambda found: f"<code>{next(filter(None, found.groups()))}</code>", str(escape(paragraph)))
        for paragraph in text.strip().split("\n\n")
    ]
    return Markup("".join(f"<p>{paragraph}</p>" for paragraph in paragraphs))  # noqa: S704 -- escaped above
