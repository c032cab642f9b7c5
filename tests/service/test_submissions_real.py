"""Models that are handed in over HTTP to a real service: the real runner, the real sandbox, the real simulation."""

import hashlib
import http.client
import json
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Self

import httpx
import pytest
from corpus import CORPUS, By, Case
from corpus_files import MARK
from service_harness import RunningService, expect, metrics
from small_models import not_a_number_above, steady, wavering
from submission_owner import Owner, until

pytestmark = pytest.mark.slow
PATIENCE_S = 600.0
SOME = (
    "a-gibibyte-and-more",
    "cut-off",
    "memory-expand",
    "crash",
    "output-missing",
)
"""Uploads of the corpus for every run of the tests: one for each place that refuses them."""
SOONER = {"outputs-large": "batch axis"}
"""Words of reasons that are found before the corpus' own: the contract comes before the first step."""


@pytest.fixture(scope="module")
def serving(bubblewrap: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    folder = tmp_path_factory.mktemp("real")
    running = RunningService(folder / "wrongturn.db", simulators=4, submissions=2, submissions_per_owner=200)
    assert running.ready, running.stderr
    yield running
    assert running.stop() == 0, running.stderr
    assert '"level": "error"' not in running.stderr, running.stderr


@pytest.fixture
def owner(serving: RunningService) -> Iterator[Owner]:
    owner = Owner(serving.url)
    yield owner
    owner.close()


@pytest.mark.soak  # CI sees the rank of an upload in tests/system/test_submitting_page.py
def test_a_submission_is_ranked_like_any_agent(serving: RunningService, owner: Owner) -> None:
    assert expect(httpx.get(f"{serving.url}/health/ready", timeout=60), 200)["submissions"].startswith("on: bubblewrap")
    submission = owner.hand_in(wavering(), suite="smoke@2")
    found = owner.until(submission, "finished", seconds=PATIENCE_S)
    assert found["sha256"] == hashlib.sha256(wavering()).hexdigest()
    board = expect(httpx.get(f"{serving.url}/v1/leaderboards/smoke@2", timeout=60), 200)["entries"]
    (entry,) = [entry for entry in board if entry["evaluation"] == found["evaluation"]]
    assert entry["entry"] == "uploaded"
    assert entry["agent"]["owner"] == owner.name
    assert ("rank" in entry) or entry["why_not"]
    evaluation = expect(httpx.get(f"{serving.url}/v1/evaluations/{found['evaluation']}", timeout=60), 200)
    assert evaluation["state"] == "finished"
    assert len(evaluation["secret"]) == 64
    print("\n".join(owner.log(submission)))


@pytest.mark.soak  # tests/runner fails so in CI
def test_a_model_that_fails_as_it_drives_fails_with_the_step_and_the_tensor(owner: Owner) -> None:
    found = owner.until(owner.hand_in(not_a_number_above(12.0)), "failed", seconds=PATIENCE_S)
    assert "accelerate" in found["reason"]
    assert "step" in found["reason"]


@pytest.mark.soak  # CI cancels one of a stand-in
def test_a_submission_that_runs_is_cancelled_at_once(serving: RunningService, owner: Owner) -> None:
    submission = owner.hand_in(steady())
    until(lambda: owner.get(submission).get("finished", 0) >= 1, PATIENCE_S)
    found = owner.cancel(submission)
    assert found["state"] == "cancelled"
    evaluation = expect(httpx.get(f"{serving.url}/v1/evaluations/{found['evaluation']}", timeout=60), 200)
    assert evaluation["state"] == "finished"
    open_ones = "wrongturn_open_episodes 0.0"
    until(lambda: open_ones in metrics(serving.url))


def outcome(owner: Owner, case: Case, folder: Path) -> str:
    """Return the reason for which an upload is refused, at once or by the check."""
    if case.by is By.SIZE:
        return announced(owner, case.length or 0)
    file = case.write(folder)
    response = owner.post(file.read_bytes(), f"case {case.name}")
    file.unlink()
    if response.status_code != 202:
        return str(response.json()["detail"])
    found = owner.until(response.json()["id"], "failed", seconds=PATIENCE_S)
    assert "agent" not in found
    assert owner.log(found["id"])[-1].endswith(found["reason"])
    return str(found["reason"])


def announced(owner: Owner, length: int) -> str:
    """Announce a body, begin to send it, and return why the service does not want it."""
    place = owner.http.base_url
    connection = http.client.HTTPConnection(place.host, place.port, timeout=60)
    connection.putrequest("POST", "/v1/submissions")
    connection.putheader("Authorization", f"Bearer {owner.token}")
    connection.putheader("Content-Type", "multipart/form-data; boundary=x")
    connection.putheader("Content-Length", str(length))
    connection.endheaders(b"--x\r\n")
    answer = connection.getresponse()
    said = json.loads(answer.read())
    connection.close()
    assert answer.status == 413, said
    return str(said["detail"])


class Others(threading.Thread):
    """An agent that practises all the while, and takes the time of its steps."""

    def __init__(self, serving: RunningService) -> None:
        super().__init__()
        self.enough = threading.Event()
        self.seconds: list[float] = []
        self._serving = serving

    def run(self) -> None:
        with self._serving.agent() as agent:
            while not self.enough.is_set():
                episode = agent.practise()["id"]
                for seq in range(1, 11):
                    began = time.monotonic()
                    expect(agent.step(episode, seq), 200)
                    self.seconds.append(time.monotonic() - began)
                agent.http.delete(f"/v1/episodes/{episode}")
                self.enough.wait(1.0)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.enough.set()
        self.join(300)


def hand_in_all(serving: RunningService, owner: Owner, cases: Iterable[Case], folder: Path) -> None:
    taken: dict[str, float] = {}
    wrong: dict[str, str] = {}
    with Others(serving) as others:
        for case in cases:
            began = time.monotonic()
            words = SOONER.get(case.name, case.words)
            reason = outcome(owner, case, folder)
            if "took longer" in reason and "took longer" not in words:  # the machine stood still meanwhile
                reason = outcome(owner, case, folder)
            taken[case.name] = time.monotonic() - began
            print(f"{case.name}: {taken[case.name]:.1f} s: {reason}")
            if words.lower() not in reason.lower() or not reason.isprintable():
                wrong[case.name] = reason
            assert not MARK.exists()
    # Times are for people: on a quiet machine each is below 10 s.
    slow = {name: round(seconds, 1) for name, seconds in taken.items() if seconds >= 10}
    calls = sorted(others.seconds)
    print(f"{len(taken)} uploads, the slowest after {max(taken.values()):.1f} s; 10 s or more: {slow}")
    print(f"{len(calls)} steps of others: median {calls[len(calls) // 2]:.3f} s, slowest {calls[-1]:.2f} s")
    assert not wrong
    names = {agent["name"] for agent in expect(owner.http.get("/v1/agents?all=true&limit=500"), 200)["agents"]}
    assert not [name for name in names if name.startswith("case ")]


def test_hostile_uploads_fail_with_their_reasons_while_others_drive(
    serving: RunningService, owner: Owner, tmp_path: Path
) -> None:
    """Some of each kind, in every run of the tests; the soak has the whole corpus."""
    cases = [case for case in CORPUS if case.name in SOME]
    assert len(cases) == len(SOME)
    hand_in_all(serving, owner, cases, tmp_path)


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_every_hostile_upload_fails_with_its_reason(serving: RunningService, owner: Owner, tmp_path: Path) -> None:
    hand_in_all(serving, owner, CORPUS, tmp_path)
