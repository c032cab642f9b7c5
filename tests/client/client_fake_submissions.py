"""The part of the service in memory that takes submissions: each look moves a submission on by one state."""

import email
import hashlib
import json
from typing import Any

import httpx
from client_fake_service import FakeService, metrics, problem

from wrongturn_protocol import ProblemType

TIME = "2026-11-22T08:00:00+00:00"
FIGURES = metrics(60)
WAY: tuple[dict[str, Any], ...] = (
    {"state": "queued"},
    {"state": "checked", "position": 1, "track": "camera", "agent": "a7"},
    {"state": "checked", "position": 0, "track": "camera", "agent": "a7"},
    {"state": "running", "evaluation": "e7", "finished": 3, "episodes": 120},
    {"state": "finished", "evaluation": "e7", "finished": 120, "episodes": 120},
)
"""What a submission goes through that all is well with."""


def form_of(request: httpx.Request) -> dict[str, tuple[str | None, bytes]]:
    """The parts of a multipart body, each with its file's name, in their order."""
    head = f"Content-Type: {request.headers['content-type']}\r\n\r\n".encode()
    parts = email.message_from_bytes(head + request.content).get_payload()
    assert isinstance(parts, list)
    form = {}
    for part in parts:
        content = part.get_payload(decode=True)
        assert isinstance(content, bytes)
        form[str(part.get_param("name", header="content-disposition"))] = (part.get_filename(), content)
    return form


class FakeSubmissions(FakeService):
    """Owners with tokens, one agent with the token ``agent's``, and submissions."""

    def __init__(self, way: tuple[dict[str, Any], ...] = WAY) -> None:
        super().__init__()
        self.way = list(way)
        self.owners: dict[str, str] = {}
        """Names of owners by token."""
        self.taken = {"taken"}
        self.forms: list[dict[str, tuple[str | None, bytes]]] = []
        self.detail: dict[str, Any] = {}
        self.log: list[dict[str, str]] = []
        self.why_not: str | None = None
        self.ready = {"status": "ok", "submissions": "on: bubblewrap 0.8.0"}

    def _fresh(self, request: httpx.Request) -> httpx.Response:
        parts = request.url.path.strip("/").split("/")
        token = request.headers.get("authorization", "").removeprefix("Bearer ")
        owner = "me" if token == "agent's" else self.owners.get(token)
        match request.method, parts:
            case "GET", ["health", "ready"]:
                return httpx.Response(200, json=self.ready)
            case "GET", ["v1", "suites", suite]:
                return self._suite(suite)
            case "POST", ["v1", "owners"]:
                return self._register(json.loads(request.content)["name"])
            case "GET", ["v1", "owners", name]:
                if name not in self.owners.values():
                    return problem(ProblemType.UNKNOWN_OWNER, 404, f"there is no owner {name}")
                return httpx.Response(200, json={"id": name, "name": name})
            case "GET", ["v1", "leaderboards", suite]:
                return httpx.Response(200, json=self._board(suite))
            case "GET", ["v1", "evaluations", "e7"]:
                return httpx.Response(200, json={**self._evaluation(), "id": "e7", "metrics": FIGURES})
            case _, ["v1", "submissions", *_] if owner is None:
                return problem(ProblemType.UNAUTHENTICATED, 401, "nobody has this token")
            case "POST", ["v1", "submissions"]:
                return self._take(request, str(owner), by_agent=token == "agent's")
            case "GET", ["v1", "submissions"]:
                return httpx.Response(200, json={"submissions": [self.detail] if self.detail else []})
            case _, ["v1", "submissions", "theirs", *_]:
                return problem(ProblemType.FORBIDDEN, 403, "submission theirs belongs to another owner")
            case _, ["v1", "submissions", name, *_] if name != "s1":
                return problem(ProblemType.UNKNOWN_SUBMISSION, 404, f"there is no submission {name} of yours")
            case "GET", ["v1", "submissions", _, "log"]:
                return httpx.Response(200, json={"lines": self.log})
            case "GET", ["v1", "submissions", _]:
                self._move()
                return httpx.Response(200, json=self.detail)
            case "DELETE", ["v1", "submissions", _]:
                if self.detail["state"] != "finished":
                    self.detail |= {"state": "cancelled", "reason": "You cancelled it."}
                return httpx.Response(200, json=self.detail)
        return super()._fresh(request)

    def _suite(self, suite: str) -> httpx.Response:
        if suite == "none@1":
            return problem(ProblemType.UNKNOWN_SUITE, 404, "suite: there is no none@1")
        _, _, version = suite.partition("@")
        head = {"id": suite, "title": "Some", "version": int(version), "sha256": "0" * 64, "trials": 60, "twins": 60}
        return httpx.Response(200, json={**head, "tracks": ["camera"]})

    def _register(self, name: str) -> httpx.Response:
        if name in self.taken or name in self.owners.values():
            return problem(ProblemType.OWNER_NAME_TAKEN, 409, f"name: {name} is taken")
        token = f"token of {name}"
        self.owners[token] = name
        return httpx.Response(201, json={"id": name, "name": name, "token": token})

    def _take(self, request: httpx.Request, owner: str, *, by_agent: bool) -> httpx.Response:
        form = form_of(request)
        self.forms.append(form)
        given = form.get("name", (None, b""))[1].decode()
        if by_agent and given not in {"", "the agent"}:
            field = {"path": "name", "message": "the token is agent 'the agent''s, so leave the name out"}
            return problem(ProblemType.VALIDATION, 422, "name: leave the name out", errors=[field])
        if not given and not by_agent:
            field = {"path": "name", "message": "is missing"}
            return problem(ProblemType.VALIDATION, 422, "name: is missing", errors=[field])
        if given in self.taken:
            return problem(ProblemType.AGENT_NAME_TAKEN, 409, f"{given} is taken")
        model = form["model"][1]
        self.detail = {
            "id": "s1",
            "state": "queued",
            "suite": form["suite"][1].decode(),
            "name": given or "the agent",
            "owner": owner,
            "sha256": hashlib.sha256(model).hexdigest(),
            "size": len(model),
            "created": TIME,
        }
        self.log = [{"time": TIME, "message": "It waits for its check."}]
        return httpx.Response(202, json=self.detail)

    def _move(self) -> None:
        if self.detail["state"] == "cancelled" or not self.way:
            return
        step = self.way.pop(0)
        if step["state"] != self.detail["state"]:
            self.log.append({"time": TIME, "message": f"Now {step['state']}."})
        self.detail = {key: value for key, value in self.detail.items() if key != "position"} | step

    def _board(self, suite: str) -> dict[str, Any]:
        rank = None if self.why_not else 1
        entry = {
            **FIGURES,
            "rank": rank,
            "tied_with": [],
            "eligible": rank is not None,
            "why_not": self.why_not,
            "agent": {"id": "a7", "name": self.detail["name"], "track": "camera", "kind": "submitted"},
            "entry": "uploaded",
            "evaluation": "e7",
        }
        entries = [entry] if "evaluation" in self.detail else []
        return {"suite": suite, "sha256": "0" * 64, "updated": TIME, "entries": entries}
