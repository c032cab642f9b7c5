"""The program as a new user would try it."""

import gzip
import json
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import typer
from client_fake_service import FakeService
from typer.testing import CliRunner

from wrongturn_client import Client, cli, doctor, listings, plugins
from wrongturn_client.invocation import program
from wrongturn_protocol import Comparison, SuiteSummary
from wrongturn_protocol.installing import install

SUITE = SuiteSummary(id="mine@1", title="Mine", version=1, sha256="1" * 64, trials=3, twins=3, tracks=("privileged",))
runner = CliRunner()


def local_suites() -> list[SuiteSummary]:
    return [SUITE]


def greet(name: str = "you", fail: bool = False) -> None:
    """Greet somebody.

    At length.
    """
    if fail:
        raise plugins.PluginError("nobody there")
    typer.echo(f"Hello {name}")


def good_check() -> Iterator[tuple[str, bool, str, str]]:
    yield "weather", True, "sunny", ""


def bad_check() -> Iterator[tuple[str, bool, str, str]]:
    yield "brakes", False, "worn", "get new ones"


def broken_check() -> Iterator[tuple[str, bool, str, str]]:
    raise RuntimeError("oops")
    yield


@pytest.fixture
def points(monkeypatch: pytest.MonkeyPatch) -> dict[tuple[str, str], str]:
    """Entry points by group and name."""
    table: dict[tuple[str, str], str] = {}
    sys.modules["client_cli_plugin"] = sys.modules[__name__]

    def found(group: str) -> dict[str, metadata.EntryPoint]:
        points = {name: metadata.EntryPoint(name, value, within) for (within, name), value in table.items()}
        return {name: point for name, point in points.items() if point.group == group}

    monkeypatch.setattr(plugins, "entry_points", found)
    monkeypatch.setattr(listings, "entry_points", found)
    return table


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> FakeService:
    service = FakeService()

    def client(url: str | None = None, **options: Any) -> Client:
        return Client(url, transport=service.transport, **options)

    for module in ("client", "listings", "doctor"):
        monkeypatch.setattr(f"wrongturn_client.{module}.Client", client)
    return service


def _main(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *args: str) -> tuple[Any, str, str]:
    """Return status, output and errors of a command that runs in this process."""
    monkeypatch.setattr(sys, "argv", ["wrongturn", *args])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    return caught.value.code, *capsys.readouterr()


def test_help_lists_the_commands_and_imports_nothing_heavy() -> None:
    code = (
        "import sys; sys.argv = ['wrongturn', '--help']\n"
        "from wrongturn_client.cli import main\n"
        "try: main()\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'gymnasium', 'httpx', 'pydantic', 'torch', 'libsumo', 'fastapi', 'wrongturn_agents', "
        "'wrongturn_service', 'wrongturn_networks', 'wrongturn_sim'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stderr.strip() == "[]"
    for command in ("agents", "suites", "towns", "leaderboard", "doctor"):
        assert f" {command} " in done.stdout


def test_version() -> None:
    assert runner.invoke(cli.app, ["--version"]).output == f"wrongturn {metadata.version('wrongturn-client')}\n"


@pytest.mark.parametrize(("command", "says"), [("nonsense", "'nonsense'."), ("rnu", "'rnu'. Did you mean run?")])
def test_an_unknown_command_is_a_usage_error(command: str, says: str) -> None:
    done = runner.invoke(cli.app, [command])
    assert done.exit_code == 2
    assert f"No such command {says}" in done.stderr
    assert done.stdout == ""


@pytest.mark.parametrize(
    ("command", "part"),
    [("trials", "wrongturn-networks"), ("serve", "wrongturn-service[server]"), ("run", "wrongturn-agents")],
)
def test_a_command_of_a_part_that_is_missing_names_the_part(
    command: str, part: str, points: dict[tuple[str, str], str]
) -> None:
    result = runner.invoke(cli.app, [command], env={"COLUMNS": "400"})
    assert result.exit_code == 2
    assert f"No such command '{command}' here. It comes with {part}: {install(part)}" in result.output


def test_the_parts_commands_are_those_that_they_add() -> None:
    added = {point.name: point.dist.name for point in plugins.entry_points(plugins.COMMANDS).values() if point.dist}
    known = {command: part.partition("[")[0] for part, commands in plugins._PARTS.items() for command in commands}
    others = {part.partition("[")[0] for part in plugins._PARTS}
    assert known == {name: part for name, part in added.items() if part in others}


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["train", "ppo-image", "--steps", "0"], "--steps: is 0; give a whole number, 1 or more"),
        (["train", "ppo-image", "--steps", "many"], "--steps: is 'many'; give a whole number, 1 or more"),
        (["train", "ppo-image", "--minutes", "few"], "--minutes: is 'few'; give a number"),
        (["run", "careful", "--parallel", "-1"], "--parallel: is -1; give a whole number, 1 or more"),
        (["serve", "--port", "65536"], "--port: is 65536; give a whole number from 0 to 65535"),
        (["run", "careful", "--progress", "loud"], "--progress: 'loud' is not one of 'auto', 'bar', 'lines', 'json'"),
    ],
)
def test_a_value_that_an_option_cannot_have_is_told_in_one_line(
    arguments: list[str], says: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _main(monkeypatch, capsys, *arguments) == (2, "", f"wrongturn: {says}\n")


def test_another_parts_command_is_listed_and_runs(points: dict[tuple[str, str], str]) -> None:
    points["wrongturn.commands", "greet"] = "client_cli_plugin:greet"
    result = runner.invoke(cli.app, ["greet", "--name", "Ada"])
    assert (result.exit_code, result.output) == (0, "Hello Ada\n")
    shown = runner.invoke(cli.app, ["greet", "--help"]).output
    assert "At length." in shown
    assert "wrongturn greet" in shown or "greet [OPTIONS]" in shown
    assert runner.invoke(cli.app, ["greet", "--bogus"]).exit_code == 2


def test_the_help_line_is_read_without_importing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "wt_lazy_plugin"
    package.mkdir()
    (package / "__init__.py").write_text("raise SystemExit('imported')")
    (package / "cli.py").write_text('def go() -> None:\n    """Go far.\n\n    And back.\n    """\n')
    (package / "tree.py").write_text('import typer\napp = typer.Typer(help="Many things.")\n')
    monkeypatch.syspath_prepend(tmp_path)
    for value, line in (
        ("wt_lazy_plugin.cli:go", "Go far."),
        ("wt_lazy_plugin.tree:app", "Many things."),
        ("wt_lazy_plugin.gone:go", ""),
        ("wt_nowhere.cli:go", ""),
    ):
        assert plugins.summary(metadata.EntryPoint("x", value, "wrongturn.commands")) == line


def test_a_broken_command_is_listed_and_names_itself(points: dict[tuple[str, str], str]) -> None:
    points["wrongturn.commands", "broken"] = "wt_nowhere.cli:go"
    assert "broken" in runner.invoke(cli.app, ["--help"]).output
    result = runner.invoke(cli.app, ["broken"])
    assert isinstance(result.exception, plugins.PluginError)
    assert "'broken'" in str(result.exception)
    assert "No module named 'wt_nowhere'" in str(result.exception)


def test_expected_errors_are_one_line(
    points: dict[tuple[str, str], str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    points["wrongturn.commands", "greet"] = "client_cli_plugin:greet"
    assert _main(monkeypatch, capsys, "greet", "--fail") == (1, "", "wrongturn: nobody there\n")


@pytest.mark.parametrize(
    "command", [["suites"], ["agents"], ["towns"], ["leaderboard"], ["leaderboard", "--json"], ["run", "careful"]]
)
def test_a_service_that_is_not_there_is_one_line(
    command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, told = _main(monkeypatch, capsys, *command, "--url", "http://127.0.0.1:9")
    assert (status, out) == (1, "")
    assert told.startswith("wrongturn: no Wrongturn service answers at http://127.0.0.1:9")
    assert told.count("\n") == 1


def test_a_town_lists_its_approaches_by_type(served: FakeService) -> None:
    here = runner.invoke(cli.app, ["towns", "Town01", "--json"]).stdout
    found = json.loads(here)
    assert found["name"] == "Town01"
    types = [one["type"] for one in found["approaches"]]
    assert set(types) == {"STRAIGHT_LEFT", "STRAIGHT_RIGHT", "LEFT_RIGHT"}
    assert types == sorted(types, key=types.index)
    assert {one["id"]: one["exits"] for one in found["approaches"] if one["type"] == "LEFT_RIGHT"}["J1-N"] == [1, 2]
    shown = runner.invoke(cli.app, ["towns", "Town01"]).stdout
    assert any(line.split()[:6] == ["left", "or", "right", "J1-N", "left,", "right"] for line in shown.splitlines())
    served_town = runner.invoke(cli.app, ["towns", "Town01", "--json", "--url", "http://fake"]).stdout
    assert json.loads(served_town)["approaches"][0].keys() == found["approaches"][0].keys()


def test_an_unknown_town_is_told_with_the_one_that_is_meant() -> None:
    done = runner.invoke(cli.app, ["towns", "Town1"])
    assert str(done.exception).endswith(". Did you mean Town01?")


@pytest.mark.parametrize("name", ["found.json", "found.json.gz"])
def test_json_goes_to_stdout_or_beside_the_table_into_a_file(
    name: str, points: dict[tuple[str, str], str], tmp_path: Path
) -> None:
    points["wrongturn.listings", "suites"] = "client_cli_plugin:local_suites"
    printed = json.loads(runner.invoke(cli.app, ["suites", "--json"]).stdout)
    assert json.loads(runner.invoke(cli.app, ["suites", "--json", "-"]).stdout) == printed
    assert [SuiteSummary.model_validate(one) for one in printed] == [SUITE]
    shown = runner.invoke(cli.app, ["suites", "--json", str(tmp_path / name)]).stdout
    assert "mine@1" in shown
    assert shown == runner.invoke(cli.app, ["suites"]).stdout
    content = (tmp_path / name).read_bytes()
    assert json.loads(gzip.decompress(content) if name.endswith(".gz") else content) == printed


def test_json_takes_only_what_looks_like_its_file(
    points: dict[tuple[str, str], str], served: FakeService, tmp_path: Path
) -> None:
    words = ["leaderboard", "--json", "wrong-command-unseen@1", "--url", "http://fake"]
    assert json.loads(runner.invoke(cli.app, words).stdout)["suite"] == "wrong-command-unseen@1"
    runner.invoke(
        cli.app, ["leaderboard", f"--json={tmp_path / 'any'}", "wrong-command-unseen@1", "--url", "http://fake"]
    )
    assert json.loads((tmp_path / "any").read_text())["suite"] == "wrong-command-unseen@1"


@pytest.mark.parametrize("name", ["no/found.json", "folder.json"])
def test_a_file_for_json_that_cannot_be_written_is_told_first(name: str, tmp_path: Path) -> None:
    (tmp_path / "folder.json").mkdir()
    done = runner.invoke(cli.app, ["suites", "--json", str(tmp_path / name), "--url", "http://127.0.0.1:9"])
    assert str(done.exception) == (
        f"--json: {tmp_path / name} cannot be written; name a file in a folder that you can write to"
    )


def test_without_local_suites_it_says_what_to_do(points: dict[tuple[str, str], str]) -> None:
    result = runner.invoke(cli.app, ["suites"])
    assert f"name a service by --url or WRONGTURN_URL, or run: {install('wrongturn-networks')}" in str(result.exception)


@pytest.mark.parametrize("by", ["option", "environment"])
def test_the_services_lists(by: str, served: FakeService) -> None:
    args, environment = (["--url", "http://fake"], {}) if by == "option" else ([], {"WRONGTURN_URL": "http://fake"})
    result = runner.invoke(cli.app, ["suites", "--json", *args], env=environment)
    assert [suite["id"] for suite in json.loads(result.stdout)] == ["smoke@3"]
    assert "me" in runner.invoke(cli.app, ["agents", *args], env=environment).output


def test_an_unknown_suite_is_told(served: FakeService) -> None:
    result = runner.invoke(cli.app, ["leaderboard", "nothing@1", "--url", "http://fake"])
    assert "no /v1/leaderboards/nothing@1" in str(result.exception)


def test_an_empty_leaderboard_names_the_suites_that_have_entries(served: FakeService) -> None:
    shown = runner.invoke(cli.app, ["leaderboard", "--url", "http://fake"]).stdout
    assert "No evaluation on this suite has been finished yet." in shown
    assert "wrongturn leaderboard smoke@3 --url http://fake" in shown
    assert "leaderboard wrong-command-unseen@1" not in shown
    assert json.loads(runner.invoke(cli.app, ["leaderboard", "--json", "--url", "http://fake"]).stdout)["entries"] == []


def test_a_leaderboard_as_csv_needs_a_service_that_has_it(served: FakeService) -> None:
    result = runner.invoke(cli.app, ["leaderboard", "--csv", "--url", "http://fake"])
    assert "http://fake has none as CSV" in str(result.exception)
    result = runner.invoke(cli.app, ["leaderboard", "--csv", "--json", "--url", "http://fake"])
    assert "--csv: it prints the whole ranking as CSV; leave out --json and --compare" in str(result.exception)


def test_two_agents_are_compared(served: FakeService) -> None:
    words = ["leaderboard", "smoke@3", "--compare", "mine & yours", "id 2", "--url", "http://fake"]
    shown = runner.invoke(cli.app, words).stdout
    assert "mine & yours and id 2 are alike." in " ".join(shown.split())
    assert "straight or left, infeasible" in shown
    found = Comparison.model_validate_json(runner.invoke(cli.app, [*words, "--json"]).stdout)
    assert (found.suite, found.a.name, found.b.name, found.p) == ("smoke@3", "mine & yours", "id 2", 1.0)


def test_doctor_tells_what_is_wrong_and_what_to_do(
    points: dict[tuple[str, str], str], served: FakeService, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "home"))
    points["wrongturn.checks", "good"] = "client_cli_plugin:good_check"
    result = runner.invoke(cli.app, ["doctor", "--url", "http://fake"])
    assert result.exit_code == 0, result.output
    assert "All is well." in result.output
    assert "http://fake is ready" in result.output
    points["wrongturn.checks", "bad"] = "client_cli_plugin:bad_check"
    points["wrongturn.checks", "broken"] = "client_cli_plugin:broken_check"
    points["wrongturn.commands", "gone"] = "wt_nowhere.cli:go"
    result = runner.invoke(cli.app, ["doctor"])
    assert result.exit_code == 1
    for words in ("weather", "To do: get new ones", "RuntimeError: oops", "command gone", "3 of"):
        assert words in result.output


def test_doctor_finds_a_home_that_cannot_be_written(
    points: dict[tuple[str, str], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "file"))
    (check,) = (check for check in doctor.diagnose(None) if check.name == "WRONGTURN_HOME")
    assert not check.ok
    assert "set WRONGTURN_HOME" in check.remedy


def test_doctor_finds_an_old_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "sys", SimpleNamespace(version_info=(3, 10)))
    assert not next(doctor.diagnose(None)).ok


def test_a_reader_that_leaves_is_no_traceback() -> None:
    script = f"{sys.executable} -m wrongturn_client --help | true"
    done = subprocess.run(["sh", "-c", script], capture_output=True, text=True, timeout=60, check=False)
    assert "Traceback" not in done.stderr


# Commands that the program prints can be pasted


@pytest.mark.parametrize(
    ("called", "printed"),
    [
        (".venv/bin/wrongturn", ".venv/bin/wrongturn"),
        ("/with space/wrongturn", "'/with space/wrongturn'"),
        ("/usr/lib/wrongturn_client/__main__.py", "/bin/python -m wrongturn_client"),
        ("-m", "/bin/python -m wrongturn_client"),
    ],
)
def test_the_program_as_it_was_called(called: str, printed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", [called, "run"])
    monkeypatch.setattr(sys, "executable", "/bin/python")
    assert program() == printed


def test_found_by_the_path_its_name_is_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "wrongturn"
    file.touch(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "argv", [str(file)])
    assert program() == "wrongturn"
