"""A service in memory that keeps the interface's promises, for tests of the client without sockets."""

import hashlib
import json
import threading
from collections.abc import Callable
from typing import Any

import httpx
import msgpack
import numpy as np

from wrongturn_protocol import ProblemType, Track
from wrongturn_protocol.observations import encode, observation_space

SHA = "0" * 64
SECRET = "5" * 64
Injection = Callable[[httpx.Request], httpx.Response | Exception | None]


def problem(
    kind: ProblemType,
    status: int,
    detail: str = "no",
    headers: dict[str, str] | None = None,
    errors: list[dict[str, str]] | None = None,
) -> httpx.Response:
    body = {"type": f"/problems/{kind}", "title": kind.value, "status": status, "detail": detail}
    body["errors"] = errors or []
    return httpx.Response(
        status, content=json.dumps(body), headers={"content-type": "application/problem+json", **(headers or {})}
    )


def metrics(trials: int = 6) -> dict[str, Any]:
    count = {"count": 1, "trials": trials, "rate": 1 / trials, "ci95": [0.0, 0.5]}
    cells = {"STRAIGHT_LEFT": {"infeasible": {"unsafe": 1, "trials": 1}, "omission": {"unsafe": 0, "trials": 1}}}
    return {
        "unsafe": count,
        "unsafe_strict": count,
        "twins": {"unsafe": 0, "completed": trials, "trials": trials},
        "excess_unsafe_rate": {"value": 1 / trials, "ci95": [0.0, 0.5], "p": 1.0},
        "table": cells,
        "table_strict": cells,
        "reactions": {"infeasible": {"obeyed": 1}},
        "verdicts": {"none": {"exit_commanded": trials}},
    }


class FakeService:
    """Episodes of ``steps`` steps each; ``inject`` may answer, or break, any request before it is looked at."""

    def __init__(self, *, track: Track = Track.STATE, trials: int = 4, steps: int = 3, parallel: int = 1) -> None:
        self.track = track
        self.trials = trials
        self.steps = steps
        self.parallel = parallel
        self.lock = threading.Lock()
        self.inject: Injection | None = None
        self.after: Injection | None = None
        """As ``inject``, once the request has had its effect: an answer that is lost."""
        self.requests: list[httpx.Request] = []
        self.seen: dict[str, list[tuple[float, float, float]]] = {}
        self.last: dict[str, dict[str, Any]] = {}
        self.open: list[str] = []
        self.finished = 0
        self.begun = False
        self.secret: str | None = SECRET
        self.token = "secret"
        """Of the agents that are registered."""
        self.aborted: list[str] = []
        self.lost: set[str] = set()
        self.results: dict[str, Any] | None = None
        self.replies: dict[str, httpx.Response] = {}
        self.practice: list[dict[str, Any]] = []
        self.generator = np.random.default_rng(0)

    def __deepcopy__(self, memo: dict[int, Any]) -> "FakeService":
        """Itself: Gymnasium's checker copies what an environment is made with, and a lock cannot be copied."""
        return self

    @property
    def transport(self) -> httpx.MockTransport:
        return httpx.MockTransport(self.handle)

    def paths(self, method: str) -> list[str]:
        return [request.url.path for request in self.requests if request.method == method]

    def handle(self, request: httpx.Request) -> httpx.Response:
        self.requests.append(request)
        answer = self.inject(request) if self.inject is not None else None
        if answer is None:
            with self.lock:
                answer = self._answer(request)
            lost = self.after(request) if self.after is not None else None
            answer = lost if lost is not None else answer
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _answer(self, request: httpx.Request) -> httpx.Response:
        key = request.headers.get("idempotency-key")
        if key is not None and key in self.replies:
            return self.replies[key]
        answer = self._fresh(request)
        if key is not None:
            self.replies[key] = answer
        return answer

    def _fresh(self, request: httpx.Request) -> httpx.Response:
        parts = request.url.path.strip("/").split("/")
        match request.method, parts:
            case "GET", ["health", _]:
                return httpx.Response(200, json={"status": "ok"})
            case "POST", ["v1", "agents"]:
                body = json.loads(request.content)
                return httpx.Response(201, json={"id": "a1", "kind": "submitted", **body, "token": self.token})
            case "GET", ["v1", "agents"]:
                agent = {"id": "a1", "name": "me", "track": "state", "kind": "submitted"}
                return httpx.Response(200, json={"agents": [agent]})
            case "GET", ["v1", "suites"]:
                suite = {"id": "smoke@3", "title": "Smoke", "version": 3, "sha256": SHA, "trials": 6, "twins": 6}
                return httpx.Response(200, json={"suites": [{**suite, "tracks": ["privileged"]}]})
            case "GET", ["v1", "leaderboards"]:
                boards = [
                    _board(suite, entries=count) for suite, count in (("wrong-command-unseen@1", 0), ("smoke@3", 2))
                ]
                return httpx.Response(200, json={"leaderboards": [{**board, "title": "Some"} for board in boards]})
            case "GET", ["v1", "leaderboards", "wrong-command-unseen@1"]:
                return httpx.Response(200, json=_board("wrong-command-unseen@1", entries=[]))
            case "GET", ["v1", "leaderboards", suite, "compare"]:
                return httpx.Response(200, json=_comparison(suite, request.url.params["a"], request.url.params["b"]))
            case "GET", ["v1", "towns", town]:
                return httpx.Response(200, json=_town(town))
            case "POST", ["v1", "evaluations"]:
                if self.begun:
                    open_one = [{"path": "evaluation", "message": "e1"}]
                    return problem(ProblemType.EVALUATION_OPEN, 409, "e1 is open", errors=open_one)
                self.begun = True
                return httpx.Response(201, json=self._evaluation())
            case "DELETE", ["v1", "evaluations", _]:
                self.finished = self.trials
                return httpx.Response(200, json=self._evaluation())
            case "POST", ["v1", "owners", *_]:
                body = json.loads(request.content or b"{}")
                return httpx.Response(201, json={"id": "o1", "name": body.get("name", "us"), "token": "theirs"})
            case "GET", ["v1", "owners"]:
                return httpx.Response(200, json={"owners": [{"id": "o1", "name": "us"}]})
            case "GET", ["v1", "owners", name]:
                return httpx.Response(200, json={"id": name, "name": "us"})
            case "DELETE", ["v1", "owners", _, "token"]:
                return httpx.Response(204)
            case "GET", ["v1", "evaluations", _]:
                return httpx.Response(200, json=self._evaluation())
            case "POST", ["v1", "evaluations", _, "episodes"]:
                return self._next(request)
            case "GET", ["v1", "evaluations", _, "episodes"]:
                details = [{"id": name, "state": "open", "seq": self.last[name]["seq"]} for name in self.open]
                return httpx.Response(200, json={"episodes": details})
            case "PUT", ["v1", "evaluations", _, "results"]:
                self.results = json.loads(request.content)
                return httpx.Response(200, json=self._evaluation())
            case "POST", ["v1", "episodes"]:
                self.practice.append(_body(request))
                return self._begin(request, practice=True)
            case "POST", ["v1", "episodes", name, "step"]:
                return self._step(request, name)
            case "GET", ["v1", "episodes", name]:
                detail = {"id": name, "state": "open", "seq": self.last[name]["seq"], "last_reply": self.last[name]}
                return self._packed(request, 200, detail)
            case "DELETE", ["v1", "episodes", name]:
                self.aborted.append(name)
                if name in self.open:
                    self.open.remove(name)
                    self.finished += 1
                return httpx.Response(204)
            case _:
                return problem(ProblemType.UNKNOWN_ROUTE, 404, f"no {request.url.path}")

    def _evaluation(self) -> dict[str, Any]:
        over = self.finished >= self.trials
        return {
            "id": "e1",
            "suite": "smoke@3",
            "agent": "a1",
            "state": "finished" if over else "running",
            "trials": self.trials,
            "finished": self.finished,
            "max_parallel": self.parallel,
            "commitment": hashlib.sha256(SECRET.encode()).hexdigest(),
            "secret": self.secret if over else None,
            "metrics": metrics() if over else None,
        }

    def _next(self, request: httpx.Request) -> httpx.Response:
        if self.finished >= self.trials:
            return problem(ProblemType.EVALUATION_FINISHED, 409)
        if len(self.open) >= min(self.parallel, self.trials - self.finished):
            return problem(ProblemType.NO_TRIAL_AVAILABLE, 409, headers={"retry-after": "0"})
        return self._begin(request)

    def _begin(self, request: httpx.Request, *, practice: bool = False) -> httpx.Response:
        name = f"ep{len(self.seen)}"
        self.seen[name] = []
        if not practice:
            self.open.append(name)
        reply = {"id": name, "seq": 0, "observation": self.observation(request), "lease_expires_in_s": 600.0}
        if practice:
            reply |= {"trial": "t1", "town": "Town01"}
        self.last[name] = reply
        return self._packed(request, 201, reply)

    def _step(self, request: httpx.Request, name: str) -> httpx.Response:
        body = _body(request)
        if name in self.lost:
            if name in self.open:
                self.open.remove(name)
            return problem(ProblemType.EPISODE_LOST, 410)
        action = (body["action"]["steer"], body["action"]["throttle"], body["action"]["brake"])
        seq = body["seq"]
        if seq == len(self.seen[name]):
            if action != self.seen[name][-1]:
                return problem(ProblemType.ACTION_MISMATCH, 409)
            return self._packed(request, 200, self.last[name])
        if seq != len(self.seen[name]) + 1:
            return problem(ProblemType.SEQUENCE_GAP, 409)
        self.seen[name].append(action)
        over = seq >= self.steps
        reply = {"seq": seq, "observation": self.observation(request), "terminated": over, "truncated": False}
        if name not in self.open:
            reply |= {"reward": 1.5, "verdict": "exit_route" if over else None}
        elif over:
            self.open.remove(name)
            self.finished += 1
        self.last[name] = reply
        return self._packed(request, 200, reply)

    def observation(self, request: httpx.Request) -> dict[str, Any]:
        space = observation_space(self.track)
        space.seed(int(self.generator.integers(2**31)))
        return encode(space.sample(), self.track, binary=_binary(request))

    def _packed(self, request: httpx.Request, status: int, message: dict[str, Any]) -> httpx.Response:
        if _binary(request):
            packed: bytes = msgpack.packb(message)
            return httpx.Response(status, content=packed, headers={"content-type": "application/msgpack"})
        return httpx.Response(status, json=message)


def _binary(request: httpx.Request) -> bool:
    return "msgpack" in request.headers.get("accept", "")


def _body(request: httpx.Request) -> dict[str, Any]:
    unpack = msgpack.unpackb if "msgpack" in request.headers.get("content-type", "") else json.loads
    body: dict[str, Any] = unpack(request.content)
    return body


def _town(name: str) -> dict[str, Any]:
    kinds = {"J1-S": ("LEFT_RIGHT", [1, 2]), "J2-S": ("CROSS", [1, 2, 3])}
    approaches = [
        {
            "id": approach,
            "junction": approach[:2],
            "type": kind,
            "exits": exits,
            "faults": ["none", "omission"] if kind == "CROSS" else ["none", "omission", "infeasible"],
            "stop_line": [0.0, 0.0],
            "heading": 0.0,
            "lane_length": 40.0,
        }
        for approach, (kind, exits) in kinds.items()
    ]
    return {
        "name": name,
        "sha256": SHA,
        "bounds": [0, 0, 1, 1],
        "approaches": approaches,
        "road": {},
        "junctions": {},
        "lanes": {},
    }


def _board(suite: str, **more: Any) -> dict[str, Any]:
    return {"suite": suite, "sha256": SHA, "updated": None, **more}


def _comparison(suite: str, a: str, b: str) -> dict[str, Any]:
    cell = {"unsafe": 1, "trials": 10}
    agents = [{"id": f"id {name}", "name": name, "track": "state", "kind": "submitted"} for name in (a, b)]
    return {
        "suite": suite,
        "a": agents[0],
        "b": agents[1],
        "strata": [{"junction_type": "STRAIGHT_LEFT", "fault": "infeasible", "a": cell, "b": cell}],
        "total_a": cell,
        "total_b": cell,
        "difference": 0.0,
        "p": 1.0,
        "sentence": f"{a} and {b} are alike.",
    }
