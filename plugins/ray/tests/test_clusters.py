"""Simulators and models on the nodes of a Ray cluster: hostile models are stopped, and only sandboxes run any.

``benchmarks/ray_kills.py`` kills them in earnest.
"""

import asyncio
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
import small_models
from app_harness import until
from corpus import CORPUS, Case
from ray_nodes import Nodes
from service_harness import OPERATOR, RunningService, await_that, expect, figure, running_service
from submission_owner import Owner
from test_submissions_real import SOME, outcome

from wrongturn_ray.programs import Programs, Resources
from wrongturn_ray.sandboxes import RaySandboxes
from wrongturn_ray.settings import RaySettings
from wrongturn_sandbox import SandboxUnavailableError, bubblewrap, gpu
from wrongturn_sandbox.session import providers
from wrongturn_service.settings import Settings

EPISODES = 12
OFTEN = "crash"
"""The upload of the corpus that every run of the tests has."""
TRACK = {"track": "camera", "traffic": {"vehicles": 3}}


class Mixed(Nodes):
    """A cluster whose second worker has no bubblewrap."""

    def _start(self, number: int) -> None:
        self.environment.pop("PATH", None)
        if number == 2:
            self.environment["PATH"] = str(Path(sys.executable).parent)
        super()._start(number)

    def programs(self, number: int, name: str) -> list[psutil.Process]:
        return self._named(number, name)

    def all_simulators(self) -> list[psutil.Process]:
        return [simulator for number in self.workers for simulator in self.simulators(number)]


@pytest.fixture(scope="module")
def nodes() -> Iterator[Mixed]:
    with pytest.MonkeyPatch.context() as patch, Mixed() as nodes:
        for name, value in nodes.environment.items():
            patch.setenv(name, value)
        yield nodes


@pytest.fixture(scope="module")
def on_ray(nodes: Mixed, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    database = tmp_path_factory.mktemp("ray") / "wrongturn.db"
    running = RunningService(database, simulators="ray:6", ray_address=nodes.address, ray_listen="127.0.0.1:0")
    assert running.ready, running.stderr
    await_that(lambda: figure(running, "wrongturn_ray_cores") == 2, "the cluster is not complete")
    yield running
    assert running.stop() == 0, running.stderr
    await_that(lambda: not nodes.all_simulators(), "simulators outlive their service")


@pytest.mark.soak
def test_drives_on_a_node_and_here_give_the_same_bytes_whatever_is_killed(
    nodes: Mixed, on_ray: RunningService, service: RunningService
) -> None:
    assert on_ray.simulators() == []
    assert figure(on_ray, "wrongturn_simulator_slots") == 6
    seen, trajectories = [], []
    for running in (service, on_ray):
        with running.agent("camera") as agent:
            episode = agent.practise(**TRACK)["id"]
            replies = [expect(agent.step(episode, seq), 200) for seq in range(1, 6)]
            if running is on_ray:
                (simulator,) = nodes.all_simulators()
                simulator.kill()
            replies.append(expect(agent.step(episode, 6), 200))
            if running is on_ray:
                (driver,) = nodes.children(running.process.pid)
                driver.kill()
                await_that(lambda: figure(on_ray, "wrongturn_ray_connections") == 2, "no driver came after")
            seen.append([*replies, agent.drive(episode, begin=7)])
            trajectories.append(agent.trajectory(episode))
    assert seen[0] == seen[1]
    assert trajectories[0] == trajectories[1]
    assert figure(on_ray, "wrongturn_replays_total") >= 1


@pytest.fixture(scope="module")
def serving(bubblewrap: None, nodes: Mixed, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    folder = tmp_path_factory.mktemp("ray")
    given: dict[str, object] = {"ray_address": nodes.address, "ray_listen": "127.0.0.1:0", "operator_token": OPERATOR}
    given |= {"simulators": 2, "submissions": 1, "registration_limit": 1000, "runners": "ray"}
    with running_service(folder / "w.db", **given) as running:
        await_that(lambda: figure(running, "wrongturn_ray_nodes") == 3, "the cluster is not complete")
        yield running
    await_that(lambda: not nodes.programs(1, "wrongturn_runner"), "runners outlive their service")


def test_a_node_without_a_sandbox_drives_nothing_and_the_service_says_so(serving: RunningService, owner: Owner) -> None:
    def told() -> str:
        return str(expect(owner.http.get("/health/ready"), 200)["submissions"])

    # The head has a sandbox too, but no processor for a runner.
    await_that(lambda: told().startswith("on: 2 of 3 nodes on Ray: bubblewrap"), told())
    await_that(lambda: "bubblewrap is missing" in told(), told())
    assert "a node drives no models" in serving.stderr
    assert figure(serving, "wrongturn_ray_nodes_with_sandbox") == 2


@pytest.mark.parametrize(
    "case", [pytest.param(case, id=case.name, marks=() if case.name == OFTEN else pytest.mark.soak) for case in CORPUS]
)
def test_hostile_uploads_fail_with_their_reasons(owner: Owner, tmp_path: Path, case: Case) -> None:
    reason = outcome(owner, case, tmp_path).lower()
    # On a busy machine, 5 s may be over before 2 GiB are taken.
    assert case.words.lower() in reason or (case.name not in SOME and "took longer" in reason)


@pytest.mark.soak
async def test_the_tests_of_the_sandbox_pass_on_a_node(nodes: Mixed) -> None:
    programs = Programs(RaySettings(ray_address=nodes.address, ray_listen="127.0.0.1:0"))
    sandboxes = RaySandboxes(programs, Settings(runners="ray"))
    programs.changed = sandboxes.wake
    await programs.open()
    await until(lambda: len(programs.nodes) == 3)
    sandboxes.open("")
    await until(lambda: sandboxes.complete)
    good = [node.id for node in programs.nodes if node.id in sandboxes.nodes and node.cores]
    tests = str(Path(__file__).parents[3] / "tests/sandbox")
    command = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not soak", "--rootdir", tests, tests)
    async with programs.starting(command, asyncio.Protocol, Resources(cores=0.2), nodes=good) as (program, _):
        end = await program.ended
    await sandboxes.close()
    await programs.close()
    assert len(good) == 1
    assert end.status == 0, end.words
    assert "skipped" not in end.words


def test_a_runner_that_is_killed_is_replaced_and_each_trial_is_driven_once(nodes: Mixed, owner: Owner) -> None:
    submission = owner.hand_in(small_models.steady())
    await_that(lambda: owner.get(submission).get("finished", 0) >= 2, "it does not drive")
    assert nodes.programs(2, "wrongturn_runner") == []
    killed = nodes.programs(1, "wrongturn_runner")
    assert nodes.kill_one(killed)
    found = owner.until(submission, "finished")
    episodes = expect(owner.http.get(f"/v1/evaluations/{found['evaluation']}/episodes"), 200)["episodes"]
    trials = [episode["trial"] for episode in episodes if episode["state"] == "finished"]
    assert len(trials) == len(set(trials)) == EPISODES
    assert any("A runner was lost: the runner on Ray" in line for line in owner.log(submission))
    await_that(lambda: not nodes.programs(1, "wrongturn_runner"), "a runner is left")


def test_a_gpu_is_asked_for_and_never_there_by_default(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert providers(gpu=False) == ["CPUExecutionProvider"]
    assert providers(gpu=True)[0] == "CUDAExecutionProvider"
    plain = bubblewrap.command([])
    assert not any("nvidia" in word or "--dev-bind" in word for word in plain)
    with pytest.raises(SandboxUnavailableError, match=r"no .*/nvidia"):
        gpu.devices(tmp_path)
    monkeypatch.setattr(bubblewrap, "devices", lambda: [Path("/dev/nvidia0")])
    monkeypatch.setattr(bubblewrap, "driver_libraries", lambda: [Path("/x/libcuda.so.1")])
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3")
    line = " ".join(bubblewrap.command([], gpu=True))
    for part in ("--dev-bind /dev/nvidia0", "/x/libcuda.so.1 /libraries/libcuda.so.1", "CUDA_VISIBLE_DEVICES 3"):
        assert part in line
    with pytest.raises(ValueError, match="needs runners on Ray"):
        Settings(runner_gpus=0.5)
    assert os.environ.get("WRONGTURN_RUNNER_GPUS") is None
