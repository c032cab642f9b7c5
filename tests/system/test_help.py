"""The help of every command and option has an example, and the examples are right."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from wrongturn_client import cli
from wrongturn_protocol.json_output import with_stdout


def commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the words and the object of each command, those of other packages too."""
    for name in group.list_commands(None):
        command = group.get_command(None, name)
        command = command.loaded() if hasattr(command, "entry_point") else command
        if command.hidden:  # another spelling of a command
            continue
        if hasattr(command, "list_commands"):
            yield from commands(command, (*path, name))
        else:
            yield (*path, name), command


def all_commands() -> dict[tuple[str, ...], Any]:
    return dict(commands(typer.main.get_command(cli.app)))


def test_every_command_has_an_example_that_it_takes() -> None:
    without = []
    for path, command in all_commands().items():
        examples = re.findall(r"^Example: wrongturn (.*)$", command.help, re.MULTILINE)
        if not examples:
            without.append(" ".join(path))
        for example in examples:
            words = shlex.split(example)
            words = words[next(i for i, word in enumerate((*words, "")) if word not in path) :]
            command.make_context(path[-1], with_stdout(words))
    assert without == [], "their help shows no line 'Example: wrongturn …'"


def test_each_value_of_an_option_has_an_example() -> None:
    without = [
        f"{' '.join(path)}: {one.name}"
        for path, command in all_commands().items()
        for one in command.params
        if not getattr(one, "is_flag", False) and "Example: " not in (one.help or "")
    ]
    assert without == []


def test_the_example_of_picture_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"Example: wrongturn (.*)", all_commands()["picture",].help)
    done = CliRunner().invoke(cli.app, shlex.split(example))
    assert done.exit_code == 0, done.output
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_the_page_of_commands_names_each_one() -> None:
    page = (Path(__file__).parents[2] / "docs" / "installing.md").read_text("utf-8").partition("## The command line")[2]
    table = "".join(line for line in page.splitlines() if line.startswith("| `wrongturn-"))
    assert set(re.findall(r"`([a-z]+)`", table)) == {path[0] for path in all_commands()}


def test_the_readmes_commands_are_among_them() -> None:
    text = (Path(__file__).parents[2] / "README.md").read_text("utf-8")
    code = [*text.split("```")[1::2], *re.findall(r"`([^`\n]+)`", text)]
    shown = {command for one in code for command in re.findall(r"\bwrongturn ([a-z]+)", one)}
    assert {"run", "serve", "leaderboard", "doctor"} <= shown <= {path[0] for path in all_commands()}
