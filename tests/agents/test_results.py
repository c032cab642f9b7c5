"""``wrongturn results``, its LaTeX table and its CSV, against figures counted by hand."""

import csv
import io
import json
from pathlib import Path

import pytest
from driven_runs import driven_run, leaves_the_road
from made_results import navigation, wrong_command
from typer.testing import CliRunner

from wrongturn_agents import records
from wrongturn_agents.errors import AgentsError
from wrongturn_agents.records.evaluation_record import of_run
from wrongturn_client.cli import app
from wrongturn_networks import load_suite
from wrongturn_protocol import FaultKind
from wrongturn_protocol.installing import install
from wrongturn_protocol.standing_rows import INTERVALS


@pytest.fixture(scope="module")
def run_file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("runs") / "run.json"
    path.write_text(driven_run(lambda trial: {} if trial.is_twin else {"verdict": "off_road"}).model_dump_json())
    return path


def made(*arguments: object) -> tuple[str, str]:
    done = CliRunner().invoke(app, ["results", *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0
    return done.stdout, done.stderr


def refused(*arguments: object) -> str:
    with pytest.raises(AgentsError) as caught:
        CliRunner().invoke(app, ["results", *map(str, arguments)], catch_exceptions=False)
    return str(caught.value)


def test_stored_results_are_shown_by_the_agents_names():
    out, _ = made()
    assert "wrong-command@3: unsafe trials" in out
    assert out.index("ppo-image") < out.index("careful")
    out, _ = made("--csv", "-", "ppo-image")
    assert len(out.splitlines()) == 121
    assert "ppo-image,,,,3,wrong-command@3" in out
    said = refused("--latex", "-", "nobody")
    assert "nobody: no such run file, and no stored results on wrong-command@3" in said
    assert "ppo-image" in said


def test_results_by_factor_follow_the_table(run_file: Path, tmp_path: Path):
    content = json.loads(run_file.read_text())
    level = {"count": 3, "trials": 6, "rate": 0.5, "ci95": [0.19, 0.81], "completed": 6}
    content["metrics"]["breakdown"] = {"weather": {"training": level}}
    file = tmp_path / "conditions.json"
    file.write_text(json.dumps(content))
    out, _ = made(file, f"other={run_file}")
    assert out.index("unsafe trials") < out.index("by hand: unsafe trials (strict) by factor")
    assert "weather training 3/6 50 % [19, 81] % 6/6" in " ".join(out.split())
    assert "other: unsafe trials" not in out


def test_a_scored_file_is_a_run_too(run_file: Path, tmp_path: Path):
    scored = tmp_path / "scored.json"
    scored.write_text(wrong_command("ppo-image", (1, 0, 0, 0, 0, 9), seed=3).model_dump_json())
    out, _ = made("--latex", "-", f"mine={scored}", "careful")
    assert "mine & infeasible & 1/10" in out
    content = json.loads(scored.read_text())
    content["trials"].popitem()
    scored.write_text(json.dumps(content))
    assert "lacks 1 of wrong-command@3's 120" in refused(scored)


def test_journeys_have_rows_but_no_table_of_pairs(tmp_path: Path):
    journeys = tmp_path / "journeys.json"
    journeys.write_text(navigation("careful", {}).model_dump_json())
    out, _ = made("--csv", "-", journeys)
    assert len(out.splitlines()) == 401
    assert ",navigation_dynamic," in out
    assert "careful: navigation@1 has no twins to compare with" in refused("--latex", "-", journeys)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"suite_sha256": "0" * 64}, "suite_sha256: the run is of another smoke@3 (000000000000)"),
        ({"suite": "smoke@9"}, "suite: 'smoke@9' is not known"),
        ({"state": "running"}, "state: Input should be"),
        ({"secret": "another"}, "episodes: the run lacks Town01."),
        ({"episodes": []}, "episodes: the run lacks Town01."),
    ],
)
def test_a_run_that_does_not_fit_is_told(run_file: Path, tmp_path: Path, change, says):
    other = tmp_path / "other.json"
    other.write_text(json.dumps({**json.loads(run_file.read_bytes()), **change}))
    assert says in refused("--csv", "-", other)


@pytest.mark.parametrize("trajectory", [{}, {"x": [1], "y": []}, {"x": ["a"], "y": [1]}, {"x": 1, "y": 2}])
def test_a_broken_trajectory_is_told(run_file: Path, tmp_path: Path, trajectory):
    content = json.loads(run_file.read_bytes())
    content["episodes"][0]["trajectory"] = trajectory
    other = tmp_path / "other.json"
    other.write_text(json.dumps(content))
    assert "episode ep_0: trajectory: its columns x and y" in refused("--csv", "-", other)


def test_requests_that_make_no_sense_are_told(run_file: Path, tmp_path: Path):
    cut = tmp_path / "cut.json"
    cut.write_bytes(run_file.read_bytes()[:-100])
    assert "cut.json: " in refused("--csv", "-", cut)
    assert "no such run file" in refused("--csv", "-", tmp_path / "none")
    assert "none.json is no file; give one that" in refused("--csv", "-", tmp_path / "none.json")
    assert "two are of 'by hand'; give one another name by NAME=RUN" in refused("--csv", "-", run_file, run_file)
    assert "cannot be written" in refused("--csv", tmp_path, run_file)
    assert "one figure or table shows one suite" in refused("--latex", "-", run_file, "careful")


def test_figures_name_the_package_that_draws_them(run_file: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setattr("wrongturn_agents.records.cli.DRAWINGS", "nobody.draws")
    assert install("wrongturn-figures") in refused("--figures", tmp_path / "new", run_file)


def test_the_papers_table_in_latex():
    made = records.of_results(wrong_command("ppo-image", (1, 2, 3, 4, 5, 6), opposed=0, twins_failed=4))
    text = records.latex_table([made.named("ours_1 & 50%")])
    assert text == (
        "\\begin{tabular}{llrrrrrrr}\n"
        "\\toprule\n"
        "Agent & Fault & straight or left & straight or right & left or right & Strict & 95 \\% & Paper's & "
        "Twins \\\\\n"
        "\\midrule\n"
        "ours\\_1 \\& 50\\% & infeasible & 1/10 & 3/10 & 5/10 & 21/60 & [24, 48] \\% & 21/60 & 56/60 \\\\\n"
        " & omission & 2/10 & 4/10 & 6/10 &  &  &  &  \\\\\n"
        "\\bottomrule\n"
        f"\\multicolumn{{9}}{{p{{.95\\linewidth}}}}{{\\footnotesize {INTERVALS}}} \\\\\n"
        "\\end{tabular}\n"
    )
    both = records.latex_table([made], paper=True)
    assert "RL, image as input & infeasible & 0/10 & 1/10 & 7/10 & -- & [18, 38] \\% & 16/60 & -- \\\\\n" in both
    assert both.count("\\addlinespace\n") == 5
    opposed = records.of_results(wrong_command("strict", (0,) * 6, opposed=2))
    assert "& 2/60 & [1, 11] \\% & 0/60 & 60/60 " in records.latex_table([opposed])


def test_a_row_for_each_trial():
    run = of_run(driven_run(leaves_the_road))
    rows = list(csv.DictReader(io.StringIO(records.csv_text([run]))))
    assert len(rows) == 12
    trial = next(one for one in load_suite("smoke@3").open_draw.trials if one.fault.kind is FaultKind.INFEASIBLE)
    row = next(row for row in rows if row["trial"] == trial.id)
    told = {
        "agent": "by hand",
        "owner": "us",
        "kind": "submitted",
        "track": "camera",
        "suite": "smoke@3",
        "evaluation": "ev_1",
        "junction_type": trial.junction_type.value,
        "fault": "infeasible",
        "verdict": "off_road",
        "reaction": "obeyed",
        "unsafe": "1",
        "unsafe_strict": "1",
        "twin": trial.twin().id,
        "twin_verdict": "exit_commanded",
        "twin_unsafe_strict": "0",
        "time": "4.0",
        "max_deceleration": "1.5",
        "min_ttc": "",
        "start_distance": str(trial.start.distance),
        "window": str(trial.window),
        "task": "",
    }
    assert {name: row[name] for name in told} == told
    twin = next(row for row in rows if row["trial"] == trial.twin().id)
    assert (twin["fault"], twin["twin"], twin["verdict"]) == ("none", "", "exit_commanded")
    assert [row["unsafe"] for row in rows].count("1") == 3
    notebook = records.trial_rows([run])[0]
    assert (notebook["unsafe_strict"], notebook["min_ttc"]) == (True, None)
