"""The worker against a real service, on the smallest suite."""

import contextlib
import dataclasses
import hashlib
import itertools
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import httpx
import pytest
import typer
from typer.testing import CliRunner

import wrongturn_sim  # noqa: F401 - sets where compiled kernels are kept, before the home is another
from wrongturn_agents import cli, register_cli, resolve
from wrongturn_agents.errors import AgentFailedError, AgentsError, RunError, RunFileError, RunOverError
from wrongturn_agents.practice import PracticeRun
from wrongturn_agents.results_file import ResultsFile
from wrongturn_agents.saved_run import SavedRun
from wrongturn_agents.suites import installed_suite
from wrongturn_agents.worker import GuardedAgent, begin, drive
from wrongturn_client import Client, NotFinishedError, NotFoundError, SecretFileError, settings
from wrongturn_networks import load_suite
from wrongturn_protocol import Action, AgentKind, EvaluationState, RunFile, Track, Verdict
from wrongturn_protocol.json_output import JsonFileError

SUITE = "smoke@3"
LEAVES = "own_agents:Leaves"
"""Leaves the road in a second, so that a whole run takes 93 steps."""
NUMBERS = itertools.count(1)
OPERATOR = "operator-token-of-the-tests-0123456789"
OWN = """
import sys
import threading
from pathlib import Path

from wrongturn_agents.baselines import Careful
from wrongturn_client import Action

class Fails(Careful):
    name = "fails"
    kind = "submitted"

    def act(self, observation):
        raise ValueError("no idea")

class Unmade(Careful):
    name = "unmade"

    def __init__(self):
        raise OSError("no weights")

class OddName(Careful):
    name = "odd/name"

class Blind(Careful):
    name = "blind"
    track = "state"

class Sees(Careful):
    name = "sees"
    track = "camera"

class Leaves(Careful):
    name = "leaves"

    def act(self, observation):
        return Action(steer=1.0, throttle=1.0, brake=0.0)

class Blocks(Careful):
    name = "blocks"
    episodes = 0

    def reset(self, observation_space):
        self.episodes += 1
        super().reset(observation_space)

    def act(self, observation):
        if self.episodes == 2 and Path("block").exists():
            print("blocked", file=sys.stderr, flush=True)
            threading.Event().wait()
        return super().act(observation)
"""


@pytest.fixture
def url(service) -> str:
    return service.url


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch) -> Path:
    for name in ("WRONGTURN_URL", "WRONGTURN_TOKEN", "WRONGTURN_OPERATOR_TOKEN", "WRONGTURN_OWNER_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "home"))
    (tmp_path / "own_agents.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "home"


def program(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "wrongturn_client", "run", *arguments]


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        program(*arguments), capture_output=True, text=True, timeout=600, env={**os.environ, **environment}, check=False
    )


def started(url: str, agent: str = "careful", suite: str = SUITE, **extra) -> SavedRun:
    extra.setdefault("name", f"{agent.replace(':', '-')} {next(NUMBERS)}")
    return begin(agent, suite, resolve(agent), url, **{"operator_token": OPERATOR, **extra})


def no_progress(finished: int, total: int) -> None: ...


def test_a_run_at_the_command_line(url, tmp_path):
    written = tmp_path / "careful.json"
    done = run("careful", "--suite", SUITE, "--url", url, "--name", "at the command line", "--json", str(written))
    assert done.returncode == 0, done.stderr
    assert "at the command line on smoke@3" in done.stderr
    assert "12 of 12 episodes" in done.stderr
    assert "infeasible" in done.stdout
    assert "0/6" in done.stdout
    assert re.search(
        r"Rank 1 of \d+ in the privileged track(, tied with .*)?; unsafe \d+ of \d+ \(strict\)", done.stdout
    )
    file = RunFile.read(written)
    assert (file.driver.name, file.driver.track) == ("at the command line", Track.PRIVILEGED)
    assert (file.metrics.unsafe.count, file.metrics.twins.completed) == (0, 6)
    assert file.secret is not None
    assert file.by_trial().keys() == {trial.id for trial in load_suite(SUITE).draw(file.secret).episodes}
    with Client(url, "") as client:
        told = {episode.id: episode for episode in client.finished_episodes(file.id)}
        assert client.run_file(file.id) == file
        client.save_run(file.id, tmp_path / "again.json.gz")
    assert RunFile.read(tmp_path / "again.json.gz") == file
    assert (tmp_path / "again.json.gz").stat().st_size < written.stat().st_size / 3
    for episode in file.episodes:
        kept = json.dumps(episode.trajectory, separators=(",", ":")).encode()
        assert hashlib.sha256(kept).hexdigest() == told[episode.id].trajectory_sha256


def test_a_run_that_is_not_finished_has_no_file(url):
    saved_run = started(url)
    with Client(url, saved_run.token) as client:
        with pytest.raises(NotFinishedError, match=rf"0 of 12 episodes.*wrongturn run --resume {saved_run.evaluation}"):
            client.run_file(saved_run.evaluation)
        episode = client.next_episode(saved_run.evaluation)
        client.step(episode.id, 1, Action(steer=0.0, throttle=0.0, brake=0.0))
        client.cancel_evaluation(saved_run.evaluation)
        file = client.run_file(saved_run.evaluation)
    assert len(file.episodes) == 12
    # What was never begun has an outcome, and no trajectory.
    assert {one.outcome.verdict for one in file.episodes} == {Verdict.ABORTED}
    assert sum(one.trajectory is None for one in file.episodes) == 11


@pytest.mark.parametrize("name", ["mine", None], ids=["given", "the agent's own"])
def test_a_name_that_is_taken_is_refused(url, name):
    # No other test here has this agent.
    started(url, "doubting", name=name)
    says = rf"--name: '{name or 'doubting'}' is taken at .*; choose another name.*WRONGTURN_TOKEN"
    with pytest.raises(RunError, match=says):
        started(url, "doubting", name=name)
    with Client(url) as client:
        assert not [agent.name for agent in client.agents(everybody=True) if agent.name.endswith("-2")]


def test_who_an_agent_is_follows_from_its_class_and_from_who_registers_it(url):
    source = resolve("parked")
    trained = dataclasses.replace(source, trained_on_faults=True)
    for name, made, token in (("as baseline", source, OPERATOR), ("as mine", source, None), ("as told", trained, None)):
        begin("parked", SUITE, made, url, operator_token=token, name=name)
    with Client(url) as client:
        found = {agent.name: (agent.kind, agent.trained_on_faults) for agent in client.agents(everybody=True)}
    assert found["as baseline"] == (AgentKind.BASELINE, False)
    assert (found["as mine"], found["as told"]) == ((AgentKind.SUBMITTED, False), (AgentKind.SUBMITTED, True))


def test_a_worker_drives_with_the_token_that_the_operator_put_there(url, tmp_path, monkeypatch):
    def register(*arguments: str):
        return CliRunner().invoke(command, [*arguments, "--url", url, "--tokens", str(tmp_path / "tokens")])

    command = typer.Typer()
    command.command()(register_cli.register)
    assert "WRONGTURN_OPERATOR_TOKEN: set it" in str(register("ignores-commands").exception)
    (tmp_path / "operator").write_text(OPERATOR + "\n")
    monkeypatch.setenv("WRONGTURN_OPERATOR_TOKEN_FILE", str(tmp_path / "operator"))
    assert "nobody, somebody: only shipped agents" in str(register("careful", "nobody", "somebody").exception)
    done = register("ignores-commands", "obeys-blindly")
    assert done.exit_code == 0, done.exception
    file = tmp_path / "tokens/ignores-commands/token"
    first = file.read_text().strip()
    assert file.stat().st_mode & 0o777 == 0o600
    assert "is registered already" in register("ignores-commands").output
    assert file.read_text().strip() == first
    file.unlink()
    assert "its token is not here" in str(register("ignores-commands").exception)
    assert register("ignores-commands", "--renew").exit_code == 0
    assert file.read_text().strip() != first

    monkeypatch.delenv("WRONGTURN_OPERATOR_TOKEN_FILE")
    done = run("ignores-commands", "--suite", SUITE, "--url", url, WRONGTURN_TOKEN_FILE=str(file))
    assert done.returncode == 0, done.stderr
    with Client(url) as client:
        (entry,) = [entry for entry in client.leaderboard(SUITE).entries if entry.agent.name == "ignores-commands"]
    assert entry.agent.kind is AgentKind.BASELINE


@pytest.mark.parametrize(("content", "says"), [(None, "cannot be read"), (b"\n", "is empty"), (b"\xff", "not UTF-8")])
def test_a_file_without_a_token(tmp_path, monkeypatch, content, says):
    file = tmp_path / "token"
    if content is not None:
        file.write_bytes(content)
    monkeypatch.setenv("WRONGTURN_TOKEN_FILE", str(file))
    with pytest.raises(SecretFileError, match=f"WRONGTURN_TOKEN_FILE: {file} .*{says}"):
        settings.token()
    monkeypatch.setenv("WRONGTURN_TOKEN", "given")
    assert settings.token() == "given"


NO_NAME = r"--name: '.*' cannot be a name; give at most 64 letters"


@pytest.mark.parametrize(
    ("agent", "given", "says"),
    [
        ("careful", {"suite": "nope@1"}, r"nope@1.*smoke@3"),
        ("careful", {"owner_token": "guess"}, r"WRONGTURN_OWNER_TOKEN: .* does not take it: nobody has this token"),
        ("own_agents:Blind", {}, r"is driven in the tracks .*, and blind wants state"),
        ("careful", {"name": " "}, NO_NAME),
        ("careful", {"name": "x" * 65}, NO_NAME),
        ("own_agents:OddName", {"name": None}, NO_NAME),
    ],
)
def test_what_a_service_does_not_take_registers_nobody_and_leaves_nothing(url, home, agent, given, says):
    with Client(url) as client:
        before = client.agents(everybody=True)
        with pytest.raises((RunError, NotFoundError), match=says):
            started(url, agent, **given)
        assert client.agents(everybody=True) == before
    assert not list(home.glob("runs/*"))


def test_an_interrupted_run_goes_on(url):
    saved_run = started(url, LEAVES)
    source = resolve(LEAVES)
    seen = []

    def interrupting(finished: int, total: int) -> None:
        seen.append(finished)
        if finished == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        drive(saved_run, source, url, interrupting)
    evaluation = drive(SavedRun.load(saved_run.evaluation), source, url, lambda finished, _: seen.append(finished))
    assert evaluation.state is EvaluationState.FINISHED
    assert seen[:4] == [0, 1, 2, 2]
    assert seen[-1] == 12


@pytest.mark.parametrize(
    ("path", "says"),
    [
        (
            "evaluations/{0.id}",
            "has no evaluation {0.id} any more: its owner or the operator has deleted it; it cannot",
        ),
        ("agents/{0.agent}/tokens", "does not take the token of evaluation {0.id} any more: its owner or the operator"),
    ],
)
def test_a_run_that_the_operator_ends_cannot_be_resumed(url, path, says):
    saved_run = started(url)
    with Client(url, saved_run.token) as client:
        evaluation = client.evaluation(saved_run.evaluation)

    def ending(finished: int, total: int) -> None:
        if finished == 1:
            headers = {"Authorization": f"Bearer {OPERATOR}"}
            httpx.delete(f"{url}/v1/admin/{path.format(evaluation)}", headers=headers, timeout=60).raise_for_status()

    with pytest.raises(RunOverError, match=re.escape(says.format(evaluation))):
        drive(saved_run, resolve("careful"), url, ending)
    done = run("--resume", saved_run.evaluation)
    assert done.returncode == 1
    assert "To go on with it" not in done.stderr
    assert says.format(evaluation) in done.stderr.rstrip().splitlines()[-1]


@pytest.mark.soak  # the shorter run does so on a shared service, below and above
def test_an_interrupted_run_on_its_own_service_goes_on(tmp_path, home):
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job of a shell would ignore Ctrl-C
    environment = {**os.environ, "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", ""), "WRONGTURN_SIMULATORS": "1"}
    # Settings for a service that stays. This one has its own.
    environment |= {"WRONGTURN_REGISTRATION": "operator", "WRONGTURN_DATABASE": "sqlite+aiosqlite:////nowhere/x.db"}
    (tmp_path / "block").touch()
    process = subprocess.Popen(
        program("own_agents:Blocks", "--suite", SUITE, "--progress", "json"),
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        env=environment,
    )
    with process, process.stderr:
        before = list(itertools.takewhile(lambda line: line != "blocked\n", process.stderr))
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
    (tmp_path / "block").unlink()
    assert '"finished": 1' in before[-1]
    assert process.returncode == 130
    assert "Traceback" not in rest
    (kept,) = (home / "runs").glob("database-*")
    (tmp_path / "own_agents.py").write_text(OWN + "# better\n")

    command = [*shlex.split(rest.partition("To go on with it: ")[2]), "--json", "-"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    assert f"The agent's code has changed since this run began: {tmp_path / 'own_agents.py'}." in done.stderr
    assert "12 of 12 episodes" in done.stderr
    assert "infeasible" in done.stderr
    assert "Would be ranked on smoke@3 in the privileged track; unsafe 0 of 6 (strict)" in done.stderr
    run = RunFile.from_json(done.stdout.encode())
    assert run.driver.name == "blocks"
    reactions = {
        trial.id: run.by_trial()[trial.id].outcome.reaction for trial in load_suite(SUITE).draw(run.secret).trials
    }
    assert len(reactions) == 6
    assert None not in reactions.values()
    assert not kept.exists()
    assert not list((home / "runs").iterdir())


def test_an_agent_that_fails_is_told_from_the_service(url):
    with pytest.raises(AgentFailedError, match=r"agent: fails.act raised ValueError: no idea"):
        drive(started(url, "own_agents:Fails"), resolve("own_agents:Fails"), url, no_progress)
    done = run("own_agents:Fails", "--suite", SUITE, "--url", url)
    assert done.returncode == 1
    assert 'raise ValueError("no idea")' in done.stderr
    assert f"To go on with it: {sys.executable} -m wrongturn_client run --resume" in done.stderr
    assert done.stderr.rstrip().splitlines()[-1] == "wrongturn: agent: fails.act raised ValueError: no idea"


@pytest.mark.parametrize(
    ("act", "says"),
    [
        (lambda: (0.0, 0.4), r"mine.act returned no action .* shape \(2,\); give three"),
        (
            lambda: Action(steer=float("nan"), throttle=0.4, brake=0.0),
            r"mine.act made no action: action.steer is nan; give a number from -1 to 1",
        ),
        (
            lambda: Action.model_construct(steer=0.0, throttle=1.5, brake=0.0),
            r"mine.act returned no action that can be driven: action.throttle is 1.5; give a number",
        ),
    ],
)
def test_an_action_that_cannot_be_driven_is_told_in_one_line(act, says):
    with pytest.raises(AgentFailedError, match=says) as caught:
        GuardedAgent("mine", SimpleNamespace(act=lambda _: act())).act({})
    assert caught.value.__cause__ is None, "so the program prints no traceback"


def test_what_cannot_be_gone_on_with_registers_nobody(url, home):
    home.write_text("a file, where a directory should be")
    with pytest.raises(RunFileError, match="let WRONGTURN_HOME name a writable directory"):
        started(url, name="nowhere to note it")
    home.unlink()
    with pytest.raises(AgentFailedError, match="own_agents:Unmade raised OSError when it was made: no weights"):
        cli.run(["own_agents:Unmade"], suite=SUITE, url=url)
    with Client(url) as client:
        assert not {"nowhere to note it", "unmade"} & {agent.name for agent in client.agents(everybody=True)}


def test_a_token_of_another_track_is_refused(url):
    with Client(url) as client:
        registered = client.register("of another track", Track.PRIVILEGED)
    with pytest.raises(RunError, match=r"WRONGTURN_TOKEN: it is the token of of another track.*sees wants camera"):
        started(url, "own_agents:Sees", token=registered.token, operator_token=None)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"agents": ["nobody"]}, "there is no agent called 'nobody'; known are parked"),
        ({"agents": None}, "AGENT: name one"),
        ({"agents": ["careful"], "json_file": Path("no/such/x.json")}, "--json: no/such/x.json cannot be written"),
        ({"agents": ["careful"], "json_file": Path()}, "--json: . cannot be written"),
        (
            {"agents": ["careful"], "json_file": Path("/sys/x.json")},
            "--json: /sys/x.json cannot be written (Permission",
        ),
        ({"resume": "ev-none"}, "--resume: no run 'ev-none'"),
        (
            {"agents": ["careful"], "suite": "nope@1"},
            "suite: 'nope@1' is not known; there are: disturbed@1, navigation-unseen@1",
        ),
        ({"agents": ["careful"], "parallel": 2}, "--parallel: the agent may keep a memory between steps"),
        ({"agents": ["missing.zip"]}, "agent: missing.zip: there is no such file; name what model.save"),
        ({"practice": True}, "AGENT: name one"),
        (
            {"agents": ["careful"], "practice": True, "json_file": Path("no/x.json")},
            "--json: no/x.json cannot be written",
        ),
        (
            {"agents": ["careful"], "practice": True, "keep": True},
            "--keep: practice keeps nothing but the file of --json",
        ),
        ({"agents": ["careful"], "practice": True, "suite": "nope@1"}, "suite: 'nope@1' is not known"),
    ],
)
def test_mistakes_are_told_before_anything_starts(arguments, says, monkeypatch):
    monkeypatch.delenv("WRONGTURN_URL", raising=False)
    monkeypatch.setattr("wrongturn_agents.worker.LocalService", lambda **_: pytest.fail("a service was started"))
    with pytest.raises((AgentsError, JsonFileError)) as caught:
        cli.run(**arguments)
    assert says in str(caught.value)


def test_what_is_given_already_is_not_given_anew(url):
    saved_run = started(url)
    with pytest.raises(RunError, match=r"AGENT: that run is of careful, not of parked"):
        cli.run(["parked"], resume=saved_run.evaluation)
    with pytest.raises(RunError, match=r"--name: that run has its name already"):
        cli.run(name="another", resume=saved_run.evaluation)
    with pytest.raises(RunError, match=r"--suite: that run is on smoke@3 already; leave --suite out with --resume"):
        cli.run(suite="wrong-command@3", resume=saved_run.evaluation)
    with pytest.raises(RunError, match=f"--keep: {url} keeps its own database"):
        cli.run(["careful"], suite=SUITE, url=url, keep=True)


@pytest.fixture
def own_service(url, monkeypatch):
    """The shared service stands for those of the runs; returns the databases that they were started with."""
    databases = []

    @contextlib.contextmanager
    def started(given, operator_token, database=None):
        databases.append(Path(database.removeprefix("sqlite+aiosqlite:///")))
        databases[-1].touch()
        yield url, OPERATOR

    monkeypatch.setattr("wrongturn_agents.evaluation_run.service_at", started)
    return databases


def test_a_runs_own_database_is_thrown_away_unless_it_is_kept(own_service, home, tmp_path, capsys):
    with pytest.raises(RunError, match=NO_NAME):
        cli.run(["parked"], suite=SUITE, name="!")
    assert list((home / "runs").iterdir()) == [], "it did not begin"
    cli.run([LEAVES], suite=SUITE, name="thrown away")
    assert "Would not be ranked on smoke@3: Completed 0 of 6 twins" in capsys.readouterr().out
    assert list((home / "runs").iterdir()) == []
    cli.run([LEAVES], suite=SUITE, name="kept", keep=True)
    database = own_service[-1]
    assert f"serve --database sqlite+aiosqlite:///{database}" in capsys.readouterr().err
    # Kept for good: whoever resumes the run only writes its file.
    (saved,) = (home / "runs").glob("*.json")
    cli.run(resume=str(saved), json_file=tmp_path / "kept.json")
    assert own_service[-1] == database
    assert database.exists()
    assert RunFile.read(tmp_path / "kept.json").driver.name == "kept"
    database.unlink()
    with pytest.raises(RunFileError, match=r"the database of that run is gone \(.*\); drive the suite again"):
        cli.run(resume=str(saved))


def test_a_file_that_cannot_be_written_keeps_the_runs_own_database(own_service, tmp_path):
    (tmp_path / ".run.json.new").mkdir()  # stands for a full disk
    with pytest.raises(RunError, match=r"--json: run\.json cannot be written"):
        cli.run([LEAVES], suite=SUITE, name="nearly lost", json_file=Path("run.json"))
    assert own_service[-1].exists()
    (tmp_path / ".run.json.new").rmdir()
    (saved,) = (tmp_path / "home/runs").glob("*.json")
    cli.run(resume=str(saved), json_file=Path("run.json"))
    assert len(RunFile.read(Path("run.json")).episodes) == 12
    assert not own_service[-1].exists()


def test_a_suite_is_practised_without_a_score(url, capsys, monkeypatch):
    suite = installed_suite(SUITE)
    all_of_it = PracticeRun(resolve("parked"), suite, None, None)
    assert all_of_it.trials == tuple(trial.id for trial in load_suite(SUITE).episodes)
    few = dict(list(suite.trials.items())[:2])  # a trial and its twin stand for the suite
    monkeypatch.setattr(cli, "installed_suite", lambda _: dataclasses.replace(suite, trials=few))
    with Client(url) as client:
        before = client.leaderboard(SUITE).entries
        cli.run(["always-stops"], suite=SUITE, url=url, practice=True, json_file=Path("-"))
        assert client.leaderboard(SUITE).entries == before
    written = capsys.readouterr()
    results = ResultsFile.model_validate_json(written.out)
    assert results.trials.keys() == few.keys()
    assert {one.verdict for one in results.trials.values()} == {Verdict.STOPPED_BEFORE_JUNCTION}
    assert "always-stops on smoke@3: practice" in written.err
    assert "0/1 trials unsafe (strict); 0/1 twins done" in written.err
    assert "Practice on the open draw, which everybody knows. It is never scored." in written.err
