"""One task of a suite, driven in practice; a run of a service and its file."""

import csv
import io
import json
from pathlib import Path

import pytest
from made_results import keep, navigation
from typer.testing import CliRunner

import wrongturn_sim  # noqa: F401 - sets where compiled kernels are kept, before the home is another
from lab.stored_results import Collection
from wrongturn_agents import records
from wrongturn_agents.errors import AgentsError, RunError
from wrongturn_agents.practice import PracticeRun
from wrongturn_agents.registry import resolve
from wrongturn_agents.results_file import ResultsFile
from wrongturn_agents.suites import SuiteTrials, installed_suite
from wrongturn_client import LocalService
from wrongturn_client.cli import app
from wrongturn_networks import load_suite
from wrongturn_protocol import Condition, Task, Verdict
from wrongturn_protocol.run_file import GZIP


def of_task(file: ResultsFile, task: Task) -> ResultsFile:
    trials = {name: one for name, one in file.trials.items() if f".{task.value}." in name}
    return file.model_copy(update={"trials": trials})


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--json", "{}/a.json", "--name", "me"], "--name"),
        (["--json", "{}/a.json", "--resume", "run"], "--resume"),
        (["--json", "{}/a.json", "--suite", "wrong-command@3"], "it has none"),
        (["--json", "{}/a.json", "--suite", "none@1"], "suite"),
        (["--json", "{}/other.json"], "another run"),
        (["--json", "{}/text.json"], "--json: text.json: the file: Invalid JSON"),
        (["--json", "{}/text.json"], "; name a new file, or the file of the run to resume"),
    ],
)
def test_what_cannot_be_driven_is_told(tmp_path, arguments, named):
    (tmp_path / "text.json").write_text("no results")
    (tmp_path / "other.json").write_text(navigation("careful", {}, driven="over the service").text())
    command = ["run", "parked", "--task", "straight", *(word.format(tmp_path) for word in arguments)]
    done = CliRunner().invoke(app, command)
    assert isinstance(done.exception, AgentsError), done.output or repr(done.exception)
    assert named in str(done.exception)


def test_a_task_that_is_not_there_is_told_with_those_that_are(tmp_path):
    with pytest.raises(RunError, match="navigation_dynamic"):
        PracticeRun(resolve("parked"), installed_suite("navigation@1"), "cruise", tmp_path / "a.json")


def test_a_compressed_file_is_read_again(tmp_path: Path):
    file = tmp_path / "a.json.gz"
    for _ in range(2):
        PracticeRun(resolve("parked"), installed_suite("navigation@1"), "straight", file)._write()
    assert file.read_bytes().startswith(GZIP)
    assert ResultsFile.read(file).trials == {}


def test_results_among_other_road_users_join_those_in_process(tmp_path: Path):
    dynamic = (Task.NAVIGATION_DYNAMIC, Condition.TRAINING)
    whole = navigation("ppo-image", {dynamic: 20}, seed=1, driven="over the service")
    alone = navigation("ppo-image", {}, seed=1, driven="in process", traffic=False)
    keep(tmp_path, alone, of_task(whole, Task.NAVIGATION_DYNAMIC), shipped={"ppo-image": 1})
    collection = Collection.read(tmp_path)
    shipped = collection.of_shipped("navigation@1", "ppo-image")
    assert shipped is not None
    assert len(shipped.trials) == len(collection.by_seed("navigation@1", "ppo-image")[1].trials) == 400


def test_trials_are_driven_and_gone_on_with(service: LocalService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("WRONGTURN_TOKEN", "of another service")
    whole = installed_suite("navigation@1")
    limits = {name: trial.journey.time_limit for name, trial in whole.trials.items() if trial.journey is not None}
    # Who is parked drives to the end of the time, so the shortest will do.
    names = sorted((name for name in limits if ".straight." in name), key=limits.__getitem__)[:3]
    file, told = tmp_path / "straight.json", []

    def run(*chosen: str) -> ResultsFile:
        suite = SuiteTrials(whole.id, whole.sha256, {name: whole.trials[name] for name in chosen})
        driven = PracticeRun(resolve("parked"), suite, "straight", file)
        return driven.drive(service.url, None, lambda *numbers: told.append(numbers), parallel=1)

    run(names[0])
    results = run(*names)
    assert told == [(0, 1), (1, 1), (1, 3), (2, 3), (3, 3)]
    assert set(results.trials) == set(names)
    assert {one.verdict for one in results.trials.values()} == {Verdict.TIMEOUT}
    assert json.loads(file.read_text())["driven"] == "over the service"


def test_a_run_of_a_service_and_its_file_are_the_same(service: LocalService, tmp_path: Path, monkeypatch):
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path))
    monkeypatch.delenv("WRONGTURN_TOKEN", raising=False)
    told = tmp_path / "run.json.gz"
    command = ["run", "always-stops", "--suite", "smoke@3", "--url", service.url, "--json", str(told)]
    assert CliRunner().invoke(app, [*command, "--name", "by hand"]).exit_code == 0
    fetched = records.fetch(service.url, "by hand", "smoke@3")
    run = records.read(told)
    assert records.csv_text([fetched]) == records.csv_text([run])
    assert fetched.run is not None
    assert records.fetch(service.url, fetched.run.id).agent == "by hand"
    with pytest.raises(AgentsError, match=r"nobody: .* no agent of this name .* on smoke@3, .*: .*by hand"):
        records.fetch(service.url, "nobody", "smoke@3")
    ranking = CliRunner().invoke(app, ["leaderboard", "smoke@3", "--url", service.url, "--csv"]).stdout
    assert "by hand" in [row["agent"] for row in csv.DictReader(io.StringIO(ranking))]
    assert run.secret is not None
    assert run.by_trial.keys() == {trial.id for trial in load_suite("smoke@3").draw(run.secret).episodes}
    assert {one.result.verdict for one in run.by_trial.values()} == {Verdict.STOPPED_BEFORE_JUNCTION}
