import json
from pathlib import Path

import onnx
import pytest
from made_results import keep, navigation, wrong_command
from typer.testing import CliRunner

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.reporting.collection import STORED, Collection
from wrongturn_agents.reporting.navigation import navigation_table, tasks_table
from wrongturn_agents.reporting.order import seeds_left_out, unsafe_by_seed
from wrongturn_agents.reporting.report import Report
from wrongturn_agents.reporting.wrong_command import endings_table, seeds_table, wrong_command_table
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_client.cli import app
from wrongturn_networks import load_suite
from wrongturn_protocol import PAPER, Condition, FaultKind, Reaction, Task

ROOT = Path(__file__).parents[2]
NAVIGATION_IN_NEW_TOWN = (Task.NAVIGATION, Condition.NEW_TOWN)


def read(directory: Path) -> Collection:
    return Collection.read(directory)


def rows_of(rows: tuple[tuple[str, ...], ...], agent: str) -> dict[str, tuple[str, ...]]:
    """An agent's rows by whose figures they are."""
    found: dict[str, tuple[str, ...]] = {}
    named = ""
    for row in rows:
        named = row[0] or named
        if named == agent:
            found[row[1]] = row[2:]
    return found


def run(*arguments: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["results", *arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.stdout, done.stderr


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


def test_a_shipped_seed_with_its_interval_and_all_seeds_with_their_range(tmp_path):
    files = [
        wrong_command("ppo-image", (0, 0, 3, 1, 10, 9), seed=1, twins_failed=2),
        wrong_command("ppo-image", (0, 0, 5, 1, 10, 4), seed=2, opposed=3),
        wrong_command("ppo-image", (0, 1, 1, 1, 8, 0), seed=4),
    ]
    table = wrong_command_table(read(keep(tmp_path, *files, shipped={"ppo-image": 2})))
    assert table.head[2:5] == ("STRAIGHT_LEFT", "STRAIGHT_RIGHT", "LEFT_RIGHT")
    rows = rows_of(table.rows, "`ppo-image`")
    assert rows["the paper"] == ("0 · 0", "1 · 4", "7 · 4", "", "16 (17–39 %)", "")
    # Three exits of seed 2 over an opposed lane are unsafe in the strict column alone. Wilson for 23 of 60: 27.1 to
    # 51.0 %; for 20 of 60: 22.7 to 45.9 %.
    (cells, totals) = rows["ours, seed 2"][:3], rows["ours, seed 2"][3:]
    assert sum(int(count) for cell in cells for count in cell.split(" · ")) == 23
    assert totals == ("23 (27–51 %)", "20 (23–46 %)", "60/60")
    assert rows["ours, 3 seeds"][3:] == ("23 [11–23]", "20 [11–23]", "60 [58–60]")
    paper = rows_of(wrong_command_table(read(tmp_path), strict=False).rows, "`ppo-image`")
    assert paper["ours, seed 2"] == ("0 · 0", "5 · 1", "10 · 4", "20 (23–46 %)", "60/60")
    assert paper["ours, 3 seeds"] == (
        "0 [0–0] · 0 [0–1]",
        "3 [1–5] · 1 [1–1]",
        "10 [8–10] · 4 [0–9]",
        "20 [11–23]",
        "60 [58–60]",
    )


def test_seeds_that_cannot_drive_are_told_apart(tmp_path):
    files = [
        wrong_command("ppo-image", (0, 0, 3, 1, 10, 9), seed=1, twins_failed=6),
        wrong_command("ppo-image", (0, 0, 0, 0, 0, 0), seed=2, twins_failed=7),
        wrong_command("ppo-image", (0, 0, 5, 1, 10, 9), seed=3),
    ]
    collection = read(keep(tmp_path, *files))
    rows = rows_of(wrong_command_table(collection).rows, "`ppo-image`")
    assert rows["ours, 3 seeds"][3:] == ("23 [0–25]", "23 [0–25]", "54 [53–60]")
    assert rows["the 2 that drive"][3:] == ("24 [23–25]", "24 [23–25]", "57 [54–60]")
    assert [row[-1] for row in seeds_table(collection).rows] == ["54", "53: cannot drive", "60"]
    assert unsafe_by_seed(collection)["ppo-image"] == (23, 25)
    assert "`ppo-image` seed 2 (53 of 60)" in seeds_left_out(collection)


def test_traffic_that_the_shipped_seed_has_not_met_is_missing(tmp_path):
    driven = {1: False, 2: True}
    files = [navigation("ppo-image", {}, seed=seed, traffic=traffic) for seed, traffic in driven.items()]
    for seed, traffic in driven.items():
        lines = Report(read(keep(tmp_path, *files, shipped={"ppo-image": seed})), ()).missing
        assert any("was not driven among the other road users of navigation@1" in line for line in lines) is not traffic


def test_what_was_driven_over_the_service_is_shown_for_the_shipped_seed(tmp_path):
    files = [
        wrong_command("ppo-image", (0, 0, 0, 0, 0, 5), seed=1),
        wrong_command("ppo-image", (0, 0, 0, 0, 0, 6), seed=1, driven="over the service", secret="5ec2e7"),
    ]
    collection = read(keep(tmp_path, *files, shipped={"ppo-image": 1}))
    rows = rows_of(wrong_command_table(collection).rows, "`ppo-image`")
    assert rows["ours, seed 1"][3:] == ("6 (5–20 %)", "6 (5–20 %)", "60/60")
    assert [row[5] for row in seeds_table(collection).rows] == ["5"]
    assert not list(collection.differences())  # two draws are two sets of trials


def test_the_same_trials_driven_both_ways_are_compared(tmp_path):
    driven = navigation("ppo-image", {}, seed=1)
    over = navigation("ppo-image", {NAVIGATION_IN_NEW_TOWN: 24}, seed=1, driven="over the service")
    collection = read(keep(tmp_path, driven, over))
    assert any("seed 1" in line and "1 of 400 verdicts differ" in line for line in collection.differences())


def test_a_baseline_has_no_seed_and_no_paper(tmp_path):
    file = wrong_command("careful", (0,) * 6, driven="over the service")
    rows = rows_of(wrong_command_table(read(keep(tmp_path, file))).rows, "`careful`")
    assert rows == {"ours": ("0 · 0", "0 · 0", "0 · 0", "0 (0–6 %)", "0 (0–6 %)", "60/60")}


def test_navigation_counts_arrivals_by_condition(tmp_path):
    files = [
        navigation("ppo-auxiliary", {NAVIGATION_IN_NEW_TOWN: 20}, seed=1, dirty=5),
        navigation("ppo-auxiliary", {NAVIGATION_IN_NEW_TOWN: 23}, seed=2, traffic=False),
    ]
    collection = read(keep(tmp_path, *files, shipped={"ppo-auxiliary": 1}))
    rows = rows_of(navigation_table(collection).rows, "`ppo-auxiliary`")
    assert rows["the paper"] == ("90", "92", "78", "68")
    assert rows["ours, seed 1"] == ("100 (87–100)", "100 (87–100)", "80 (61–91)", "100 (87–100)")
    assert rows["ours, 2 seeds"] == ("100 [100–100]", "100 [100–100]", "86 [80–92]", "100 [100–100]")
    # The one seed that drove among other road users is the shipped one: there is no range over seeds.
    tasks = tasks_table(collection).rows
    at = next(number for number, row in enumerate(tasks) if row[1] == "navigation with traffic")
    assert tasks[at][2] == "ours, seed 1"
    assert at == len(tasks) - 1
    clean = [row for row in tasks_table(collection, clean=True).rows if row[2] == "ours, seed 1"]
    assert all(row[3].startswith("80 ") for row in clean)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"suite_sha256": "0" * 64},
            r"image.*suite_sha256: the results are of another wrong-command@2 \(000000000000\)",
        ),
        ({"suite": "no-such@1"}, "no-such@1"),
        ({"agent": "ppo/image"}, "agent: "),
        ({"seed": -1}, "seed: "),
        ({"driven": "by hand"}, "driven: "),
        ({"secret": None}, "image.*secret: is missing"),
        ({"driven": "over the service"}, "image.*commitment: is missing"),
        ({"commitment": "0" * 64}, "image.*commitment: is 000000000000…, and the secret's SHA-256 is "),
        ({"secret": "another"}, "image.*trials: lacks 120 of wrong-command@2's 120"),
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
    with pytest.raises(ResultsError, match=f"lacks 1 of wrong-command@2's 120 \\({gone}\\)"):
        read(tmp_path)
    content["trials"][gone] = {"verdict": "exit_route"}
    path.write_text(json.dumps(content))
    with pytest.raises(ResultsError, match=r"has 1 that wrong-command@2 does not have .*Town09"):
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
    with pytest.raises(ResultsError, match=r"ppo-image seed 1 on wrong-command@2 in process is already in copy.json"):
        read(tmp_path)


def test_what_is_missing_is_said(tmp_path):
    status, out, err = run("--directory", str(tmp_path))
    assert status == 0
    assert "35 (46–70 %)" in out
    assert "no results on navigation@1: lbc, marln, ppo-segmentation, ppo-image, ppo-auxiliary" in err
    keep(tmp_path, wrong_command("ppo-image", (0,) * 6, seed=1), navigation("ppo-image", {}, seed=2))
    _, _, err = run("--directory", str(tmp_path))
    assert "ppo-image has no results on wrong-command@2 for seed 2" in err
    assert "shipped.json names no seed for ppo-image" in err
    with pytest.raises(ResultsError, match="is not a directory"):
        run("--directory", str(tmp_path / "none"))


def test_json_has_each_seed(tmp_path):
    keep(tmp_path, *(wrong_command("ppo-image", (0, 0, 0, 0, 0, seed), seed=seed) for seed in (1, 2)))
    _, out, _ = run("--directory", str(tmp_path), "--json")
    figures = json.loads(out)["wrong_command"]["ppo-image"]
    assert figures["paper"]["unsafe"] == 16
    assert [(one["seed"], one["unsafe"], one["twins_completed"]) for one in figures["seeds"]] == [
        (1, 1, 60),
        (2, 2, 60),
    ]
    assert figures["seeds"][1]["cells"]["LEFT_RIGHT.omission"] == 2


def test_variants_stand_beside_the_algorithm_in_the_ablations_alone(tmp_path):
    files = [
        wrong_command("ppo-image", (0, 0, 0, 0, 9, 9), seed=1),
        wrong_command("ppo-image", (0, 0, 0, 0, 1, 0), seed=1, variant="without-augmentation"),
        navigation("ppo-image", {NAVIGATION_IN_NEW_TOWN: 5}, seed=1, variant="without-augmentation"),
    ]
    page = tmp_path / "page.md"
    page.write_text("<!-- wrongturn results: ablations -->\n<!-- end of results -->\n")
    run("--directory", str(keep(tmp_path, *files)), "--write", str(page))
    text = page.read_text()
    assert "| `ppo-image` | standard | 1 | – | – | – | 18 (20–43 %) | 60 (94–100 %) |" in text
    assert "|  | without augmentation | 1 | 100 (87–100) | 20 (9–39) | 100 (87–100) | 1 (0–9 %) |" in text
    table = wrong_command_table(read(tmp_path))
    assert not any("augmentation" in cell for row in table.rows for cell in row)


def test_how_trials_ended(tmp_path):
    table = endings_table(read(keep(tmp_path, wrong_command("ppo-image", (0, 0, 0, 0, 9, 3), seed=1))))
    assert table.head[3:10] == (
        "collision", "off road", "stopped inside", "wrong way", "stopped before", "exit", "other end",
    )  # fmt: skip
    assert [row[1:10] for row in table.rows] == [
        ("wrong", "30", "30", "0", "0", "0", "0", "70", "0"),
        ("follow lane", "30", "10", "0", "0", "0", "0", "90", "0"),
    ]


def test_how_the_fault_was_met_and_by_whom(tmp_path):
    driven = wrong_command("ppo-image", (0,) * 6, seed=1)
    faults = {trial.id: trial.fault.kind for trial in load_suite("wrong-command@2").episodes}
    trials = {
        name: one.model_copy(update={"reaction": Reaction.OTHER}) if faults[name] is not FaultKind.NONE else one
        for name, one in driven.trials.items()
    }
    files = (driven.model_copy(update={"trials": trials}), wrong_command("parked", (0,) * 6, twins_failed=60))
    table = endings_table(read(keep(tmp_path, *files)))
    assert table.head[10:] == ("obeyed", "overrode", "froze", "other reaction")
    assert [(row[0], *row[10:]) for row in table.rows] == [
        ("`ppo-image`", "0", "0", "0", "100"),
        ("", "", "", "0", "100"),
        ("`parked`", "0", "0", "0", "0"),
        ("", "", "", "0", "0"),
    ]
    assert "For any other agent: all its trials." in table.note


def test_the_seeds_called_shipped_are_those_of_the_weights():
    for agent, seed in Collection.read(STORED).shipped.items():
        model = onnx.load(SHIPPED_AGENTS[agent].file)
        assert {entry.key: entry.value for entry in model.metadata_props}["seed"] == str(seed), agent


def test_results_of_version_1_stay_readable(tmp_path):
    suite = load_suite("wrong-command@1")
    content = {
        "agent": "ppo-image",
        "seed": 1,
        "suite": suite.id,
        "suite_sha256": suite.sha256,
        "driven": "in process",
        "trials": {trial.id: {"verdict": "exit_route", "reaction": "overrode"} for trial in suite.episodes},
    }
    (tmp_path / "old.json").write_text(json.dumps(content))
    collection = read(tmp_path)
    assert [str(file) for file in collection.files] == ["ppo-image seed 1 on wrong-command@1 in process"]
    assert [row[1] for row in wrong_command_table(collection).rows if row[0] == "`ppo-image`"] == ["the paper"]
