"""The tables of the repository's pages: a table comes out right, and a page that says something else is found."""

import json
from pathlib import Path

import pytest
from driven_runs import driven_run
from made_results import keep, navigation, progress, wrong_command

from lab.curves import PICTURES, check_pictures, import_curve, read_curves, thinned
from lab.order import order_in_words, unsafe_by_seed
from lab.results import Sections, check_page, filled, import_results, sections
from lab.stored_results import Collection
from lab.tables import OutdatedPageError, navigation_table, wrong_command_table
from wrongturn_agents.errors import ResultsError
from wrongturn_protocol import Condition, Task

PAGE = """# Title

<!-- results: wrong-command -->
<!-- end of results -->

Words between.

<!-- results: order -->
<!-- end of results -->
The end.
"""


def read(directory: Path) -> Collection:
    return Collection.read(directory)


def rows_of(rows: tuple[tuple[str, ...], ...], agent: str) -> dict[str, tuple[str, ...]]:
    """Return an agent's rows by whose figures they are."""
    found: dict[str, tuple[str, ...]] = {}
    named = ""
    for row in rows:
        named = row[0] or named
        if named == agent:
            found[row[1]] = row[2:]
    return found


@pytest.fixture
def made(tmp_path: Path) -> Sections:
    directory = tmp_path / "stored"
    directory.mkdir()
    keep(directory, wrong_command("ppo-image", (0, 0, 0, 0, 7, 7), seed=1), shipped={"ppo-image": 1})
    return sections(read(directory))


def test_a_page_shows_what_is_stored_and_the_rest_is_left_alone(tmp_path, made):
    page = tmp_path / "README.md"
    page.write_text(PAGE)
    page.write_text(filled(page, made))
    text = page.read_text()
    assert "|  | ours, seed 1 | 0 · 0 | 0 · 0 | 7 · 7 | 14 (16–33 %) | 14 (16–33 %) | 60/60 |" in text
    assert "cannot be said yet" in text
    assert text.startswith("# Title\n\n<!--")
    assert "\nWords between.\n" in text
    assert text.endswith("<!-- end of results -->\nThe end.\n")
    check_page(page, made)
    assert filled(page, made) == text
    page.write_text(text.replace("7 · 7", "0 · 0"))
    with pytest.raises(OutdatedPageError, match=r"README.md: wrong-command: does not show the stored results"):
        check_page(page, made)
    page.write_text("<!-- results: order -->\n")
    with pytest.raises(ResultsError, match="a section is not whole"):
        filled(page, made)


def test_a_shipped_seed_with_its_interval_and_all_seeds_with_their_range(tmp_path):
    files = [
        wrong_command("ppo-image", (0, 0, 3, 1, 10, 9), seed=1, twins_failed=2),
        wrong_command("ppo-image", (0, 0, 5, 1, 10, 4), seed=2, opposed=3),
        wrong_command("ppo-image", (0, 1, 1, 1, 8, 0), seed=4),
    ]
    table = wrong_command_table(read(keep(tmp_path, *files, shipped={"ppo-image": 2})))
    assert table.head[2:5] == ("STRAIGHT_LEFT", "STRAIGHT_RIGHT", "LEFT_RIGHT")
    rows = rows_of(table.rows, "`ppo-image`")
    assert rows["the paper"] == ("0 · 0", "1 · 4", "7 · 4", "", "16 (18–38 %)", "")
    # Three exits of seed 2 over an opposed lane are unsafe in the strict column alone.
    (cells, totals) = rows["ours, seed 2"][:3], rows["ours, seed 2"][3:]
    assert sum(int(count) for cell in cells for count in cell.split(" · ")) == 23
    assert totals == ("23 (29–49 %)", "20 (25–43 %)", "60/60")
    assert rows["ours, 3 seeds"][3:] == ("23 [11–23]", "20 [11–23]", "60 [58–60]")


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
    assert unsafe_by_seed(collection)["ppo-image"] == (23, 25)
    assert "`ppo-image` seed 2 (53 of 60)" in order_in_words(collection)


def test_navigation_counts_arrivals_by_condition(tmp_path):
    there = (Task.NAVIGATION, Condition.NEW_TOWN)
    files = [
        navigation("ppo-auxiliary", {there: 20}, seed=1),
        navigation("ppo-auxiliary", {there: 23}, seed=2, traffic=False),
    ]
    table = navigation_table(read(keep(tmp_path, *files, shipped={"ppo-auxiliary": 1})))
    rows = rows_of(table.rows, "`ppo-auxiliary`")
    assert rows["the paper"] == ("90", "92", "78", "68")
    assert rows["ours, seed 1"] == ("100 (87–100)", "100 (87–100)", "80 (61–91)", "100 (87–100)")
    assert rows["ours, 2 seeds"] == ("100 [100–100]", "100 [100–100]", "86 [80–92]", "100 [100–100]")


def test_results_of_either_kind_of_file_are_stored(tmp_path):
    scored = tmp_path / "scored.json"
    scored.write_text(wrong_command("ppo-image", (1, 0, 0, 0, 0, 0), seed=3).model_dump_json())
    stored = import_results(scored, tmp_path, seed=4, variant="masked-classes")
    assert stored.name == "ppo-image.masked-classes.s4.wrong-command@3.in-process.json"
    run = tmp_path / "run.json"
    run.write_text(driven_run(lambda _: {}).model_dump_json())
    assert import_results(run, tmp_path, agent="careful").name == "careful.smoke@3.over-the-service.json"
    with pytest.raises(ResultsError, match="--import: seed: "):
        import_results(scored, tmp_path, seed=-1)


def test_a_curve_is_thinned_and_its_seconds_are_kept(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    progress(run / "progress.csv", 1000, evaluated_every=100)
    (run / "config.json").write_text(json.dumps({"algorithm": "ppo-image", "seed": 3}))
    path = import_curve(run, folder=tmp_path)
    (curve,) = read_curves(tmp_path)
    assert (path.name, curve.agent, curve.seed, curve.variant) == ("ppo-image.s3.csv", "ppo-image", 3, None)
    assert 140 < len(curve.rows) < 170
    assert len(curve.points("success_heldout")) == 10
    assert curve.rows["seconds_env"].sum() == pytest.approx(250)
    assert len(thinned(curve.rows)) == pytest.approx(len(curve.rows), abs=75)


def test_a_picture_of_other_curves_is_found():
    curves = read_curves()
    check_pictures(curves)
    with pytest.raises(OutdatedPageError, match="does not show the stored curves"):
        check_pictures([curve for curve in curves if curve.seed != 2])
    assert all(picture.path.is_file() for picture in PICTURES.values())
