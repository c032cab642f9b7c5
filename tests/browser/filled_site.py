"""A service whose pages have something to show: two baselines, each with a finished evaluation."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import httpx
from service_harness import RunningService, expect

from wrongturn_agents.registry import resolve
from wrongturn_client import Client

SUITE = "smoke@3"
OPERATOR = "the-operators-own-token"


@dataclass(frozen=True)
class Site:
    """What the tests of pages need to know."""

    url: str
    agents: dict[str, str]
    """Ids of the agents, by name."""
    evaluations: dict[str, str]
    """Ids of their evaluations on the suite."""
    tokens: dict[str, str]

    def get(self, path: str) -> dict:
        """Return the reply to a REST call."""
        return expect(httpx.get(f"{self.url}{path}", timeout=120), 200)


@contextlib.contextmanager
def filled_site(
    folder: Path, names: Sequence[str] = ("careful", "obeys-blindly"), suite: str = SUITE
) -> Iterator[Site]:
    """Run a service and drive its agents."""
    running = RunningService(
        folder / "wrongturn.db", operator_token=OPERATOR, submissions=1, simulator_start_timeout_s=900
    )
    assert running.ready, running.stderr
    agents, evaluations, tokens = {}, {}, {}
    for name in names:
        found = resolve(name)
        body = {"name": name, "track": found.track, "kind": found.kind, "description": found.description}
        operator = {"Authorization": f"Bearer {OPERATOR}"}
        made = expect(httpx.post(f"{running.url}/v1/agents", json=body, headers=operator, timeout=120), 201)
        with Client(running.url, made["token"]) as client:
            evaluations[name] = client.evaluate(found.make(), suite).id
        agents[name], tokens[name] = made["id"], made["token"]
    yield Site(running.url, agents, evaluations, tokens)
    assert running.stop() == 0, running.stderr
    assert '"level": "error"' not in running.stderr, running.stderr
