"""Run files, from ``wrongturn run --json`` and from a service."""

import csv
import io
from pathlib import Path

import pytest
from typer.testing import CliRunner

import wrongturn_sim  # noqa: F401 - sets where compiled kernels are kept, before the home is another
from wrongturn_agents import figures
from wrongturn_agents.errors import ResultsError
from wrongturn_client import LocalService
from wrongturn_client.cli import app
from wrongturn_networks import load_suite
from wrongturn_protocol import Verdict
from wrongturn_protocol.junction_frame import rings


@pytest.mark.slow
def test_a_run_of_a_service_and_its_file_are_the_same(service: LocalService, tmp_path: Path, monkeypatch):
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path))
    monkeypatch.delenv("WRONGTURN_TOKEN", raising=False)
    told = tmp_path / "run.json.gz"
    command = ["run", "always-stops", "--suite", "smoke@2", "--url", service.url, "--json", str(told)]
    assert CliRunner().invoke(app, [*command, "--name", "by hand"]).exit_code == 0
    fetched = figures.fetch(service.url, "by hand", "smoke@2")
    run = figures.read(told)
    assert figures.csv_text([fetched]) == figures.csv_text([run])
    assert fetched.run is not None
    assert figures.fetch(service.url, fetched.run.id).agent == "by hand"
    with pytest.raises(ResultsError, match=r"nobody: .* no agent of this name .* on smoke@2, .*: .*by hand"):
        figures.fetch(service.url, "nobody", "smoke@2")
    ranking = CliRunner().invoke(app, ["leaderboard", "smoke@2", "--url", service.url, "--csv"]).stdout
    assert "by hand" in [row["agent"] for row in csv.DictReader(io.StringIO(ranking))]
    here, there = figures.installed_town("Town01"), figures.town_of(service.url)("Town01")
    roads = ([[ring.tolist() for ring in polygon] for polygon in rings(town.road)] for town in (here, there))
    assert next(roads) == next(roads)
    ways = ([(one.id, one.stop_line, one.heading) for one in town.approaches] for town in (here, there))
    assert next(ways) == next(ways)
    assert run.secret is not None
    assert run.by_trial.keys() == {trial.id for trial in load_suite("smoke@2").draw(run.secret).episodes}
    assert {one.result.verdict for one in run.by_trial.values()} == {Verdict.STOPPED_BEFORE_JUNCTION}
