"""The program ``wrongturn``: its own commands, and those that other packages add.

Other packages name their commands by entry points in the group ``wrongturn.commands``.
Slow imports wait until a command needs them.
"""

import os
import re
import signal
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from wrongturn_client.admin_cli import admin
from wrongturn_client.options import Url
from wrongturn_client.plugins import PluginGroup, SuiteCommands, TownCommands
from wrongturn_client.replay_cli import replay
from wrongturn_client.submit_cli import submissions, submit
from wrongturn_client.watch_cli import watch
from wrongturn_protocol.json_output import STDOUT, JsonTo, check_json_file, give_json

_USAGE = 2
_OF_USAGE = re.compile(r"(--[a-z-]+|[A-Z]+)((, | and )(--[a-z-]+|[A-Z]+))*: ")
"""The beginning of an error about what the user typed."""

app = typer.Typer(
    name="wrongturn",
    cls=PluginGroup,
    help="Measure how safely a driving agent behaves when its command is wrong.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    epilog="WRONGTURN_URL names the service, WRONGTURN_TOKEN your token, WRONGTURN_HOME the folder for data. "
    "Example: wrongturn leaderboard smoke@3 --url http://127.0.0.1:8000",
    context_settings={"help_option_names": ["--help", "-h"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # noqa: PLC0415

        typer.echo(f"wrongturn {version('wrongturn-client')}")
        raise typer.Exit


@app.callback()
def _program(
    _show: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    pass


@app.command()
def agents(url: Url = None, json_to: JsonTo = None) -> None:
    """List the agents of a service that have begun an evaluation (--url), or those installed here.

    Example: wrongturn agents --url http://127.0.0.1:8000
    """
    _list("agents", url, json_to)


_suites = typer.Typer(cls=SuiteCommands, help="List the suites of a service or of this installation, or make one.")
_towns = typer.Typer(cls=TownCommands, help="List the towns of a service or of this installation, or import one.")
app.add_typer(_suites, name="suites")
app.add_typer(_suites, name="suite", hidden=True)
app.add_typer(_towns, name="towns")


@_suites.command("list")
def suites(url: Url = None, json_to: JsonTo = None) -> None:
    """List the suites of trials of a service (--url), or those installed here.

    Example: wrongturn suites --json suites.json
    """
    _list("suites", url, json_to)


@_towns.command("list")
def towns(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="A town, to list its approaches. Example: Town01")
    ] = None,
    url: Url = None,
    json_to: JsonTo = None,
) -> None:
    """List the towns of a service (--url), or those installed here; or the approaches of one town by type.

    Example: wrongturn towns Town01
    """
    if name is None:
        _list("towns", url, json_to)
        return
    from wrongturn_client.listings import approaches, approaches_table  # noqa: PLC0415
    from wrongturn_client.tables import console  # noqa: PLC0415

    check_json_file(json_to)
    town = approaches(name, url)
    if give_json(town, json_to):
        console().print(approaches_table(town))


@app.command()
def leaderboard(
    suite: Annotated[str, typer.Argument(help="Id of the suite. Example: smoke@3")] = "wrong-command-unseen@1",
    url: Url = None,
    compare: Annotated[
        tuple[str, str] | None,
        typer.Option(
            "--compare",
            help="Compare two agents by name or id, with an exact test. Example: --compare careful parked",
            metavar="A B",
        ),
    ] = None,
    json_to: JsonTo = None,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print only CSV, a row for each agent.")] = False,
) -> None:
    """Show a service's ranking on a suite, or compare two of its agents (--compare).

    Example: wrongturn leaderboard smoke@3 --url http://127.0.0.1:8000
    """
    from wrongturn_client.client import Client  # noqa: PLC0415
    from wrongturn_client.errors import WrongturnError  # noqa: PLC0415
    from wrongturn_client.tables import comparison_table, console, leaderboard_table  # noqa: PLC0415

    if as_csv and (json_to is not None or compare is not None):
        raise WrongturnError("--csv: it prints the whole ranking as CSV; leave out --json and --compare")
    check_json_file(json_to)
    with Client(url, patience=0) as client:
        if as_csv:
            typer.echo(client.leaderboard_csv(suite), nl=False)
            return
        if compare is not None:
            comparison = client.compare(suite, *compare)
            if give_json(comparison.model_dump(mode="json"), json_to):
                console().print(comparison_table(comparison))
            return
        ranking = client.leaderboard(suite)
        others = () if ranking.entries or json_to == STDOUT else client.leaderboards()
    if give_json(ranking.model_dump(mode="json"), json_to):
        console().print(leaderboard_table(ranking, [other.suite for other in others if other.entries], url))


app.command()(submit)
app.command()(submissions)
app.command()(replay)
app.command()(watch)
app.add_typer(admin, name="admin")


@app.command()
def doctor(url: Url = None) -> None:
    """Check this installation, and a service (--url); say how to fix what fails.

    Example: wrongturn doctor --url http://127.0.0.1:8000
    """
    from wrongturn_client.doctor import diagnose, report  # noqa: PLC0415
    from wrongturn_client.tables import console  # noqa: PLC0415

    checks = list(diagnose(url))
    console().print(report(checks))
    failed = sum(not check.ok for check in checks)
    if failed:
        typer.echo(f"{failed} of {len(checks)} checks failed.", err=True)
        raise typer.Exit(1)
    typer.echo("All is well.")


def _list(what: Any, url: str | None, json_to: Path | None) -> None:
    from wrongturn_client.listings import listing, listing_table  # noqa: PLC0415
    from wrongturn_client.tables import console  # noqa: PLC0415

    check_json_file(json_to)
    items = listing(what, url)
    if give_json(items, json_to):
        console().print(listing_table(what, items) if items else f"There are no {what}.")


def _terminated(_signal: int, _frame: object) -> None:
    """Exit in good order on SIGTERM, so that a local service stops too."""
    sys.exit(128 + signal.SIGTERM)


def _told(error: Exception) -> str:
    """Return an error's text; where a service misses a token, it speaks of headers, which this program sends."""
    text = str(error)
    if not text.startswith(("this call needs a token", "nobody has this token")):
        return text
    return f"{text.partition(':')[0]}; set WRONGTURN_TOKEN, or the variable that the command's --help names"


def main() -> None:
    """Run the program. Expected errors are one line on stderr; status 2 if it begins with an option or argument."""
    signal.signal(signal.SIGTERM, _terminated)
    try:
        app(prog_name="wrongturn")
    except BrokenPipeError:
        # The reader of the pipe is gone. Send the rest of the buffer nowhere, or the exit fails too.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        # The errors of our packages are written for users. Any other error is a bug and keeps its traceback.
        if not type(error).__module__.startswith("wrongturn_"):
            raise
        typer.echo(f"wrongturn: {_told(error)}", err=True)
        sys.exit(_USAGE if _OF_USAGE.match(str(error)) else 1)


if __name__ == "__main__":
    main()
