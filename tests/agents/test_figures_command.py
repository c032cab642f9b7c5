"""``wrongturn results --figures``, ``--latex`` and ``--csv``."""

import json
from pathlib import Path

import pytest
from driven_runs import driven_run
from made_results import navigation, wrong_command
from typer.testing import CliRunner

from wrongturn_agents.errors import AgentsError
from wrongturn_client.cli import app


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


def test_one_command_makes_everything_for_a_paper(run_file: Path, tmp_path: Path):
    table, rows = tmp_path / "table.tex", tmp_path / "trials.csv"
    out, told = made("--figures", tmp_path / "new", "--latex", table, "--csv", rows, run_file, f"A_1={run_file}")
    both = [f"{figure}-{agent}" for figure in ("trajectories", "twins") for agent in ("A_1", "by-hand")]
    names = ["unsafe-rates", "pairs", "obedience-safety", *both]
    wanted = {f"{name}.{kind}" for name in names for kind in ("pdf", "png")}
    assert {path.name for path in (tmp_path / "new").iterdir()} == wanted
    assert out == ""
    assert str(tmp_path / "new" / "pairs.pdf") in told
    assert "by hand & infeasible & 1/1" in table.read_text()
    assert "A\\_1 & infeasible & 1/1" in table.read_text()
    assert len(rows.read_text().splitlines()) == 1 + 2 * 12


def test_stored_results_are_shown_by_the_agents_names(tmp_path: Path):
    out, _ = made()
    assert "wrong-command@3: unsafe episodes" in out
    assert out.index("ppo-image") < out.index("careful")
    out, _ = made("--csv", "-", "ppo-image")
    assert len(out.splitlines()) == 121
    assert "ppo-image,,,,2,wrong-command@3" in out
    _, told = made("--figures", tmp_path / "new", "--format", "svg", "--width", "page", "careful")
    assert "careful: the stored results have no trajectories to draw" in told
    drawn = ["obedience-safety.svg", "pairs.svg", "unsafe-rates.svg"]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == drawn
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
    assert out.index("unsafe episodes") < out.index("by hand: unsafe trials (strict) by factor")
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


def test_journeys_have_rows_but_no_figures_of_pairs(tmp_path: Path):
    journeys = tmp_path / "journeys.json"
    journeys.write_text(navigation("careful", {}).model_dump_json())
    out, _ = made("--csv", "-", journeys)
    assert len(out.splitlines()) == 401
    assert ",navigation_dynamic," in out
    for option in (("--latex", "-"), ("--figures", tmp_path / "new")):
        assert "careful: navigation@1 has no twins to compare with" in refused(*option, journeys)


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
    assert "would be called by-hand" in refused("--figures", tmp_path / "a", run_file, f"by-hand={run_file}")
    assert "cannot be written" in refused("--csv", tmp_path, run_file)
    assert "cannot be made" in refused("--figures", run_file, run_file)
    assert "one figure or table shows one suite" in refused("--latex", "-", run_file, "careful")
