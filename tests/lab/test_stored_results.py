"""Results files: what fits, and what is refused by name."""

import json
from pathlib import Path

import onnx
import pytest
from made_results import keep, navigation, wrong_command

from lab.stored_results import Collection
from wrongturn_agents import records
from wrongturn_agents.algorithms import algorithm_results
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.stored_results import STORED
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_client.plugins import entry_points, load
from wrongturn_networks import load_suite
from wrongturn_protocol import PAPER, Flag, Track

ROOT = Path(__file__).parents[2]


def read(directory: Path) -> Collection:
    return Collection.read(directory)


def test_the_papers_figures_are_those_of_its_tables():
    assert [agent.unsafe for agent in PAPER] == [23, 13, 35, 16, 3]
    page = (ROOT / "docs" / "paper.md").read_text("utf-8")
    for agent in PAPER:
        success = " | ".join(f"{percent} %" for percent in agent.success)
        assert f"| {agent.title} | {success} |" in page
        row = " | ".join(map(str, agent.infeasible))
        assert f"| infeasible | {row} | **{agent.unsafe}** |" in page
        omission = " | ".join(map(str, agent.omission))
        assert f"| | omission | {omission} | | |" in page


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"suite_sha256": "0" * 64},
            r"image.*suite_sha256: the results are of another wrong-command@3 \(000000000000\)",
        ),
        ({"suite": "no-such@1"}, "no-such@1"),
        ({"agent": "ppo/image"}, "agent: "),
        ({"seed": -1}, "seed: "),
        ({"driven": "by hand"}, "driven: "),
        ({"secret": None}, "image.*secret: is missing"),
        ({"driven": "over the service"}, "image.*commitment: is missing"),
        ({"commitment": "0" * 64}, "image.*commitment: is 000000000000…, and the secret's SHA-256 is "),
        ({"secret": "another"}, "image.*trials: lacks 120 of wrong-command@3's 120"),
        ({"colour": "red"}, "colour: "),
    ],
)
def test_a_file_that_does_not_fit_is_refused_by_name(tmp_path, change, says):
    path = wrong_command("ppo-image", (0,) * 6, seed=1).write(tmp_path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ResultsError, match=says) as caught:
        read(tmp_path)
    assert "\n" not in str(caught.value)


def test_trials_must_be_complete(tmp_path):
    path = wrong_command("ppo-image", (0,) * 6, seed=1).write(tmp_path)
    content = json.loads(path.read_text())
    gone = sorted(content["trials"])[0]
    content["trials"]["Town09.J1-S.none.s1"] = content["trials"].pop(gone)
    path.write_text(json.dumps(content))
    with pytest.raises(ResultsError, match=f"lacks 1 of wrong-command@3's 120 \\({gone}\\)"):
        read(tmp_path)
    content["trials"][gone] = {"verdict": "exit_route"}
    path.write_text(json.dumps(content))
    with pytest.raises(ResultsError, match=r"has 1 that wrong-command@3 does not have .*Town09"):
        read(tmp_path)


def test_trials_with_other_road_users_are_left_out_in_process_or_not_at_all(tmp_path):
    file = navigation("ppo-image", {}, seed=1, traffic=False)
    assert len(read(keep(tmp_path, file)).files) == 1
    file.model_copy(update={"driven": "over the service"}).write(tmp_path)
    with pytest.raises(ResultsError, match="lacks 100 of navigation@1's 400"):
        read(tmp_path)


def test_the_same_results_twice_are_refused(tmp_path):
    path = wrong_command("ppo-image", (0,) * 6, seed=1).write(tmp_path)
    (tmp_path / "copy.json").write_text(path.read_text())
    with pytest.raises(ResultsError, match=r"ppo-image seed 1 on wrong-command@3 in process is already in copy.json"):
        read(tmp_path)


def test_the_seeds_called_shipped_are_those_of_the_weights():
    for agent, seed in Collection.read(STORED).shipped.items():
        model = onnx.load(SHIPPED_AGENTS[agent].file)
        assert {entry.key: entry.value for entry in model.metadata_props}["seed"] == str(seed), agent


def test_a_scored_file_is_shown_as_a_run_is(tmp_path):
    path = tmp_path / "scored.json"
    path.write_text(wrong_command("ppo-image", (1, 0, 0, 0, 0, 2), seed=3).model_dump_json())
    run = records.read(path)
    assert (run.agent, run.seed, run.suite, len(run.by_trial)) == ("ppo-image", 3, "wrong-command@3", 120)
    assert sum(drive.result.unsafe_strict for drive in run.trials) == 3


def test_what_is_kept_is_the_same_for_any_order_of_trials(tmp_path):
    file = wrong_command("ppo-image", (1, 0, 0, 0, 0, 0), seed=3)
    first = file.write(tmp_path).read_bytes()
    turned = file.model_copy(update={"trials": dict(reversed(file.trials.items()))})
    assert turned.write(tmp_path).read_bytes() == first


def test_two_agents_whose_files_would_have_one_name(tmp_path: Path):
    wrong_command("by hand", (0,) * 6).write(tmp_path)
    with pytest.raises(ResultsError, match=r"holds the results of 'by hand'.*choose another by --agent"):
        wrong_command("by-hand", (0,) * 6).write(tmp_path)
    assert wrong_command("by hand", (1,) * 6).write(tmp_path).name == "by-hand.wrong-command@3.in-process.json"


def test_each_algorithm_has_the_outcomes_of_its_seeds_on_the_open_draw(tmp_path):
    keep(
        tmp_path,
        wrong_command("ppo-image", (0, 0, 2, 0, 0, 0), seed=1, opposed=4),
        wrong_command("ppo-image", (0, 0, 5, 0, 0, 0), seed=3),
        wrong_command("ppo-image", (9,) * 6, seed=1, variant="without-augmentation"),
        wrong_command("ppo-image", (9,) * 6, seed=1, driven="over the service", secret="5ec2e7"),
        wrong_command("careful", (0,) * 6),
        navigation("ppo-image", {}, seed=1),
    )
    (row,) = algorithm_results(WRONG_COMMAND, tmp_path)
    suite = load_suite(WRONG_COMMAND)
    assert (row.name, row.track, row.suite, row.sha256) == ("ppo-image", Track.CAMERA, suite.id, suite.sha256)
    assert set(row.seeds) == {1, 3}
    for outcomes in row.seeds.values():
        assert set(outcomes) == {trial.id for trial in suite.open_draw.episodes}
    assert sum(Flag.OPPOSED_LANE in one.flags for one in row.seeds[1].values()) == 4
    assert [sum(one.verdict.unsafe for one in outcomes.values()) for outcomes in row.seeds.values()] == [2, 5]
    assert algorithm_results("navigation@1", tmp_path) == (), "a suite that lists its trials"
    assert load(entry_points("wrongturn.algorithms")["shipped"]) is algorithm_results
