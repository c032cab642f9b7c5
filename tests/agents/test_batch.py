"""Batches without a service: the same file in one piece or many, after kills, and as over the service."""

import csv
import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from wrongturn_agents.batch.group import Group, drive_group
from wrongturn_agents.errors import AgentsError
from wrongturn_agents.practice import PracticeRun
from wrongturn_agents.registry import resolve
from wrongturn_agents.results_file import ResultsFile, read_runs, text_of
from wrongturn_agents.suites import SuiteTrials, installed_suite
from wrongturn_client import LocalService
from wrongturn_client.cli import app
from wrongturn_protocol.installing import install

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
WRONGTURN = str(Path(sys.executable).with_name("wrongturn"))
AGENTS = '''
import os, pathlib, signal, time
import numpy as np

class Single:
    name, track, memoryless = "brakes", "state", True

    def reset(self, space):
        pass

    def act(self, observation):
        return 0.1, 0.0, float(observation["speed"][0] > 1)

class Batched(Single):
    def act_batch(self, observations):
        assert observations["speed"].shape[1:] == (1,)
        with pathlib.Path("sizes").open("a") as file:
            file.write(f"{len(observations['speed'])} ")
        return np.array([self.act({"speed": speed}) for speed in observations["speed"]])

class Short(Batched):
    def act_batch(self, observations):
        return []

class Kills(Single):
    """At its fifth episode it kills its worker or the whole run, as the file says, once its first group is kept."""
    begun = 0

    def reset(self, space):
        self.begun += 1
        kill, out = pathlib.Path("kill"), pathlib.Path("out.json")
        if self.begun == 1:
            self.had = out.read_text().count("verdict") if out.exists() else 0
        if self.begun == 5 and kill.exists():
            while out.read_text().count("verdict") == self.had:
                time.sleep(0.01)
            whom = kill.read_text()
            kill.unlink()
            os.kill(os.getpid() if whom == "worker" else os.getppid(), 9)
            time.sleep(60)

class Fails(Single):
    def act(self, observation):
        raise ValueError("no idea")
'''


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with a module of agents."""
    (tmp_path / "batch_agents.py").write_text(AGENTS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("WRONGTURN_URL", raising=False)
    return tmp_path


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([WRONGTURN, *words], capture_output=True, text=True, check=False)


def batch(agent: str, file: str, *more: str) -> subprocess.CompletedProcess[str]:
    return run("run", f"batch_agents:{agent}", "--suite", "smoke@3", "--json", file, *(more or ("--workers", "1")))


@pytest.mark.soak
def test_an_array_of_slurm_makes_the_file_of_one_run(here: Path):
    options = ("--suite", "smoke@3", "--draws", "2", "--workers", "2", "--json", "whole.json")
    whole = run("run", "parked", "always-stops", *options)
    assert "0/12" in whole.stdout, whole.stderr  # the twins of both draws
    slurm = {"SLURM_ARRAY_TASK_COUNT": "3", "SLURM_CPUS_PER_TASK": "1", "SUITE": "smoke@3", "DRAWS": "2"}
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    script = (EXAMPLES / "wrongturn.sbatch").read_text().replace('"$agent"', "parked always-stops")
    for task in "123":
        env = {**os.environ, **slurm, "SLURM_ARRAY_TASK_ID": task, "PATH": path}
        subprocess.run(["bash"], input=script, text=True, env=env, check=True, capture_output=True)
    merged = run("results", "--merge", "piece-3.json", "piece-1.json", "piece-2.json", "--json", "merged.json")
    assert merged.returncode == 0, merged.stderr
    assert (here / "merged.json").read_bytes() == (here / "whole.json").read_bytes()
    assert run("results", "merged.json").stdout.partition("Practice on")[0] in whole.stdout
    rows = list(csv.DictReader(io.StringIO(run("results", "--csv", "-", "merged.json").stdout)))
    assert len({(row["agent"], row["secret"], row["trial"]) for row in rows}) == 48
    runs = read_runs(here / "whole.json")
    assert [one.agent for one in runs] == ["parked", "parked", "always-stops", "always-stops"]
    assert [one.secret for one in runs[:2]] == [one.secret for one in runs[2:]]
    assert len(runs[0].trials.keys() | runs[1].trials.keys()) == 24


@pytest.fixture(scope="module")
def single(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The file of an undisturbed run."""
    folder = tmp_path_factory.mktemp("single")
    (folder / "batch_agents.py").write_text(AGENTS)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.delenv("WRONGTURN_URL", raising=False)
        assert batch("Single", "single.json", "--workers", "2").returncode == 0
    return (folder / "single.json").read_bytes()


def test_what_is_killed_or_fails_goes_on_with_what_the_file_has(here: Path, single: bytes):
    (here / "kill").write_text("worker")
    died = batch("Kills", "out.json")
    assert "a worker was killed" in died.stderr
    assert "The same command goes on with what out.json has." in died.stderr
    kept = ResultsFile.read(here / "out.json").trials
    assert 0 < len(kept) < 12
    (here / "kill").write_text("run")
    assert batch("Kills", "out.json").returncode == -signal.SIGKILL
    assert kept.keys() < ResultsFile.read(here / "out.json").trials.keys()
    failed = batch("Fails", "out.json")
    assert "wrongturn: agent: brakes.act raised ValueError: no idea" in failed.stderr
    assert batch("Kills", "out.json").returncode == 0
    assert (here / "out.json").read_bytes() == single


def test_a_batch_gives_what_act_gives(here: Path, single: bytes):
    batched = batch("Batched", "batched.json")
    assert batched.returncode == 0, batched.stderr
    assert (here / "batched.json").read_bytes() == single
    assert max(map(int, (here / "sizes").read_text().split())) > 1
    assert "brakes.act_batch returned 0 actions for 3 observations" in batch("Short", "short.json").stderr


@pytest.mark.parametrize(
    ("agent", "suite", "crowded"),
    [
        ("ppo-segmentation", "smoke@3", False),
        pytest.param("lbc", "smoke@3", False, marks=pytest.mark.soak),
        ("careful", "navigation@1", True),
    ],
)
def test_verdicts_and_trajectories_are_those_of_the_service(service: LocalService, agent, suite, crowded):
    whole = installed_suite(suite)
    trials = [whole.trials[name] for name in whole.crowded] if crowded else [*whole.trials.values()]
    trials.sort(key=lambda trial: (0.0 if trial.journey is None else trial.journey.time_limit, trial.id))
    chosen = SuiteTrials(whole.id, whole.sha256, {one.id: one for one in trials[:2]}, whole.secret)
    driven = PracticeRun(resolve(agent), chosen, None, None).drive(service.url, None, lambda *_: None)
    assert all(one.trajectory_sha256 for one in driven.trials.values())
    assert drive_group(Group(0, agent, "", tuple(trials[:2]))) == driven.trials


CAREFUL = ("run", "careful", "--suite", "smoke@3")
ONE = (*CAREFUL, "--workers", "1")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((*ONE, "--shard", "0/3", "--json", "a.json"), "--shard: is '0/3'; give i/n with i from 1 to n"),
        ((*ONE, "--shard", "4/3", "--json", "a.json"), "--shard: is '4/3'"),
        ((*ONE, "--shard", "1/3"), "--shard: drives a piece; name its file with --json"),
        ((*ONE, "--shard", "1/3", "--json", "a.json", "--task", "straight"), "leave --task out"),
        ((*ONE, "--shard", "1/3", "--json", "a.json", "--url", "http://127.0.0.1:9"), "leave --url out, and unset"),
        ((*ONE, "--name", "me"), "leave --name out"),
        ((*ONE, "--parallel", "2"), "--parallel: is for episodes on a service"),
        ((*ONE, "--ray"), "leave one of them out"),
        ((*ONE, "careful"), "AGENT: two are called careful"),
        ((*CAREFUL, "--shard", "1/3"), "--shard: drives without a service; add --workers N, or --ray"),
        ((*CAREFUL, "--draws", "2"), "--draws: drives without a service"),
        ((*CAREFUL, "parked"), "AGENT: a service gets one agent in a run"),
        (("run", "--workers", "1"), "AGENT: name one or more"),
        ((*ONE, "--json", "half.json"), "--json: half.json is of another run"),
        (("results", "--merge", "half.json"), "--merge: writes the file of --json"),
        (("results", "--merge", "half.json", "half.json", "--json", "all.json"), "both have a; name each piece once"),
        (("results", "--merge", "half.json", "--json", "all.json"), "--merge: trials: 12 of 12 of parked are missing"),
        (("results", "--merge", "half.json", "other.json", "--json", "all.json"), "--merge: agent: is other in other"),
        (("results", "--merge", "half.json", "suite.json", "--json", "all.json"), "--merge: suite: is wrong-command@3"),
        (("results", "--merge", "half.json", "two.json", "--json", "all.json"), "two.json has 2 runs, and half.json"),
        (("results", "--merge", "--json", "all.json"), "--merge: there is no file"),
    ],
)
def test_what_does_not_fit_is_told(here: Path, words, says):
    suite = installed_suite("smoke@3")
    half = ResultsFile(
        agent="parked",
        suite=suite.id,
        suite_sha256=suite.sha256,
        secret=suite.secret,
        driven="in process",
        trials={"a": {"verdict": "timeout"}},
    )
    files = {"half": [half], "two": [half, half]}
    files |= {"other": [half.model_copy(update={"agent": "other"})]}
    files |= {"suite": [half.model_copy(update={"suite": "wrong-command@3"})]}
    for name, runs in files.items():
        (here / f"{name}.json").write_text(text_of(runs))
    done = CliRunner().invoke(app, [*words])
    assert isinstance(done.exception, AgentsError), done.output or repr(done.exception)
    assert says in str(done.exception)


@pytest.mark.parametrize(("option", "wanted"), [("--ray", "wrongturn-ray"), ("--workers=1", "wrongturn-service")])
def test_what_is_not_installed_is_named(here: Path, monkeypatch, option, wanted):
    for name in [name for name in sys.modules if name.startswith("wrongturn_agents.batch.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "wrongturn_sim.episode", None)
    done = CliRunner().invoke(app, [*CAREFUL, option])
    assert install(wanted) in str(done.exception)
