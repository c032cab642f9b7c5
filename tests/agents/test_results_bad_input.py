"""What cannot be stored or shown: one line that names it, and the stored results stay as they are."""

import json

import pytest
from typer.testing import CliRunner

from wrongturn_agents.errors import ResultsError
from wrongturn_client.cli import app


def refused(*arguments):
    done = CliRunner().invoke(app, ["results", *map(str, arguments)])
    assert isinstance(done.exception, ResultsError), done.output or repr(done.exception)
    assert "\n" not in str(done.exception)
    return str(done.exception)


@pytest.mark.parametrize(
    "text",
    [b"", b"\xff\xfe", b"[" * 100_000, b"{}", b"[]", b'{"id": 5, "suite": "a", "state": "b"}', b'{"trials": 5}'],
)
def test_files_that_are_no_results_are_named(tmp_path, text):
    (tmp_path / "odd.json").write_bytes(text)
    assert "odd.json" in refused("--import", tmp_path / "odd.json", "--directory", tmp_path / "stored")
    assert not (tmp_path / "stored").exists()


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("config.json", "[]"),
        ("config.json", "{"),
        ("progress.csv", "step,minutes\n1,2,3\nmany,2\n"),
        ("progress.csv", "step\ninf\n"),
        ("progress.csv", "minutes\n1\n"),
    ],
)
def test_runs_that_are_damaged_are_named(tmp_path, name, text):
    run = tmp_path / "run"
    run.mkdir()
    (run / "config.json").write_text(json.dumps({"algorithm": "ppo-image", "seed": 1}))
    (run / "progress.csv").write_text("step,minutes\n1,1\n")
    (run / name).write_text(text)
    assert str(run) in refused("--import", run, "--directory", tmp_path)
    assert not (tmp_path / "curves").exists()


def test_a_name_leads_to_no_other_directory(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    (run / "progress.csv").write_text("step,minutes\n1,1\n")
    for option, value in (("--agent", "../../ours"), ("--variant", "../x")):
        rest = [] if option == "--agent" else ["--agent", "ppo-image"]
        assert option in refused("--import", run, "--directory", tmp_path, "--seed", 1, *rest, option, value)


def test_pages_that_are_no_text_are_named(tmp_path):
    page = tmp_path / "page.md"
    page.write_bytes(b"\xff\xfe\x00")
    assert "page.md" in refused("--write", page)
    assert page.read_bytes() == b"\xff\xfe\x00"
