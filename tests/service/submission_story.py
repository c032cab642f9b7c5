"""A service in this process that takes submissions, and that a test plays the dispatcher for."""

import contextlib
import inspect
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any
from unittest.mock import AsyncMock, patch

import httpx
from app_harness import application, register
from clocked_service import ClockedService
from fake_pool import FakePool
from model_form import TYPE, model
from service_harness import COAST, OPERATOR, expect
from typing_extensions import override

from wrongturn_networks import load_suite
from wrongturn_protocol import Entry, SubmissionState, Track
from wrongturn_service.episodes.evaluations import new_evaluation
from wrongturn_service.service import Service
from wrongturn_service.submissions import availability
from wrongturn_service.submissions.dispatcher import Dispatcher

_SLOTS = 32


@contextlib.asynccontextmanager
async def handing_in(folder: Path, token: str = "", **settings: Any) -> AsyncIterator[httpx.AsyncClient]:
    """A client with the token of the owner "ada". Nothing is checked or driven unless the test does it.

    The token is the owner's, if a service has been here before.
    """
    again = {"registration": "operator"} if token else {}
    with patch.object(availability, "probe", lambda _: "a sandbox of the test"):
        async with application(folder, FakePool(_SLOTS), operator_token=OPERATOR, **again, **settings) as http:
            http.headers["Authorization"] = f"Bearer {token or await owner(http, 'ada')}"
            yield http


def story(**settings: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Run an async test with the client of :func:`handing_in`, as its argument ``http``."""

    def decorate(test: Callable[..., Any]) -> Callable[..., Any]:
        wanted = dict(inspect.signature(test).parameters)
        folder = inspect.Parameter("tmp_path", inspect.Parameter.POSITIONAL_OR_KEYWORD)

        async def run(tmp_path: Path, **given: Any) -> None:
            async with handing_in(tmp_path, **settings) as http:
                await test(http, **given, **({"tmp_path": tmp_path} if "tmp_path" in wanted else {}))

        run.__name__, run.__doc__, run.__module__ = test.__name__, test.__doc__, test.__module__
        more = [each for name, each in wanted.items() if name not in {"http", "tmp_path"}]
        run.__signature__ = inspect.Signature([folder, *more])  # type: ignore[attr-defined]
        return run

    return decorate


class TakingService(ClockedService):
    """A service behind real sockets that takes submissions, and starts no runners."""

    def __init__(self, folder: Path, **settings: Any) -> None:
        with contextlib.ExitStack() as stack:
            stack.enter_context(patch.object(availability, "probe", lambda _: "a sandbox of the test"))
            stack.enter_context(patch.object(Dispatcher, "open", AsyncMock()))
            super().__init__(folder / "wrongturn.db", operator_token=OPERATOR, **settings)
            self._patches = stack.pop_all()

    @property
    def parts(self) -> Service:
        """The service without HTTP."""
        found: Service = self.app.state.service
        return found

    def owner(self, name: str) -> str:
        """The token of a new owner."""
        token: str = expect(httpx.post(f"{self.url}/v1/owners", json={"name": name}, timeout=60), 201)["token"]
        return token

    @override
    def close(self) -> None:
        super().close()
        self._patches.close()


def service_of(http: httpx.AsyncClient) -> Service:
    found: Service = http.app.state.service  # type: ignore[attr-defined]
    return found


async def owner(http: httpx.AsyncClient, name: str) -> str:
    """The token of a new owner."""
    token: str = expect(await register(http, "/v1/owners", name=name), 201)["token"]
    return token


async def agent(http: httpx.AsyncClient, name: str, track: str = "camera") -> dict[str, Any]:
    """A new agent of the client's owner."""
    return expect(await http.post("/v1/agents", json={"name": name, "track": track}), 201)


async def hand_in(http: httpx.AsyncClient, body: bytes = b"", **headers: str) -> httpx.Response:
    """Hand a model in; by default one with the name "mine"."""
    named = {"Content-Type": TYPE, **{name.replace("_", "-"): value for name, value in headers.items()}}
    return await http.post("/v1/submissions", content=body or model(), headers=named)


async def checked(http: httpx.AsyncClient, submission: str, track: Track = Track.CAMERA) -> str:
    """Play a check that has made the agent; the token of its runner."""
    return await looked_at(service_of(http), submission, track)


async def looked_at(service: Service, submission: str, track: Track = Track.CAMERA) -> str:
    """As :func:`checked`, for a service behind real sockets."""
    submissions = service.submissions
    await submissions.make_agent(submission, track)
    return await submissions.give_token(submission)


async def running(http: httpx.AsyncClient, submission: str) -> tuple[str, str]:
    """Play the begin of a drive; the evaluation and the token of its runner."""
    return await begun(service_of(http), submission)


async def driven(http: httpx.AsyncClient, submission: str) -> str:
    """Play a check, the begin of a drive and one step; the evaluation."""
    await checked(http, submission)
    evaluation, token = await running(http, submission)
    runner = {"Authorization": f"Bearer {token}"}
    episode = expect(await http.post(f"/v1/evaluations/{evaluation}/episodes", headers=runner), 201)["id"]
    expect(await http.post(f"/v1/episodes/{episode}/step", json={"seq": 1, "action": COAST}, headers=runner), 200)
    return evaluation


async def begun(service: Service, submission: str) -> tuple[str, str]:
    """As :func:`running`, for a service behind real sockets."""
    submissions = service.submissions
    await submissions.rows.set_state(submission, SubmissionState.CHECKED)
    row = await submissions.rows.get(submission)
    assert row is not None
    assert row.agent_id is not None
    assert row.track is not None
    evaluation = new_evaluation(load_suite(row.suite), row.agent_id, Track(row.track), None, Entry.UPLOADED)
    await submissions.rows.begin_evaluation(submission, evaluation)
    return evaluation.id, await submissions.give_token(submission)
