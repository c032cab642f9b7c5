"""The documented examples, played in their order against a service. As a program it records their replies anew:

python tests/contract/example_story.py
"""

import json
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx

from wrongturn_service.api import examples

OPERATOR = "wt_token-of-the-operator"
"""The operator's token of a service that plays the examples."""
_MOST: dict[type, int] = {dict: 1, list: 2}
"""Items of a list that an example shows, by their kind. Of numbers and words it shows eight."""
_NAMED = {"junctions", "lanes"}
"""Objects whose keys are names of a town, of which an example shows one."""


def play(http: httpx.Client) -> Iterator[tuple[dict[str, Any], httpx.Response]]:
    """Send each example's request. What the examples call by an id or a token is what this service called so."""
    live = {OPERATOR: OPERATOR}
    for example in examples.load():
        method, path = example["call"].split()
        parameters = _swapped(example.get("parameters", {}), live)
        query = {name: value for name, value in parameters.items() if f"{{{name}}}" not in path}
        headers = {"Authorization": f"Bearer {live[example['token']]}"} if "token" in example else {}
        if "accept" in example:
            headers["Accept"] = example["accept"]
        body: dict[str, Any] = {"json": _swapped(example["request"], live)} if "request" in example else {}
        if "form" in example:
            body = {"data": example["form"], "files": {"model": b"no model"}}
        response = http.request(method, path.format(**parameters), params=query, headers=headers, **body)
        if method == "POST" and response.is_success and "reply" in example:
            live |= {example["reply"][key]: told for key, told in response.json().items() if key in {"id", "token"}}
        yield {**example, "live": dict(live)}, response


def _swapped(value: Any, names: dict[str, str]) -> Any:
    text = json.dumps(value)
    for old, new in names.items():
        text = text.replace(old, new)
    return json.loads(text)


def shortened(value: Any, within: str = "") -> Any:
    """A reply with lists that are cut. Observations stay whole, with numbers of three decimals."""
    if isinstance(value, dict):
        kept = list(value.items())[: 1 if within in _NAMED else None]
        return {name: shortened(item, name if within != "observation" else within) for name, item in kept}
    if isinstance(value, list):
        kind = type(value[0]) if value else str
        most = len(value) if within == "observation" else _MOST.get(kind, 8)
        return [shortened(item, within) for item in value[:most]]
    return round(value, 3) if isinstance(value, float) else value


def record(http: httpx.Client) -> list[dict[str, Any]]:
    """The examples with what the service replied to them now."""
    recorded: list[dict[str, Any]] = []
    for example, response in play(http):
        names = {new: old for old, new in example.pop("live").items()}
        assert response.is_success, f"{example['call']}: {response.text}"
        example["status"] = response.status_code
        kind = response.headers.get("content-type", "")
        if kind == "application/json":
            reply = shortened(_swapped(response.json(), names))
            shown = example["call"] not in {earlier["call"] for earlier in recorded}
            example["reply"] = reply if shown else {key: reply[key] for key in ("id", "token") if key in reply}
        elif response.content and not kind.startswith("image/"):
            example["reply"] = "\n".join(response.text.splitlines()[:8]) + "\n"
        recorded.append(example)
    return recorded


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1] / "service"))
    from service_harness import RunningService

    with tempfile.TemporaryDirectory() as folder:
        service = RunningService(Path(folder) / "wrongturn.db", operator_token=OPERATOR, submissions=1)
        try:
            with httpx.Client(base_url=service.url, timeout=120) as client:
                lines = [json.dumps(example) for example in record(client)]
            examples.FILE.write_text("[\n" + ",\n".join(lines) + "\n]\n")
        finally:
            service.stop()
