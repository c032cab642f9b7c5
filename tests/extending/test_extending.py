"""A package of each kind, made from the text of docs/extending.md, adds what the page says and harms nothing else."""

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
from app_harness import application, play
from fake_pool import FakePool
from service_harness import expect
from stored_evaluation import outcome, store_evaluation
from typer.testing import CliRunner

from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.method import find_method, load, method_names
from wrongturn_agents.training.progress import read_rows
from wrongturn_client.cli import app
from wrongturn_judge import compute
from wrongturn_networks import catalogue, draw_trial, load_suite, load_town, suite_ids, suites, town_names
from wrongturn_protocol import Command, FaultKind, Outcome, PracticeRequest, Reaction, RunFile, Track, Verdict
from wrongturn_service.catalogue import practice_trial, town_detail
from wrongturn_service.episodes.draws import Draws
from wrongturn_service.errors import InvalidRequestError
from wrongturn_service.web import words
from wrongturn_sim import Episode, FaultNotApplicableError, WrongturnSimEnv, WrongturnVectorEnv, available_faults

Install = Callable[..., Path]
SHORT = {"num_envs": 4, "decisions": 5, "traffic": 0, "journeys": 1, "brief_journeys": 1, "patience": 1}


def wrongturn(*words: object) -> str:
    """Return what the program prints."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == 0, done.output or done.exception
    return done.stdout


def test_a_method_is_trained_resumed_and_exported(install_page: Install) -> None:
    folder = install_page("A training method")
    assert "hill-climbing" in method_names()
    run, exported = folder / "run", folder / "hill.onnx"
    given = ["--directory", run, "--threads", 1, "--device", "cpu"]
    options = [word for name, value in SHORT.items() for word in ("--option", f"{name}={value}")]
    wrongturn("train", "hill-climbing", *given, "--steps", 60, "--option", "evaluate_every=1000", *options)
    wrongturn("train", "hill-climbing", *given, "--steps", 100, "--resume")
    wrongturn("export", run / "best.pt", exported)
    assert [int(row["step"]) for row in read_rows(run / "progress.csv")] == [20, 40, 60, 60, 80, 100, 100]
    found = load(run / "best.pt")
    assert (found.agent.name, found.agent.track, found.settings.decisions) == ("hill-climbing", "privileged", 5)
    assert found.told["evaluation"]["journeys"] == 1
    assert exported.stat().st_size > 0
    with pytest.raises(TrainingError, match=r"ALGORITHM: broken of their_methods \(gone:THING\) cannot be loaded"):
        find_method("broken")


def practise(approach: str, fault: FaultKind) -> None:
    wanted = PracticeRequest(town="junctions", approach=approach, fault=fault)
    asyncio.run(practice_trial(wanted, Draws(Path("unused"))))


def test_a_fault_is_delivered_judged_counted_and_explained(install_page: Install) -> None:
    install_page("A fault")
    fault = FaultKind.CUSTOM
    assert fault in available_faults()
    trial = draw_trial(load_town("junctions"), "J1-S", fault, 1)
    episode, swapped = Episode(trial, Track.STATE), {1: 2, 2: 1}
    episode.reset()
    while episode.outcome is None:
        episode.step(0.0, 0.4, 0.0)
    commands = [(row.command, row.route_command) for row in episode.trajectory.rows]
    assert all(command == swapped.get(route, route) for command, route in commands)
    assert {route for _, route in commands} == {int(Command.LANE_FOLLOW), int(trial.route)}
    for record in (True, False):  # a training records nothing
        batch = WrongturnVectorEnv(2, trial=trial, record=record)
        batch.reset(seed=1)
        for _ in episode.trajectory.rows[1::2]:
            *_, infos = batch.step(np.array([[0.0, 0.4, 0.0]] * 2, np.float32))
        assert infos["verdict"][1] == episode.outcome.verdict
        if record:
            assert batch.episode(1).trajectory.to_json() == episode.trajectory.to_json()
    assert episode.outcome.reaction is Reaction.OTHER

    twin = Outcome(verdict=Verdict.EXIT_COMMANDED, time=1.0, max_deceleration=0.0)
    suite: Any = SimpleNamespace(id="mine@1", trials=(trial,))
    metrics = compute(suite, {trial.id: episode.outcome, trial.twin().id: twin})
    assert metrics.reactions["custom"] == {Reaction.OBEYED: 0, Reaction.EXIT: 0, Reaction.OTHER: 1}
    assert metrics.compliance is not None
    assert (metrics.compliance.count, metrics.compliance.faults["custom"].trials) == (0, 1)
    assert metrics.table_strict is not None
    assert metrics.table_strict[trial.junction_type]["custom"].trials == 1
    assert words.fault("custom") == "The command says left for right, and right for left."
    assert words.told(trial).startswith("The command says left for right, and right for left. The route goes ")


def test_a_fault_is_asked_where_it_can_be_applied(install_page: Install) -> None:
    install_page("A fault")
    fault, town = FaultKind.CUSTOM, load_town("junctions")
    both = {one.id for one in town.approaches.values() if one.exits.keys() >= {Command.LEFT, Command.RIGHT}}
    assert {one.id for one in town_detail("junctions").approaches if fault in one.faults} == both
    practise("J1-S", fault)
    with pytest.raises(InvalidRequestError, match="custom needs a left and a right exit; take another approach"):
        practise("J1-W", fault)
    env = WrongturnSimEnv("junctions", fault=fault)
    assert {env.reset(seed=k)[1]["trial"].split(".")[1] for k in range(30)} == both
    with pytest.raises(FaultNotApplicableError, match="custom needs a left and a right exit"):
        WrongturnSimEnv("junctions", fault=fault, approach="J1-W")


WRONG_FAULTS = """
from wrongturn_networks.faults import CommandFault
from wrongturn_protocol import FaultKind


class Shared(CommandFault):
    guide_word = words = "shared"
    deliver = lambda self, t, guidance: guidance.command


class Taken(Shared):
    kind = FaultKind.OMISSION


class Silent(CommandFault):
    kind = FaultKind.LATE


class Named(Shared):
    kind = FaultKind.EARLY


class Strange(Named):
    reactions = ("fled",)
"""


def test_a_wrong_fault_is_left_out_and_named(
    install_page: Install, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "wrong_faults.py").write_text(WRONG_FAULTS)
    points = {"omission": "Taken", "late": "Silent", "tardy": "Named", "early": "Strange"}
    install_page("A fault", "".join(f"{kind} = wrong_faults:{name}\n" for kind, name in points.items()))
    assert available_faults() == tuple(FaultKind)
    findings = "\n".join(detail for what, passed, detail, _ in catalogue.checks() if what == "faults" and not passed)
    for wanted in (
        "omission of their_faults (wrong_faults:Taken) is left out: there is another omission; remove one",
        "late of their_faults (wrong_faults:Silent) is left out: has no guide_word and no words and no deliver",
        "tardy of their_faults (wrong_faults:Named) is left out: is of the kind early; an entry point has the name",
        "early of their_faults (wrong_faults:Strange) is left out: reactions: 'fled' is none of Reaction",
        "broken of their_faults (gone:THING) is left out: No module named 'gone'",
    ):
        assert wanted in findings
        assert wanted in caplog.text


def test_a_town_and_a_suite_are_found_by_all_that_take_a_name(
    install: Callable[[Path], None], town_and_suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(town_and_suite)
    assert town_names() == ("Town01", "Town02", "junctions", "village")
    assert "rainy@1" in suite_ids()
    assert "village" in wrongturn("towns")
    assert "rainy@1" in wrongturn("suites")
    assert len(json.loads(wrongturn("trials", "rainy@1", "--json"))["trials"]) == 4
    env = gymnasium.make("wrongturn_sim:WrongturnSim-v0", town="village", track="state")
    assert env.reset(seed=1)[1]["trial"].startswith("village.")
    assert WrongturnSimEnv(suite="rainy@1").reset(seed=1)[1]["trial"].startswith("village.")

    async def story() -> None:
        async with application(tmp_path, FakePool()) as http:
            for address, shown in (
                ("/v1/towns", "village"),
                ("/v1/towns/village", "J4-W"),
                ("/v1/suites", "rainy@1"),
                ("/v1/suites/rainy@1/trials", "village.J"),
                ("/v1/leaderboards", "rainy@1"),
                ("/towns/village", "rainy@1"),
                ("/suites/rainy@1", "No turn is announced, in sun and rain"),
                ("/leaderboards/rainy@1", "No turn is announced, in sun and rain"),
            ):
                assert shown in (await http.get(address)).text, address
            del http.headers["Authorization"]
            agent = expect(await http.post("/v1/agents", json={"name": "a driver", "track": "privileged"}), 201)["id"]
            await store_evaluation(http.app.state.service, agent, load_suite("rainy@1"))
            assert "rainy@1" in (await http.get(f"/agents/{agent}")).text
            monkeypatch.setitem(vars(suites.shelf()), "_others", {})  # uninstalled
            assert (await http.get(f"/agents/{agent}")).status_code == 200
            assert (await http.get("/leaderboards/rainy@1")).status_code == 404

    play(story)


@pytest.mark.soak
def test_processes_drive_a_suite_in_a_town_of_other_packages(town_and_suite: Path, tmp_path: Path) -> None:
    file = tmp_path / "run.json"
    command = [sys.executable, "-m", "wrongturn_client", "run", "careful", "--suite", "rainy@1", "--json", str(file)]
    subprocess.run(command, env={**os.environ, "PYTHONPATH": str(town_and_suite)}, cwd=tmp_path, check=True)
    run = RunFile.read(file)
    assert (run.suite, len(run.episodes)) == ("rainy@1", 8)
    assert run.metrics.twins.completed == 4


def test_what_is_broken_or_taken_is_left_out_and_named(
    install: Callable[[Path], None], town_and_suite: Path, caplog: pytest.LogCaptureFixture
) -> None:
    install(town_and_suite)
    broken = [detail for _, passed, detail, _ in catalogue.checks() if not passed]
    for detail, wanted in zip(
        broken,
        (
            "broken of their_suites (gone:THING) is left out: No module named 'gone'",
            "changed of their_suites (rainy_suite:CHANGED) is left out: suite changed@1: the file was changed, and ",
            "broken of their_towns (gone:THING) is left out: No module named 'gone'",
            "missing of their_towns (village_town:Path) is left out: expected str, bytes or os.PathLike object",
            "village of their_towns (village_town:VILLAGE) is left out: there is another village; give this one a name",
        ),
        strict=True,
    ):
        assert detail.startswith(wanted)
        assert detail in caplog.text
    assert load_suite("rainy@1").trials


def test_a_figure_is_shown_beside_the_shipped_one(install_page: Install) -> None:
    folder = install_page("A figure of a leaderboard's page")

    async def story() -> None:
        async with application(folder, FakePool()) as http:
            del http.headers["Authorization"]
            agent = expect(await http.post("/v1/agents", json={"name": "leaver", "track": "privileged"}), 201)["id"]
            board = "/leaderboards/smoke@3"
            assert "Aborted trials" not in (await http.get(board)).text
            service = http.app.state.service
            await store_evaluation(service, agent, load_suite("smoke@3"), lambda _: outcome(Verdict.ABORTED))
            page = (await http.get(board)).text
            assert '<h2 id="aborted-trials">Aborted trials</h2>' in page
            assert "<title>leaver</title>" in page
            assert '<h2 id="obedience-and-safety">Obedience and safety</h2>' in page
            assert "roken" not in page

    play(story)
