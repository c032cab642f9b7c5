from pathlib import Path

import pytest
from made_results import keep, progress, wrong_command
from typer.testing import CliRunner

from wrongturn_agents.errors import OutdatedPageError, ResultsError
from wrongturn_client.cli import app

PAGE = """# Title

<!-- wrongturn results: wrong-command -->
<!-- end of results -->

Words between.

<!-- wrongturn results: order -->
<!-- end of results -->
The end.
"""


def run(*arguments: str) -> None:
    done = CliRunner().invoke(app, ["results", *arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    directory = tmp_path / "stored"
    directory.mkdir()
    return keep(directory, wrong_command("ppo-image", (0, 0, 0, 0, 7, 7), seed=1), shipped={"ppo-image": 1})


def test_sections_are_written_and_the_rest_left_alone(tmp_path, stored):
    page = tmp_path / "README.md"
    page.write_text(PAGE)
    run("--directory", str(stored), "--write", str(page))
    text = page.read_text()
    assert "|  | ours, seed 1 | 0 · 0 | 0 · 0 | 7 · 7 | 14 (14–35 %) | 14 (14–35 %) | 60/60 |" in text
    assert "cannot be said yet" in text
    assert text.startswith("# Title\n\n<!--")
    assert "\nWords between.\n" in text
    assert text.endswith("<!-- end of results -->\nThe end.\n")
    run("--directory", str(stored), "--write", str(page))
    assert page.read_text() == text


def test_a_page_that_says_something_else_is_found(tmp_path, stored):
    page = tmp_path / "README.md"
    page.write_text(PAGE)
    run("--directory", str(stored), "--write", str(page))
    run("--directory", str(stored), "--check", "--write", str(page))
    wrong = page.read_text().replace("7 · 7", "0 · 0")
    page.write_text(wrong)
    with pytest.raises(OutdatedPageError, match=r"README.md: wrong-command: does not show the stored results"):
        run("--directory", str(stored), "--check", "--write", str(page))
    assert page.read_text() == wrong


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("nothing", "has no section for results"),
        ("<!-- wrongturn results: order -->\n", "1 sections for results begin, 0 are whole"),
        (PAGE.replace("<!-- end of results -->\n\nWords", "Words"), "2 sections for results begin, 1 are whole"),
        (PAGE.replace("order", "disorder"), "there is no section 'disorder'; known are navigation, "),
    ],
)
def test_a_page_without_whole_sections_is_refused(tmp_path, stored, text, says):
    page = tmp_path / "README.md"
    page.write_text(text)
    with pytest.raises(ResultsError, match=says):
        run("--directory", str(stored), "--write", str(page))
    assert page.read_text() == text


def test_pages_anywhere_in_docs_are_checked_and_link_to_the_picture(tmp_path, stored, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    progress(tmp_path / "run" / "progress.csv", 20)
    run("--directory", str(stored), "--import", "run", "--agent", "ppo-image", "--seed", "1")
    (tmp_path / "docs" / "pictures").mkdir(parents=True)
    (tmp_path / "docs" / "background").mkdir()
    page = tmp_path / "docs" / "background" / "results.md"
    page.write_text("<!-- wrongturn results: curves -->\n<!-- end of results -->\n")
    run("--directory", str(stored), "--curves")
    with pytest.raises(OutdatedPageError, match=r"docs/background/results.md: curves"):
        run("--directory", str(stored), "--check")
    run("--directory", str(stored), "--write", "docs/background/results.md")
    assert "](../pictures/learning-curves.svg)" in page.read_text()
    run("--directory", str(stored), "--check")


def test_a_summary_has_one_line_for_each_shipped_agent(tmp_path, stored):
    page = tmp_path / "README.md"
    page.write_text("<!-- wrongturn results: summary -->\n<!-- end of results -->\n")
    run("--directory", str(stored), "--write", str(page))
    rows = [line for line in page.read_text().splitlines() if line.startswith("| `")]
    assert rows == ["| `ppo-image` | 7 | 7 | 14 (14–35 %) | 60/60 | 14 | 16 = 8 + 8 | 14 [14–14] (1) |"]
