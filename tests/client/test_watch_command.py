"""``wrongturn watch``: an evaluation in memory, which each look moves on."""

from typing import Any

import httpx
import pytest
from client_fake_service import metrics, problem
from typer.testing import CliRunner, Result

from wrongturn_client import Client, cli, following
from wrongturn_protocol import ProblemType

EVALUATION = {"id": "ev_1", "agent": "a1", "suite": "smoke@3", "trials": 12, "max_parallel": 1}
AGENT = {"id": "a1", "name": "me", "track": "state", "kind": "submitted"}
WAY: list[dict[str, Any]] = [
    {"state": "running", "finished": 3},
    {"state": "running", "finished": 9},
    {"state": "finished", "finished": 12, "metrics": metrics()},
]


@pytest.fixture
def way(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What the looks at the evaluation find, one after the other."""
    way = list(WAY)

    def answer(request: httpx.Request) -> httpx.Response:
        match request.url.path.strip("/").split("/")[1:]:
            case ["evaluations", "ev_1"]:
                now = way.pop(0)
                if now["state"] == "interrupted":
                    raise KeyboardInterrupt
                return httpx.Response(200, json={**EVALUATION, **now})
            case ["agents", "a1"]:
                return httpx.Response(200, json=AGENT)
            case ["leaderboards", suite]:
                return httpx.Response(200, json={"suite": suite, "sha256": "0" * 64, "updated": None, "entries": []})
        return problem(ProblemType.UNAUTHENTICATED, 401, "this call needs a token")

    monkeypatch.setattr(
        "wrongturn_client.client.Client", lambda url: Client(url, transport=httpx.MockTransport(answer), patience=0)
    )
    monkeypatch.setattr(following, "_PAUSE", 0.0)
    return way


def watch(evaluation: str) -> Result:
    return CliRunner().invoke(cli.app, ["watch", evaluation, "--url", "http://fake:80"])


def test_it_ends_with_the_rank_and_the_page(way: list[dict[str, Any]]) -> None:
    done = watch("ev_1")
    assert done.exit_code == 0, done.output
    assert way == []
    assert "me on smoke@3: 3 of 12 episodes" in done.stderr
    assert "leaderboard" in done.stdout
    assert done.stdout.endswith("http://fake:80/agents/a1?evaluation=ev_1\n")


def test_ctrl_c_says_that_the_evaluation_goes_on(way: list[dict[str, Any]]) -> None:
    way[1:] = [{"state": "interrupted"}]
    done = watch("ev_1")
    assert (done.exit_code, "The evaluation goes on without you." in done.stderr) == (130, True)


def test_what_cannot_be_watched_is_told(way: list[dict[str, Any]]) -> None:
    way[:] = [{"state": "cancelled", "finished": 0}]
    for evaluation, said in {
        "ev_2": "EVALUATION: http://fake:80 has no finished evaluation ev_2; to watch a running one, set",
        "../ev_1": "EVALUATION: '../ev_1' is no evaluation's id; give one, which begins with ev_",
        "ev_1": "EVALUATION: ev_1 was cancelled, so it has no result",
    }.items():
        assert said in str(watch(evaluation).exception)
