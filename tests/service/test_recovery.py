"""What dies is brought back: simulators in the middle of an episode, the service with episodes open."""

import os
import signal
import socket
import uuid
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
import typer
from drive_socket import DriveSocket
from guest_processes import gone, wait_until
from service_harness import GAS, Agent, RunningService, expect, figure, problem
from typer.testing import CliRunner

from wrongturn_service.cli import serve

WIGGLE = [{"steer": (-1) ** n * 0.3, "throttle": 0.5, "brake": 0.0} for n in range(12)]


@pytest.fixture
def own(tmp_path: Path):
    """A service of the test's own; called again, the same database by another process."""
    started: list[RunningService] = []

    def start(*options: str, **settings: object) -> RunningService:
        running = RunningService(tmp_path / "wrongturn.db", *options, simulators=2, **settings)
        started.append(running)
        return running

    yield start
    for running in started:
        if running.process.poll() is None or not running.process.stdout.closed:
            running.kill()


@pytest.fixture(scope="module")
def frail(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    """A service whose simulators and database may be disturbed."""
    running = RunningService(
        tmp_path_factory.mktemp("frail") / "wrongturn.db", simulators=2, simulator_timeout_s=4, registration_limit=1000
    )
    assert running.ready, running.stderr
    yield running
    assert running.stop() == 0, running.stderr


def test_a_simulator_that_is_killed_in_the_middle_of_an_episode(frail: RunningService) -> None:
    counted = ("wrongturn_replays_total", "wrongturn_simulator_deaths_total")
    before = [figure(frail, name) for name in counted]
    with frail.agent() as agent:
        trajectories, replies = [], []
        for kills in (0, 2):
            episode = agent.practise(track="privileged", fault="infeasible")["id"]
            seen = []
            for seq, action in enumerate(WIGGLE, 1):
                if kills and seq in {2, 9}:
                    (pid,) = frail.simulators()
                    os.kill(pid, signal.SIGKILL)
                seen.append(expect(agent.step(episode, seq, action), 200))
            _, last = agent.drive(episode, GAS, len(WIGGLE) + 1)
            seen.append(last)
            replies.append(seen)
            trajectories.append(agent.trajectory(episode))
        assert replies[0] == replies[1]
        assert trajectories[0] == trajectories[1]
    # A machine that stands still for seconds makes a third seem to hang.
    assert all(figure(frail, name) >= number + 2 for name, number in zip(counted, before, strict=True))


def test_a_simulator_that_is_killed_under_a_socket(frail: RunningService) -> None:
    """The connection stays: the client only waits for the replay."""
    with frail.agent() as agent, DriveSocket(frail, agent.token) as drive:
        replies = []
        for kill in (False, True):
            episode = drive.one("practise", {"town": "Town01", "approach": "J3-S", "seed": 3}, None)[1]["id"]
            for seq in range(1, 6):
                if kill and seq == 3:
                    (pid,) = frail.simulators()
                    os.kill(pid, signal.SIGKILL)
                replies.append(drive.one("step", episode, seq, 0.1, 0.5, 0.0))
            drive.one("abort", episode)
        assert replies[:5] == replies[5:]


def test_a_simulator_that_hangs(frail: RunningService) -> None:
    with frail.agent() as agent:
        episode = agent.practise()["id"]
        (pid,) = frail.simulators()
        os.kill(pid, signal.SIGSTOP)
        assert expect(agent.step(episode, 1), 200)["seq"] == 1
        assert pid not in frail.simulators()


def test_a_service_that_is_killed_with_episodes_open(own) -> None:
    service = own()
    with service.agent() as agent:
        evaluation = agent.evaluate()["id"]
        done = expect(agent.reset(evaluation), 201)["id"]
        steps, last = agent.drive(done)
        key = {"Idempotency-Key": str(uuid.uuid4())}
        body = {"name": f"agent {uuid.uuid4().hex[:8]}", "track": "camera"}
        registered = expect(httpx.post(f"{service.url}/v1/agents", json=body, headers=key, timeout=60), 201)
        opened = expect(agent.reset(evaluation), 201)["id"]
        practice = agent.practise()["id"]
        expect(agent.step(opened, 1), 200)
        simulators = service.simulators()
        service.kill()
        wait_until(lambda: all(map(gone, simulators)))  # none outlives its service

        again = own()
        with Agent(again.url, {"id": agent.id, "name": agent.name, "token": agent.token}) as back:
            problem(back.step(opened, 2), 410, "episode-lost")
            problem(back.step(practice, 1), 410, "episode-lost")
            problem(back.http.get(f"/v1/episodes/{opened}/trajectory"), 410, "episode-lost")
            problem(back.http.delete(f"/v1/episodes/{opened}"), 410, "episode-lost")
            assert expect(back.http.get(f"/v1/episodes/{opened}"), 200)["state"] == "lost"
            # What was told is still there: the finished one, its last reply, the agent behind its key.
            assert expect(back.step(done, steps), 200) == last
            again_told = httpx.post(f"{again.url}/v1/agents", json=body, headers=key, timeout=60)
            assert expect(again_told, 201)["id"] == registered["id"]
            detail = expect(back.http.get(f"/v1/evaluations/{evaluation}"), 200)
            assert (detail["state"], detail["finished"]) == ("running", 1)
            # The lost trial comes again, and nobody is charged for it.
            count = 1
            while (response := back.reset(evaluation)).status_code == 201:
                assert back.http.delete(f"/v1/episodes/{response.json()['id']}").status_code == 204
                count += 1
            assert count == 12
            assert expect(back.http.get(f"/v1/evaluations/{evaluation}"), 200)["state"] == "finished"
            listed = expect(back.http.get(f"/v1/evaluations/{evaluation}/episodes"), 200)["episodes"]
            finished = [item["trial"] for item in listed if item["state"] == "finished"]
            assert len(set(finished)) == len(finished) == 12
            back.practise()
            simulators = again.simulators()
            # A clean stop says nothing and leaves no process, though an episode is open.
            assert simulators
            assert again.stop() == 0
        assert all(map(gone, simulators))
        assert "Traceback" not in again.stderr


def test_no_simulation_in_the_web_process(service: RunningService, agent: Agent) -> None:
    agent.practise()
    assert "libsumo" not in Path(f"/proc/{service.process.pid}/maps").read_text()
    assert any("libsumo" in Path(f"/proc/{pid}/maps").read_text() for pid in service.simulators())


@pytest.mark.parametrize(
    ("options", "setting", "said"),
    [
        (["--port", "{taken}"], "1", "--port {taken}: is in use"),
        (["--database", "foo"], "1", "'foo' is not a database URL; "),
        ([], "0", "WRONGTURN_MAX_PARALLEL: Input should be greater than or equal to 1"),
    ],
)
def test_a_start_that_cannot_be(options: list[str], setting: str, said: str) -> None:
    """It is told before anything is started."""
    app = typer.Typer()
    app.command()(serve)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        words = [word.format(taken=taken.getsockname()[1]) for word in (*options, said)]
        done = CliRunner().invoke(app, words[:-1], env={"WRONGTURN_MAX_PARALLEL": setting})
    assert done.exit_code == 2
    assert done.stderr.startswith(words[-1])
    assert "Traceback" not in done.stderr
