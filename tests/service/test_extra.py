"""What the service says where the extra ``server`` is not installed."""

import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from wrongturn_client.cli import app
from wrongturn_protocol.installing import install
from wrongturn_service import cli

PROJECT = tomllib.loads(Path(__file__).parents[2].joinpath("service/pyproject.toml").read_text("utf-8"))["project"]


def test_nothing_of_the_extra_is_missing_here() -> None:
    assert len(cli._packages()) == len(PROJECT["optional-dependencies"]["server"])
    assert cli.missing_packages() == []


@pytest.mark.parametrize("command", [["serve"], ["backup", "-"], ["restore", "-", "--yes"]], ids=lambda words: words[0])
def test_a_command_without_the_extra_says_what_to_install(command: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "_packages", lambda: ["orjson", "no_such_server", "no_such_database"])
    result = CliRunner().invoke(app, command)
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == (
        f"{command[0]}: no_such_server, no_such_database: not installed; {install('wrongturn-service[server]')}\n"
    )


def test_the_doctor_does_not_miss_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "_packages", lambda: ["no_such_server"])
    assert list(cli.checks()) == [
        ("service", True, f"not installed; to run one: {install('wrongturn-service[server]')}", "")
    ]
