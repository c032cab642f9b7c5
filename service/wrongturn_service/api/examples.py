"""Examples of every call, for the OpenAPI document.

``examples.json`` lists requests in an order in which a fresh service takes them, with the replies that one gave.
Long lists are cut. ``tests/contract`` plays the requests against a service, and records the replies anew.
"""

import json
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, Final

with as_file(files("wrongturn_service.api") / "examples.json") as _file:
    FILE: Final[Path] = _file
"""The examples. A call's first one is shown."""


def load() -> list[dict[str, Any]]:
    """Return all examples.

    Each has ``call`` and ``status``, and what applies of ``token``, ``parameters`` (of path and query), ``request``
    (JSON), ``form`` (multipart fields), ``accept`` (another media type than the first one) and ``reply``.
    """
    found: list[dict[str, Any]] = json.loads(FILE.read_text())
    return found


def add_examples(paths: dict[str, Any]) -> None:
    """Add an example of parameters, request and reply to each operation of an OpenAPI document that has one."""
    for example in reversed(load()):  # of several for a call, the first is shown
        method, path = example["call"].split()
        operation = paths[path][method.lower()]
        if "reply" in example:
            content = operation["responses"][str(example["status"])]["content"]
            media = example.get("accept") or next(iter(content))
            content[media]["example"] = example["reply"]
        if "accept" not in example:
            parameters = example.get("parameters", {})
            for parameter in operation.get("parameters", []):
                if parameter["name"] in parameters:
                    parameter["example"] = parameters[parameter["name"]]
            if "request" in example:
                operation["requestBody"]["content"]["application/json"]["example"] = example["request"]
