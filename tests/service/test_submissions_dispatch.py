"""What happens to a submission after it was taken, played by a runner that does what its model says."""

import json
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import httpx
import pytest
from clocked_service import ClockedService
from fake_pool import FakePool
from service_harness import expect, metrics, problem
from submission_owner import Owner, until

from wrongturn_sandbox import SandboxUnavailableError
from wrongturn_service.submissions import availability, jobs, local_runners

RUNNER = (sys.executable, "-I", "-S", str(Path(__file__).with_name("stand_in_runner.py")))
EPISODES = 12


class Stage:
    """A service whose runner is a stand-in, in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sandboxes: str | None = "a stand-in"
        self.services: list[ClockedService] = []
        self.owners: list[Owner] = []

    def look(self, _socket: Path | None) -> str:
        if self.sandboxes is None:
            raise SandboxUnavailableError("there is no stand-in; bring one")
        return self.sandboxes

    def serve(self, **settings: Any) -> ClockedService:
        settings = {"submissions": 2, "slots": 4, "shutdown_grace_s": 1, **settings}
        pool = FakePool(settings["slots"])
        pool.steps = 2  # an episode is over at once
        service = ClockedService(self.folder / "wrongturn.db", runner=RUNNER, pool=pool, **settings)
        self.services.append(service)
        return service

    def owner(self, service: ClockedService, name: str | None = None) -> Owner:
        owner = Owner(service.url, name)
        self.owners.append(owner)
        return owner

    def model(self, name: str = "", **acts: Any) -> bytes:
        notes = self.folder / f"notes{len(list(self.folder.glob('notes*')))}"
        notes.mkdir()
        plays = {"check": ["pass"], "drive": [{}], "track": "privileged", **acts}
        return json.dumps({"notes": str(notes), "name": name, **plays}).encode()

    def starts(self, model: bytes, task: str) -> list[list[str]]:
        """Process id and name of each start of a runner for a model."""
        notes = Path(json.loads(model)["notes"]) / task
        return [line.split(" ", 1) for line in notes.read_text().splitlines()] if notes.exists() else []


@pytest.fixture
def stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stage]:
    # Nobody has to wait for the next runner, or for the next look for sandboxes.
    for name in ("_FIRST_PAUSE_S", "_LONGEST_PAUSE_S", "_LOOK_S"):
        monkeypatch.setattr(jobs, name, 0.01)
    # However slow the machine is, a runner's last word is told from its death.
    monkeypatch.setattr(local_runners, "_GRACE_S", 60.0)
    stage = Stage(tmp_path)
    with patch.object(availability, "probe", stage.look):
        try:
            yield stage
        finally:
            for owner in stage.owners:
                owner.close()
            for service in reversed(stage.services):
                service.close()


def figure(owner: Owner, line: str) -> float:
    text = metrics(str(owner.http.base_url).rstrip("/"))
    (found,) = [row for row in text.splitlines() if row.startswith(line + " ")]
    return float(found.rsplit(" ", 1)[1])


def ended(pid: str) -> bool:
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return True
    return False


def verdicts(owner: Owner, evaluation: str) -> Counter[str]:
    """Verdicts of the finished episodes of an evaluation, each trial once."""
    episodes = expect(owner.http.get(f"/v1/evaluations/{evaluation}/episodes"), 200)["episodes"]
    finished = [episode for episode in episodes if episode["state"] == "finished"]
    assert len({episode["trial"] for episode in finished}) == len(finished) == EPISODES
    return Counter(episode["outcome"]["verdict"] for episode in finished)


def entries(owner: Owner) -> list[dict[str, Any]]:
    listed: list[dict[str, Any]] = expect(owner.http.get("/v1/leaderboards/smoke@3"), 200)["entries"]
    return listed


def test_a_model_that_works_is_checked_driven_and_on_the_leaderboard(stage: Stage) -> None:
    service = stage.serve()
    owner = stage.owner(service, "ann")
    submission = owner.hand_in(stage.model(), "first")
    found = owner.until(submission, "finished")
    assert found["track"] == "privileged"
    assert found["finished"] == found["episodes"] == EPISODES
    assert verdicts(owner, found["evaluation"]) == {"exit_commanded": EPISODES}
    (entry,) = entries(owner)
    assert entry["entry"] == "uploaded"
    assert entry["evaluation"] == found["evaluation"]
    about = {"id": found["agent"], "name": "first", "track": "privileged", "kind": "submitted", "owner": "ann"}
    assert entry["agent"].items() >= about.items()
    told = "\n".join(owner.log(submission))
    for part in ("check begins", "a stand-in of 0 nodes", "6 steps", "drive begins", "12 of 12", "Finished"):
        assert part in told
    # Each tenth at most, and no verdict before the end.
    assert sum("episodes are over" in line for line in owner.log(submission)) <= 10
    assert "exit" not in told
    assert figure(owner, 'wrongturn_submissions_ended_total{state="finished"}') == 1
    assert figure(owner, "wrongturn_submission_check_seconds_count") == 1
    until(lambda: figure(owner, 'wrongturn_submissions{state="running"}') == 0)
    # What is over stays as it is.
    assert owner.cancel(submission) == found


def test_the_same_model_by_the_same_name_is_the_same_agent_on_another_suite(stage: Stage) -> None:
    service = stage.serve()
    owner, other = stage.owner(service), stage.owner(service)
    model = stage.model()
    suites = ("smoke@3", "wrong-command@3")  # the second is handed in while the first waits for its check
    first, second = (owner.hand_in(model, "mine", suite) for suite in suites)
    found = [owner.until(first, "finished"), owner.until(second, "running", "finished")]
    owner.cancel(second)  # the rest of its 120 episodes shows nothing more
    third = owner.until(owner.hand_in(model, "MINE", "wrong-command-extended@1"), "running", "finished")
    assert len({one["agent"] for one in (*found, third)}) == 1
    problem(owner.post(model, "mine"), 409, "evaluation-open", "suite")
    problem(owner.post(stage.model(), "mine", "navigation@1"), 409, "agent-name-taken", "name")
    problem(other.post(model, "mine", "navigation@1"), 409, "agent-name-taken", "name")
    owner.cancel(third["id"])


def test_an_agent_that_a_second_submission_needs_stays_when_the_first_is_cancelled(stage: Stage) -> None:
    owner = stage.owner(stage.serve(submissions=1))
    stays = owner.hand_in(stage.model(drive=["wait"]), "in the way")
    owner.until(stays, "running")
    model = stage.model()
    first, second = (owner.hand_in(model, "mine", suite) for suite in ("smoke@3", "wrong-command@3"))
    agent = owner.until(first, "checked")["agent"]
    assert owner.until(second, "checked")["agent"] == agent
    owner.cancel(first)
    expect(owner.http.get(f"/v1/agents/{agent}"), 200)
    owner.cancel(second)
    problem(owner.http.get(f"/v1/agents/{agent}"), 404, "unknown-agent")
    owner.cancel(stays)


def test_the_check_knows_the_track_of_the_agent_whose_token_hands_in(stage: Stage) -> None:
    owner = stage.owner(stage.serve())
    model = stage.model(check=["tell agent's track"])
    agent = expect(owner.http.post("/v1/agents", json={"name": "third", "track": "camera"}), 201)
    handed = expect(owner.post(model, None, Authorization=f"Bearer {agent['token']}"), 202)
    assert owner.until(handed["id"], "failed")["reason"] == "agent's track: camera"
    assert owner.until(owner.hand_in(model), "failed")["reason"] == "agent's track: None"


def test_a_model_that_is_refused_in_its_check_leaves_its_reason_and_a_free_name(stage: Stage) -> None:
    service = stage.serve()
    owner = stage.owner(service)
    for act in ("steer: is missing; name an output steer", "refuse in practice"):
        # Nothing keeps the name, so the second one has it too.
        submission = owner.hand_in(stage.model(check=[act]), "second")
        found = owner.until(submission, "failed")
        assert found["reason"] == act.removesuffix(" in practice")
        assert found["reason"] in owner.log(submission)[-1]
        assert "agent" not in found
        assert "evaluation" not in found
        assert expect(owner.http.get("/v1/agents"), 200)["agents"] == []
        assert figure(owner, "wrongturn_open_episodes") == 0
    assert owner.until(owner.hand_in(stage.model(), "second"), "running", "finished")["name"] == "second"


def test_a_model_that_fails_while_it_drives_counts_as_what_it_is(stage: Stage) -> None:
    service = stage.serve()
    owner = stage.owner(service)
    submission = owner.hand_in(stage.model(drive=[{"after": 3, "then": "steer: is not a finite number"}]))
    found = owner.until(submission, "failed")
    assert found["reason"] == "steer: is not a finite number"
    assert verdicts(owner, found["evaluation"]) == {"exit_commanded": 3, "aborted": EPISODES - 3}
    (entry,) = entries(owner)
    assert entry["evaluation"] == found["evaluation"]
    assert not entry["eligible"]
    assert figure(owner, "wrongturn_open_episodes") == 0


def test_a_model_that_fails_before_its_first_step_never_drove(stage: Stage) -> None:
    service = stage.serve()
    owner = stage.owner(service)
    submission = owner.hand_in(stage.model(drive=[{"at once": "it does not load again"}]), "third")
    found = owner.until(submission, "failed")
    assert "evaluation" not in found
    assert "agent" not in found
    assert entries(owner) == []
    owner.until(owner.hand_in(stage.model(), "third"), "running", "finished")


def test_a_lost_runner_takes_nothing_with_it(stage: Stage) -> None:
    service = stage.serve()
    owner = stage.owner(service)
    model = stage.model(check=["die", "die in practice", "nonsense", "pass"], drive=[{"after": 4, "then": "die"}, {}])
    submission = owner.hand_in(model)
    found = owner.until(submission, "finished")
    assert verdicts(owner, found["evaluation"]) == {"exit_commanded": EPISODES}
    assert len(stage.starts(model, "check")) == 4
    assert len(stage.starts(model, "drive")) == 2
    lost = [line for line in owner.log(submission) if "was lost" in line]
    assert len(lost) == 4
    assert "signal 9" in lost[0]
    assert figure(owner, "wrongturn_runners_lost_total") == 4
    # The episode of the check and the one of the drive that were open.
    assert figure(owner, 'wrongturn_episodes_voided_total{reason="runner-ended"}') == 2
    assert figure(owner, "wrongturn_open_episodes") == 0


def test_a_runner_that_gets_no_sandbox_is_not_lost(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "ATTEMPTS", 2)
    service = stage.serve()
    owner = stage.owner(service)
    model = stage.model(check=[*["no room"] * 3, "pass"], drive=[*[{"at once": "no room"}] * 3, {}])
    submission = owner.hand_in(model)
    owner.until(submission, "finished")
    assert len(stage.starts(model, "check")) == len(stage.starts(model, "drive")) == 4
    assert sum("sandboxes are taken" in line for line in owner.log(submission)) == 2
    assert figure(owner, "wrongturn_runners_lost_total") == 0


def test_runners_that_are_lost_after_an_episode_do_not_add_up(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "ATTEMPTS", 2)
    service = stage.serve()
    owner = stage.owner(service)
    model = stage.model(drive=[{"after": 1, "then": "die"}] * 3 + [{}])
    found = owner.until(owner.hand_in(model), "finished")
    assert verdicts(owner, found["evaluation"]) == {"exit_commanded": EPISODES}
    assert len(stage.starts(model, "drive")) == 4


@pytest.mark.parametrize(("task", "acts"), [("check", ["die"]), ("drive", [{"after": 0, "then": "die"}])])
def test_after_five_lost_runners_the_service_gives_up(stage: Stage, task: str, acts: list[Any]) -> None:
    service = stage.serve()
    owner = stage.owner(service)
    model = stage.model(**{task: acts})
    found = owner.until(owner.hand_in(model), "failed")
    assert f"could not {task} it" in found["reason"]
    assert "signal 9" in found["reason"]
    assert len(stage.starts(model, task)) == 5
    if task == "drive":
        assert verdicts(owner, found["evaluation"]) == {"aborted": EPISODES}
    assert figure(owner, "wrongturn_open_episodes") == 0


@pytest.mark.parametrize("state", ["queued", pytest.param("checked", marks=pytest.mark.soak), "running"])
def test_a_submission_is_cancelled_at_once_in_each_state(stage: Stage, state: str) -> None:
    service = stage.serve(submissions=1)
    owner = stage.owner(service)
    blocking = stage.model(drive=[{"after": 2, "then": "hang"}])
    blocker = owner.hand_in(blocking, "blocker")
    owner.until(blocker, "running")
    task = "drive" if state == "running" else "check"
    model = blocking if state == "running" else stage.model(check=["hang" if state == "queued" else "pass"])
    submission = blocker if state == "running" else owner.hand_in(model, "cancelled")
    if state == "checked":
        owner.until(submission, "checked")
    until(lambda: bool(stage.starts(model, task)))
    if state == "running":
        until(lambda: owner.get(submission).get("finished") == 2)
    found = owner.cancel(submission)
    assert found["state"] == "cancelled"
    assert "owner" in found["reason"]
    until(lambda: ended(stage.starts(model, task)[-1][0]))
    if state == "running":
        assert figure(owner, "wrongturn_open_episodes") == 0
        assert verdicts(owner, found["evaluation"]) == {"exit_commanded": 2, "aborted": EPISODES - 2}
    else:
        assert "agent" not in found
        owner.cancel(blocker)
        owner.until(owner.hand_in(stage.model(), "cancelled"), "running", "finished")  # the name is free
    again = owner.cancel(submission)
    assert again == found


@pytest.mark.parametrize(
    "state",
    [pytest.param("queued", marks=pytest.mark.soak), pytest.param("checked", marks=pytest.mark.soak), "running"],
)
def test_a_stop_of_the_service_loses_nothing(stage: Stage, state: str) -> None:
    service = stage.serve(submissions=1)
    owner = stage.owner(service)
    blocking = stage.model(drive=[{"after": 3, "then": "hang"}, {}])
    blocker = owner.hand_in(blocking)
    until(lambda: owner.get(blocker).get("finished") == 3)
    model = stage.model(check=["hang in practice" if state == "queued" else "pass", "pass"])
    submission = blocker if state == "running" else owner.hand_in(model)
    if state == "queued":
        until(lambda: bool(stage.starts(model, "check")))
    else:
        owner.until(submission, state)
    began = time.monotonic()
    service.signal()
    service.join()
    print(f"stopped within {time.monotonic() - began:.1f} s")
    assert ended(stage.starts(blocking, "drive")[0][0])
    assert not [line for line in service.logs if line["log_level"] == "error"]
    service.close()
    stage.services.remove(service)
    again = stage.serve(submissions=1)
    owner.move(again.url)
    for one in (blocker, submission):
        found = owner.until(one, "finished")
        assert verdicts(owner, found["evaluation"]) == {"exit_commanded": EPISODES}
    assert len(stage.starts(blocking, "drive")) == 2
    assert len(entries(owner)) == (1 if state == "running" else 2)


def test_without_sandboxes_submissions_are_refused_and_those_that_run_wait_without_being_closed(stage: Stage) -> None:
    service = stage.serve(evaluation_idle_h=24)
    owner = stage.owner(service)
    model = stage.model(drive=[{"after": 3, "then": "hang"}, {}])
    submission = owner.hand_in(model)
    until(lambda: owner.get(submission).get("finished") == 3)
    stage.sandboxes = None
    os.kill(int(stage.starts(model, "drive")[0][0]), 9)
    until(lambda: any("no sandbox" in line for line in owner.log(submission)))
    refused = problem(owner.post(stage.model(), "too early"), 503, "submissions-unavailable")
    assert "bring one" in refused["detail"]
    ready = expect(httpx.get(f"{service.url}/health/ready", timeout=60), 200)
    assert ready["submissions"].startswith("off: there is no stand-in")
    service.pass_time(25 * 3600)  # leases, housekeeping and the idle limit go by this clock
    service.pass_time(60)
    assert owner.get(submission)["state"] == "running"
    stage.sandboxes = "a stand-in"
    found = owner.until(submission, "finished")
    assert verdicts(owner, found["evaluation"]) == {"exit_commanded": EPISODES}
    assert expect(httpx.get(f"{service.url}/health/ready", timeout=60), 200)["submissions"] == "on: a stand-in"


def test_an_agent_that_hands_in_by_its_own_token_is_not_driven_by_it_too(stage: Stage) -> None:
    service = stage.serve()
    with service.agent() as agent:
        owner = stage.owner(service)
        owner.token = agent.token
        owner.move(service.url)
        model = stage.model(drive=[{"after": 3, "then": "hang"}, {}])
        submission = expect(owner.post(model, None), 202)["id"]
        until(lambda: owner.get(submission).get("finished") == 3)
        found = owner.get(submission)
        assert found["agent"] == agent.id
        assert agent.reset(found["evaluation"]).status_code == 403
        problem(agent.http.post("/v1/evaluations", json={"suite": "smoke@3"}), 409, "evaluation-open")
        # Its own practice is not the runner's, which ends without it.
        practice = agent.practise()
        os.kill(int(stage.starts(model, "drive")[0][0]), 9)
        owner.until(submission, "finished")
        expect(agent.step(practice["id"], 1), 200)
