import csv
import io
import json
from pathlib import Path

import pytest
from made_results import made_run, wrong_command
from typer.testing import CliRunner

import wrongturn_sim  # noqa: F401 - sets where compiled kernels are kept, before the home is another
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.reporting import figures
from wrongturn_agents.reporting.collection import STORED, Collection
from wrongturn_agents.reporting.importing import Overrides, import_results, results_of_run
from wrongturn_agents.reporting.junction_frame import Frame, rings
from wrongturn_client import LocalService
from wrongturn_client.cli import app
from wrongturn_networks import load_suite
from wrongturn_networks.draws import commitment_of
from wrongturn_protocol import DrivenEpisode, JourneyOutcome, Outcome, Verdict


def episode(trial: str, **outcome: object) -> DrivenEpisode:
    found = {"verdict": Verdict.ARRIVED, "time": 1.0, "max_deceleration": 0.0, **outcome}
    return DrivenEpisode(id="e1", trial=trial, outcome=Outcome.model_validate(found))


def test_a_scored_file_is_kept_under_its_own_name(tmp_path):
    scored = tmp_path / "scored.json"
    scored.write_text(wrong_command("ppo-image", (1, 0, 0, 0, 0, 0), seed=3).model_dump_json())
    directory = tmp_path / "stored"
    directory.mkdir()
    kept = import_results(scored, directory, Overrides())
    assert kept.name == "ppo-image.s3.wrong-command@2.in-process.json"
    variant = import_results(scored, directory, Overrides(seed=4, variant="masked-classes", steps=7))
    assert variant.name == "ppo-image.masked-classes.s4.wrong-command@2.in-process.json"
    files = Collection.read(directory).files
    assert {(file.seed, file.variant, file.steps) for file in files} == {(3, None, None), (4, "masked-classes", 7)}


def test_what_is_kept_is_the_same_for_any_order_of_trials(tmp_path):
    file = wrong_command("ppo-image", (1, 0, 0, 0, 0, 0), seed=3)
    first = file.write(tmp_path).read_bytes()
    turned = file.model_copy(update={"trials": dict(reversed(file.trials.items()))})
    assert turned.write(tmp_path).read_bytes() == first


def test_an_incomplete_file_is_not_taken_in(tmp_path):
    content = json.loads(wrong_command("ppo-image", (0,) * 6, seed=3).model_dump_json())
    content["trials"].popitem()
    scored = tmp_path / "scored.json"
    scored.write_text(json.dumps(content))
    with pytest.raises(ResultsError, match="lacks 1"):
        import_results(scored, tmp_path, Overrides())
    assert list(tmp_path.glob("ppo-*")) == []


@pytest.mark.parametrize("text", ["{", "[]", '{"verdict": 1}'])
def test_something_else_is_refused(tmp_path, text):
    path = tmp_path / "thing.json"
    path.write_text(text)
    with pytest.raises(ResultsError, match="--import: "):
        import_results(path, tmp_path, Overrides())


@pytest.mark.parametrize(
    ("named", "says"),
    [
        ("missing.json", r"--import: there is no file \S+missing\.json; give a file of"),
        ("thing.json/below", r"--import: \S+below cannot be read \(Not a directory\); give a file of"),
        (
            "folder",
            r"--import: \S+folder is a directory without progress\.csv, so it is not a training run's; give a file of",
        ),
        ("thing.json", r"--import: \S+thing\.json cannot be read as JSON"),
    ],
)
def test_what_cannot_be_read_is_told_as_what_it_is(tmp_path, named, says):
    (tmp_path / "thing.json").write_text("{")
    (tmp_path / "folder").mkdir()
    with pytest.raises(ResultsError, match=says):
        import_results(tmp_path / named, tmp_path, Overrides())


def test_episodes_of_an_evaluation_become_results():
    clean = {"distance": 9.0, "completion": 1.0, "junctions": 1, "off_road": 0, "wrong_lane": 0, "collisions": 0}
    bitten = JourneyOutcome.model_validate({**clean, "off_road": 1})
    episodes = (
        episode("a", journey=JourneyOutcome.model_validate(clean)),
        episode("b", journey=bitten),
        episode("c", verdict=Verdict.OFF_ROAD, reaction="obeyed", flags=("opposed_lane",)),
    )
    run = made_run("5ec2e7", episodes)
    file = results_of_run(run)
    assert (file.agent, file.driven, file.seed) == ("by hand", "over the service", None)
    assert (file.secret, file.commitment) == ("5ec2e7", run.commitment)
    assert file.suite_sha256 == load_suite("wrong-command@2").sha256
    assert [name for name, one in file.trials.items() if one.flags] == ["c"]
    found = {name: (one.verdict, one.reaction, one.clean) for name, one in file.trials.items()}
    assert found == {"a": ("arrived", None, True), "b": ("arrived", None, False), "c": ("off_road", "obeyed", None)}
    assert results_of_run(run, "careful").agent == "careful"
    with pytest.raises(ResultsError, match=r"suite_sha256: the run is of another wrong-command@2 \(000000000000\)"):
        results_of_run(run.model_copy(update={"suite_sha256": "0" * 64}))


def test_a_run_file_of_before_it_held_episodes_says_how_to_write_it_again(tmp_path: Path):
    told = tmp_path / "run.json"
    told.write_text(json.dumps({"id": "gone", "suite": "wrong-command@2", "state": "finished", "trials": 120}))
    with pytest.raises(ResultsError, match=r"run\.json: .*'wrongturn run --resume ID --json FILE'"):
        import_results(told, tmp_path, Overrides())


def test_an_import_says_what_it_replaces_and_which_agent_may_be_meant(tmp_path: Path):
    scored, directory = tmp_path / "scored.json", tmp_path / "stored"
    scored.write_text(wrong_command("ppo-image", (0,) * 6, seed=3).model_dump_json())
    directory.mkdir()

    def told(*options: str) -> str:
        command = ["results", "--import", str(scored), "--directory", str(directory), *options]
        done = CliRunner().invoke(app, command)
        assert done.exit_code == 0, done.output
        return done.stderr

    assert "in place of" not in told()
    assert "in place of the file that was there" in told()
    assert told("--agent", "ppo-imag").strip().endswith("in-process.json. Did you mean ppo-image?")
    assert "Did you mean" not in told("--agent", "my own")


def test_an_evaluation_that_is_stored_is_no_import(tmp_path: Path):
    stored = sorted((STORED / "studies" / "evaluations").glob("*.json"))[0]
    with pytest.raises(ResultsError, match="is a stored evaluation of --evaluations; there is nothing to import"):
        import_results(stored, tmp_path, Overrides())


def test_a_seed_that_no_training_takes(tmp_path: Path):
    scored = tmp_path / "scored.json"
    scored.write_text(wrong_command("ppo-image", (0,) * 6, seed=3).model_dump_json())
    with pytest.raises(ResultsError, match="--seed: 4294967296 is not valid"):
        import_results(scored, tmp_path, Overrides(seed=2**32))


def test_two_agents_whose_files_would_have_one_name(tmp_path: Path):
    wrong_command("by hand", (0,) * 6).write(tmp_path)
    with pytest.raises(ResultsError, match=r"holds the results of 'by hand'.*choose another by --agent"):
        wrong_command("by-hand", (0,) * 6).write(tmp_path)
    assert wrong_command("by hand", (1,) * 6).write(tmp_path).name == "by-hand.wrong-command@2.in-process.json"


@pytest.mark.slow
def test_a_run_over_a_service_is_kept_trial_by_trial(tmp_path: Path, monkeypatch):
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path))
    monkeypatch.delenv("WRONGTURN_TOKEN", raising=False)
    told = tmp_path / "run.json.gz"
    with LocalService(database=f"sqlite+aiosqlite:///{tmp_path / 'own.db'}") as service:
        command = ["run", "always-stops", "--suite", "smoke@2", "--url", service.url, "--json", str(told)]
        assert CliRunner().invoke(app, [*command, "--name", "by hand"]).exit_code == 0
        # The file of the run itself, which knows the agent's token, will do as well.
        (run,) = (tmp_path / "runs").glob("*.json")
        text = import_results(run, tmp_path, Overrides()).read_text()
        fetched = figures.fetch(service.url, "by hand", "smoke@2")
        assert figures.csv_text([fetched]) == figures.csv_text([figures.read(told)])
        assert fetched.run is not None
        assert figures.fetch(service.url, fetched.run.id).agent == "by hand"
        with pytest.raises(ResultsError, match=r"nobody: .* no agent of this name .* on smoke@2, .*: by hand"):
            figures.fetch(service.url, "nobody", "smoke@2")
        ranking = CliRunner().invoke(app, ["leaderboard", "smoke@2", "--url", service.url, "--csv"]).stdout
        assert [row["agent"] for row in csv.DictReader(io.StringIO(ranking))] == ["by hand"]
        here, there = figures.installed_town("Town01"), figures.town_of(service.url)("Town01")
        assert rings(here.road) == rings(there.road)
        assert [Frame.of(one) for one in here.approaches] == [Frame.of(one) for one in there.approaches]
    # The service is gone: the run file holds everything.
    kept = import_results(told, tmp_path, Overrides())
    assert kept.read_text() == text
    assert kept.name == "by-hand.smoke@2.over-the-service.json"
    kept.rename(tmp_path / "kept.json")
    told.unlink()
    (file,) = Collection.read(tmp_path).files
    assert file.secret is not None
    assert file.trials.keys() == {trial.id for trial in load_suite("smoke@2").draw(file.secret).episodes}
    assert file.commitment == commitment_of(file.secret)
    assert {one.verdict for one in file.trials.values()} == {Verdict.STOPPED_BEFORE_JUNCTION}
