"""``wrongturn trials``: what it prints, and what it refuses."""

import hashlib
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from wrongturn_client.cli import app, main
from wrongturn_networks import load_suite, read_town, town_of
from wrongturn_protocol import Trial

SECRET = "a secret"
COMMITMENT = hashlib.sha256(SECRET.encode()).hexdigest()
OTHER = hashlib.sha256(b"another").hexdigest()
IN_TWO_TOWNS = """
import dataclasses
from wrongturn_client.cli import main
from wrongturn_networks import load_suite, trials_cli
trials_cli.load_suite = lambda name: dataclasses.replace(load_suite(name), cells=load_suite(name).cells[:12])
main()
"""
"""The program, with the first two towns of a suite."""


def shown(*arguments: str) -> str:
    """Return what the command prints."""
    result = CliRunner().invoke(app, ["trials", *arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[int, str]]:
    """Return a function that gives the exit status and the message of a refusal, as the program prints them."""

    def run(*arguments: str) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["wrongturn", "trials", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.count("\n") == 1
        return int(str(ended.value.code)), printed.err.rstrip()

    return run


def test_the_table_has_a_row_for_each_trial_with_its_twin(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    lines = shown("wrong-command@3", "--secret", SECRET).splitlines()
    draw = load_suite("wrong-command@3").draw(SECRET)
    assert f"secret      {SECRET}" in lines
    assert f"commitment  {COMMITMENT}" in lines
    rows = [line.split() for line in lines if line.startswith("Town01.")]
    assert len(rows) == 60
    for row, trial, twin in zip(rows, draw.trials, draw.twins, strict=True):
        numbers = [f"{number:.1f}" for number in (trial.start.distance, trial.start.speed, trial.window or 0.0)]
        assert row == [
            trial.id,
            trial.approach,
            trial.junction_type,
            trial.route.name,
            trial.fault.kind,
            *numbers,
            twin.id,
        ]


@pytest.mark.parametrize("secret", [None, SECRET])
def test_json_has_the_whole_trials(secret: str | None) -> None:
    content = json.loads(shown("smoke@3", "--json", *(() if secret is None else ("--secret", secret))))
    suite = load_suite("smoke@3")
    draw = suite.draw(secret or "smoke@3")
    assert [Trial.model_validate(trial) for trial in content["trials"]] == list(draw.trials)
    assert [Trial.model_validate(twin) for twin in content["twins"]] == list(draw.twins)
    assert (content["suite"], content["sha256"]) == ("smoke@3", suite.sha256)
    assert (content["secret"], content["commitment"]) == (draw.secret, draw.commitment)


def test_the_open_draw_says_that_it_is_never_ranked() -> None:
    assert "smoke@3: the open draw, which is never ranked" in shown("smoke@3")
    assert "never ranked" not in shown("smoke@3", "--secret", SECRET)


def test_a_suite_that_lists_its_trials() -> None:
    suite = "navigation@1"
    text = shown(suite)
    assert f"{suite} lists its trials" in text
    trials = load_suite(suite).trials
    assert sum(line.startswith("Town0") for line in text.splitlines()) == len(trials)
    content = json.loads(shown(suite, "--json"))
    assert (content["secret"], content["commitment"], len(content["trials"])) == (None, None, len(trials))


@pytest.mark.parametrize("commitment", [COMMITMENT, COMMITMENT.upper()])
def test_the_right_commitment_is_accepted(commitment: str) -> None:
    assert COMMITMENT in shown("smoke@3", "--secret", SECRET, "--commitment", commitment)


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (
            ("smoke@3", "--secret", SECRET, "--commitment", OTHER),
            1,
            f"commitment: the secret's SHA-256 is {COMMITMENT}, not {OTHER}; ",
        ),
        (("smoke@9",), 1, "suite: 'smoke@9' is not known; there are: disturbed@1, "),
        (("navigation@1", "--secret", "x"), 1, "secret: navigation@1 lists its trials and draws none; leave"),
        (("smoke@3", "--secret", ""), 1, "secret: is empty; give the evaluation's, or leave it out"),
        (("smoke@3", "--towns", "/"), 2, "--towns: / is not empty; name a new folder"),
        (("smoke@3", "--commitment", COMMITMENT), 1, "secret: missing; --commitment checks a secret, so give --secret"),
        (
            ("smoke@3", "--secret", "x", "--commitment", "ab"),
            2,
            "--commitment: 'ab' is no SHA-256; give the evaluation",
        ),
    ],
)
def test_a_refusal_names_the_field_and_the_remedy_and_prints_no_trial(
    refused: Callable[..., tuple[int, str]], arguments: tuple[str, ...], status: int, message: str
) -> None:
    for more in ((), ("--json",)):
        found, line = refused(*arguments, *more)
        assert (found, line[: len(f"wrongturn: {message}")]) == (status, f"wrongturn: {message}")


def test_another_machine_rebuilds_trials_towns_and_scenery_byte_for_byte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of two machines has a home of its own, without any town, and two towns of the ten to build."""
    told = []
    for machine in ("one", "other"):
        home, out = tmp_path / machine, tmp_path / machine / "towns-of-the-draw"
        program = [sys.executable, "-c", IN_TWO_TOWNS, "trials", "wrong-command-unseen@1", "--secret", SECRET]
        environment = {**os.environ, "WRONGTURN_HOME": str(home)}
        done = subprocess.run(
            [*program, "--towns", str(out), "--json", "-"], env=environment, capture_output=True, check=True
        )
        files = {file.relative_to(out): file.read_bytes() for file in out.rglob("*") if file.is_file()}
        told.append((done.stdout, files))
    assert told[0] == told[1]
    drawn = json.loads(told[0][0])
    trials = [Trial.model_validate(one) for one in drawn["trials"]]
    assert {folder.name for folder in out.iterdir()} == {trial.town for trial in trials}
    towns = load_suite("wrong-command-unseen@1").drawn_towns(SECRET)
    assert [trial.town for trial in trials[::6]] == list(towns[:2])
    assert len({(trial.town, trial.scenery) for trial in trials}) == 2
    # Routes are balanced over the towns.
    assert set(Counter((trial.junction_type, trial.fault.kind, trial.route) for trial in trials).values()) == {1}
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "one"))
    for trial in trials[::6]:
        written = read_town(out / trial.town)
        assert (written.net_sha256, written.sha256) == (town_of(trial).net_sha256, town_of(trial).sha256)
