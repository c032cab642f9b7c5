"""The tables of the repository's pages: a table comes out right, and a page that says something else is found."""

from pathlib import Path

import pytest
from made_results import keep, wrong_command

from lab.order import seeds_left_out, unsafe_by_seed
from lab.report import Report, check_page, write_page
from lab.wrong_command import seeds_table, wrong_command_table
from wrongturn_agents.errors import OutdatedPageError, ResultsError
from wrongturn_agents.stored_results import Collection

PAGE = """# Title

<!-- wrongturn results: wrong-command -->
<!-- end of results -->

Words between.

<!-- wrongturn results: order -->
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
def report(tmp_path: Path) -> Report:
    directory = tmp_path / "stored"
    directory.mkdir()
    keep(directory, wrong_command("ppo-image", (0, 0, 0, 0, 7, 7), seed=1), shipped={"ppo-image": 1})
    return Report(read(directory), ())


def test_sections_are_written_and_the_rest_left_alone(tmp_path, report):
    page = tmp_path / "README.md"
    page.write_text(PAGE)
    assert write_page(page, report)
    text = page.read_text()
    assert "|  | ours, seed 1 | 0 · 0 | 0 · 0 | 7 · 7 | 14 (14–35 %) | 14 (14–35 %) | 60/60 |" in text
    assert "cannot be said yet" in text
    assert text.startswith("# Title\n\n<!--")
    assert "\nWords between.\n" in text
    assert text.endswith("<!-- end of results -->\nThe end.\n")
    assert not write_page(page, report)


def test_a_page_that_says_something_else_is_found(tmp_path, report):
    page = tmp_path / "README.md"
    page.write_text(PAGE)
    write_page(page, report)
    check_page(page, report)
    wrong = page.read_text().replace("7 · 7", "0 · 0")
    page.write_text(wrong)
    with pytest.raises(OutdatedPageError, match=r"README.md: wrong-command: does not show the stored results"):
        check_page(page, report)
    assert page.read_text() == wrong


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("nothing", "has no section for results"),
        ("<!-- wrongturn results: order -->\n", "1 sections for results begin, 0 are whole"),
        (PAGE.replace("order", "disorder"), "there is no section 'disorder'; known are navigation, "),
    ],
)
def test_a_page_without_whole_sections_is_refused(tmp_path, report, text, says):
    page = tmp_path / "README.md"
    page.write_text(text)
    with pytest.raises(ResultsError, match=says):
        write_page(page, report)
    assert page.read_text() == text


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
