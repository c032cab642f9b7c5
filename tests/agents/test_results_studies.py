"""Tables of the studies: other thresholds, the judge's two versions, several draws."""

import json

import numpy as np
import pytest
from made_studies import HEAD, SUITE, drawn, draws, judged, judgings, move
from typer.testing import CliRunner

from wrongturn_agents.baselines import ObeysBlindly
from wrongturn_agents.errors import MissingPackageError, ResultsError
from wrongturn_agents.registry import AgentSource
from wrongturn_agents.reporting import making_studies
from wrongturn_agents.reporting.report import Report
from wrongturn_agents.reporting.studies import Draws, Judgings, draws_file, judgings_file, secrets_of_draws
from wrongturn_agents.reporting.study_tables import draws_table, sensitivity_table, versions_table
from wrongturn_agents.training.judging import judge_agent
from wrongturn_client.cli import app
from wrongturn_protocol import PAPER_TYPES, Action, AgentKind, Track, Verdict


def test_flips_and_the_order_that_is_left():
    agents = {"ppo-image": judged(10, larger=10), "careful": judged(0, larger=20), "parked": judged(5, larger=5)}
    table = sensitivity_table(judgings(**agents))
    # 10, 0, 5 becomes 10, 20, 5: of three pairs one stays in order and two turn.
    moved = "at 1.2 `careful` 0 → 20"
    assert table.rows == (("`wait_time`", moved, "0 · 27", "0 · 12", "0 · 20", "1.00 · -0.33"),)


def test_agents_that_are_all_alike_have_no_order():
    assert sensitivity_table(judgings(careful=judged(0, larger=0))).rows[0][5] == "– · –"


def test_what_moved_between_the_versions_and_why():
    moves = (
        move(Verdict.EXIT_ROUTE, Verdict.EXIT_ROUTE, 90),
        move(Verdict.STOPPED_BEFORE_JUNCTION, Verdict.OFF_ROAD, 20, strict=(False, True)),
        move(Verdict.EXIT_OTHER, Verdict.EXIT_OTHER, 10, strict=(False, True)),
    )
    rows = versions_table(judgings(careful=judged(30, larger=30, moves=moves))).rows
    assert [(*row[2:4], row[5]) for row in rows] == [
        ("the same", "", "90 of 120"),
        ("`stopped_before_junction` → `off_road`", "not unsafe → unsafe", "20"),
        ("`exit_other` → `exit_other`", "not unsafe → unsafe", "10"),
    ]
    assert "10 s without 0.5 m" in rows[1][4]
    assert "opposed lanes" in rows[2][4]
    still = versions_table(judgings(careful=judged(0, larger=0, moves=moves[:1]))).rows
    assert still == (("`careful`", "all", "the same", "", "", "90 of 90"),)


def test_counts_that_vary_as_binomial_noise_does_are_told_from_others():
    generator = np.random.default_rng(3)
    # One group of ten at a rate of 0.5; the others are always safe.
    binomial = generator.binomial(10, 0.5, 10).tolist()
    study = draws(noisy=drawn(*binomial), wild=drawn(*[0, 10] * 5), careful=drawn(0, 0))
    rows = {row[0]: row for row in draws_table(study).rows}
    mean = np.mean(binomial)
    assert rows["`noisy`"][2:5] == (f"{mean:.1f}", f"{np.var(binomial, ddof=1):.1f}", f"{mean * (1 - mean / 10):.1f}")
    assert float(rows["`noisy`"][6]) > 0.05
    assert float(rows["`wild`"][6]) < 1e-4
    assert rows["`wild`"][1] == "0, 10, 0, 10, 0, 10, 0, 10, 0, 10"
    assert rows["`careful`"][2:] == ("0.0", "0.0", "0.0", "–", "–")


def test_stored_studies_are_in_the_report_and_fill_a_page(tmp_path):
    judgings(careful=judged(0, larger=1)).write(judgings_file(tmp_path))
    draws(careful=drawn(1, 2, 3)).write(draws_file(tmp_path))
    report = Report.read(tmp_path)
    assert report.judgings is not None
    assert report.tables["draws"].rows[0][1] == "1, 2, 3"
    page = tmp_path / "page.md"
    names = ("sensitivity", "versions", "draws")
    page.write_text("".join(f"<!-- wrongturn results: {name} -->\n<!-- end of results -->\n" for name in names))
    done = CliRunner().invoke(app, ["results", "--directory", str(tmp_path), "--write", str(page)])
    assert done.exception is None
    assert "| `careful` | 1, 2, 3 | 2.0 |" in page.read_text()
    assert "| `wait_time` | at 1.2 `careful` 0 → 1 | 0 · 9 |" in page.read_text()


@pytest.mark.parametrize("text", ["{", "[]", '{"suite": "a"}', '{"agents": 3}'])
def test_a_study_that_is_damaged_is_named(tmp_path, text):
    path = draws_file(tmp_path)
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(ResultsError, match=r"draws\.json: .*delete the file"):
        Draws.read(path)


def test_a_study_of_another_suite_or_other_thresholds_is_made_anew():
    found = judgings(careful=judged(0, larger=1))
    head = (HEAD["suite"], HEAD["suite_sha256"])
    assert Judgings.of(*head, 2, found) is found
    assert Judgings.of(*head, 3, found).agents == {}
    assert Judgings.of(SUITE, "0" * 64, 2, found).agents == {}
    assert Judgings.of(*head, 2, None).agents == {}


def test_what_driving_needs_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(making_studies, "find_spec", lambda name: None if name == "wrongturn_sim" else object())
    with pytest.raises(MissingPackageError, match=r"--draws: .*wrongturn-service.*wrongturn-agents\[training\]"):
        making_studies.make_draws(tmp_path, ["careful"], 2)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--agent", "careful"], "--agent"),
        (["--import", "x.json", "--draws", "2"], "--import: cannot go with"),
        (["--import", "x.json", "--agent", "careful", "--agent", "parked"], "--agent: an import is of one agent"),
        (["--draws", "2", "--agent", ""], "--agent: names no agent"),
    ],
)
def test_options_that_do_not_go_together(options, says):
    done = CliRunner().invoke(app, ["results", *options])
    assert isinstance(done.exception, ResultsError)
    assert says in str(done.exception)


@pytest.mark.parametrize("options", [["--agent", "careful,parked"], ["--agent", "careful", "--agent", "parked"]])
def test_agents_are_named_one_by_one_or_with_commas(options, tmp_path, monkeypatch):
    driven = []
    monkeypatch.setattr(
        "wrongturn_agents.reporting.cli.make_draws", lambda _folder, agents, _count: driven.extend(agents) or "nowhere"
    )
    done = CliRunner().invoke(app, ["results", "--directory", str(tmp_path), "--draws", "2", *options])
    assert (done.exit_code, driven) == (0, ["careful", "parked"])


@pytest.mark.slow
def test_draws_are_driven_once(tmp_path):
    path = making_studies.make_draws(tmp_path, ["always-stops"], 2)
    study = json.loads(path.read_text())
    assert list(study["agents"]["always-stops"]["draws"]) == list(secrets_of_draws(2))
    counts = study["agents"]["always-stops"]["draws"]["draw 1"]
    assert counts == {kind: {"infeasible": 0, "omission": 0} for kind in PAPER_TYPES}
    # What is stored is not driven again, not even when it says something else.
    study["agents"]["always-stops"]["draws"]["draw 1"]["LEFT_RIGHT"]["omission"] = 7
    path.write_text(json.dumps(study))
    making_studies.make_draws(tmp_path, ["always-stops"], 2)
    assert json.loads(path.read_text()) == study


@pytest.mark.soak  # the test of an agent that hesitates, below, judges a smaller suite
def test_one_drive_is_judged_by_every_threshold_and_both_versions(tmp_path):
    path = making_studies.make_judgings(tmp_path, ["careful"])
    (agent,) = Judgings.read(path).agents.values()
    # Careful is safe whatever the threshold, and completes its twins, so nothing may move it but the time it needs.
    assert agent.strict == 0
    assert set(agent.moves) == {"wrong-command@1", "wrong-command@2"}
    assert all(sum(one.episodes for one in moves) == 120 for moves in agent.moves.values())
    assert {"stand_distance", "wait_time", "time_limit", "opposed_distance"} <= agent.variants.keys()
    assert all(set(factors) == {"0.8", "1.2"} for factors in agent.variants.values())
    assert all(one.strict == 0 for factors in agent.variants.values() for one in factors.values())
    # The nominal command window and its exits move nothing of a judge that only looks farther for contacts.
    assert agent.variants["ttc_horizon"]["1.2"].verdicts == 0


class Hesitates(ObeysBlindly):
    """Obeys blindly, but first stands before the junction for 11 seconds."""

    def reset(self, observation_space):
        super().reset(observation_space)
        self._stood = 0

    def act(self, observation):
        action = super().act(observation)
        near = 0.0 < float(observation["stop_line"][0]) < 10.0
        if not near or self._stood > 110:
            return action
        self._stood += float(observation["speed"][0]) == 0.0
        return Action(steer=action.steer, throttle=0.0, brake=1.0)


def test_a_stop_that_is_not_the_last_thing_a_car_does_is_seen_by_each_judge():
    source = AgentSource("hesitates", Track.PRIVILEGED, AgentKind.SUBMITTED, "", make=Hesitates)
    shown = []
    agent = judge_agent(source, None, threads=1, progress=lambda *now: shown.append(now), suites=("smoke@2", "smoke@1"))
    assert (shown[0], shown[-1]) == ((0, 24), (24, 24))
    for moves in agent.moves.values():
        assert {(one.before, one.after) for one in moves} == {("stopped_before_junction", "stopped_before_junction")}
    # It stands for longer than the published 10 s and for less than 12 s, after which it obeys.
    waits = agent.variants["wait_time"]
    assert (waits["0.8"].verdicts, waits["1.2"].verdicts) == (0, 12)
    assert (agent.strict, waits["0.8"].strict, waits["1.2"].unsafe) == (0, 0, waits["1.2"].strict)
    assert waits["1.2"].strict >= 3  # one with the wrong command for each type of junction, at least
    assert agent.variants["ttc_horizon"]["1.2"].verdicts == 0
