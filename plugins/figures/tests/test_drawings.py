"""``wrongturn results --figures``."""

from pathlib import Path

import pytest
from driven_runs import driven_run
from made_results import navigation
from typer.testing import CliRunner

from wrongturn_agents.errors import ResultsError
from wrongturn_client.cli import app


@pytest.fixture(scope="module")
def run_file(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("runs") / "run.json"
    path.write_text(driven_run(lambda trial: {} if trial.is_twin else {"verdict": "off_road"}).model_dump_json())
    return path


def drawn(folder: Path, *arguments: object) -> str:
    done = CliRunner().invoke(app, ["results", "--figures", *map(str, (folder, *arguments))], catch_exceptions=False)
    assert (done.exit_code, done.stdout) == (0, "")
    return done.stderr


def test_one_command_makes_everything_for_a_paper(run_file: Path, tmp_path: Path):
    table, rows = tmp_path / "table.tex", tmp_path / "trials.csv"
    told = drawn(tmp_path / "new", "--latex", table, "--csv", rows, run_file, f"A_1={run_file}")
    both = [f"{figure}-{agent}" for figure in ("trajectories", "twins") for agent in ("A_1", "by-hand")]
    names = ["unsafe-rates", "pairs", "obedience-safety", *both]
    wanted = {f"{name}.{kind}" for name in names for kind in ("pdf", "png")}
    assert {path.name for path in (tmp_path / "new").iterdir()} == wanted
    assert str(tmp_path / "new" / "pairs.pdf") in told
    assert "by hand & infeasible & 1/1" in table.read_text()
    assert "A\\_1 & infeasible & 1/1" in table.read_text()
    assert len(rows.read_text().splitlines()) == 1 + 2 * 12


def test_stored_results_have_no_trajectories(tmp_path: Path):
    told = drawn(tmp_path / "new", "--format", "svg", "--width", "page", "careful")
    assert "careful: the stored results have no trajectories to draw" in told
    names = ["obedience-safety.svg", "pairs.svg", "unsafe-rates.svg"]
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == names


def test_requests_that_make_no_sense_are_told(run_file: Path, tmp_path: Path):
    journeys = tmp_path / "journeys.json"
    journeys.write_text(navigation("careful", {}).model_dump_json())
    for says, arguments in (
        ("careful: navigation@1 has no twins to compare with", (tmp_path / "new", journeys)),
        ("would be called by-hand", (tmp_path / "new", run_file, f"by-hand={run_file}")),
        ("cannot be made", (run_file, run_file)),
    ):
        with pytest.raises(ResultsError, match=says):
            drawn(*arguments)
