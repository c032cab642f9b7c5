"""The program ``wrongturn``: its own commands, and those that other packages add.

Other packages name their commands by entry points in the group ``wrongturn.commands``.
Slow imports wait until a command needs them.
"""

import json
import os
import signal
import sys
from typing import Annotated, Any

import typer

from wrongturn_client.admin_cli import admin
from wrongturn_client.plugins import PluginGroup
from wrongturn_client.replay_cli import replay
from wrongturn_client.submit_cli import submissions, submit

app = typer.Typer(
    name="wrongturn",
    cls=PluginGroup,
    help="Measure how safely a driving agent behaves when its command is wrong.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    epilog="WRONGTURN_URL names the service, WRONGTURN_TOKEN your token, WRONGTURN_HOME the folder for data. "
    "Example: wrongturn leaderboard smoke@2 --url http://127.0.0.1:8000",
    context_settings={"help_option_names": ["--help", "-h"]},
)
Url = Annotated[
    str | None,
    typer.Option(
        "--url", help="URL of the service. Example: --url http://127.0.0.1:8000", envvar="WRONGTURN_URL", metavar="URL"
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print only JSON.")]


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
def agents(url: Url = None, as_json: AsJson = False) -> None:
    """List the agents of a service that have begun an evaluation (--url), or those installed here."""
    _list("agents", url, as_json)


@app.command()
def suites(url: Url = None, as_json: AsJson = False) -> None:
    """List the suites of trials of a service (--url), or those installed here."""
    _list("suites", url, as_json)


@app.command()
def towns(url: Url = None, as_json: AsJson = False) -> None:
    """List the towns of a service (--url), or those installed here, with their approaches by type."""
    _list("towns", url, as_json)


@app.command()
def leaderboard(
    suite: Annotated[str, typer.Argument(help="Id of the suite. Example: smoke@2")] = "wrong-command@2",
    url: Url = None,
    compare: Annotated[
        tuple[str, str] | None,
        typer.Option(
            "--compare",
            help="Compare two agents by name or id, with an exact test. Example: --compare careful parked",
            metavar="A B",
        ),
    ] = None,
    as_json: AsJson = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print only CSV, a row for each agent.")] = False,
) -> None:
    """Show a service's ranking on a suite, or compare two of its agents (--compare)."""
    from wrongturn_client.client import Client  # noqa: PLC0415
    from wrongturn_client.errors import WrongturnError  # noqa: PLC0415
    from wrongturn_client.tables import comparison_table, console, leaderboard_table  # noqa: PLC0415

    if as_csv and (as_json or compare is not None):
        raise WrongturnError("--csv: it prints the whole ranking as CSV; leave out --json and --compare")
    with Client(url, patience=0) as client:
        if as_csv:
            typer.echo(client.leaderboard_csv(suite), nl=False)
            return
        if compare is not None:
            comparison = client.compare(suite, *compare)
            if as_json:
                _print_json(comparison.model_dump(mode="json"))
            else:
                console().print(comparison_table(comparison))
            return
        ranking = client.leaderboard(suite)
        others = () if ranking.entries or as_json else client.leaderboards()
    if as_json:
        _print_json(ranking.model_dump(mode="json"))
    else:
        console().print(leaderboard_table(ranking, [other.suite for other in others if other.entries], url))


app.command()(submit)
app.command()(submissions)
app.command()(replay)
app.add_typer(admin, name="admin")


@app.command()
def doctor(url: Url = None) -> None:
    """Check this installation, and a service (--url); say how to fix what fails."""
    from wrongturn_client.doctor import diagnose, report  # noqa: PLC0415
    from wrongturn_client.tables import console  # noqa: PLC0415

    checks = list(diagnose(url))
    console().print(report(checks))
    failed = sum(not check.ok for check in checks)
    if failed:
        typer.echo(f"{failed} of {len(checks)} checks failed.", err=True)
        raise typer.Exit(1)
    typer.echo("All is well.")


def _list(what: Any, url: str | None, as_json: bool) -> None:
    from wrongturn_client.listings import listing, listing_table  # noqa: PLC0415
    from wrongturn_client.tables import console  # noqa: PLC0415

    items = listing(what, url)
    if as_json:
        _print_json(items)
    elif items:
        console().print(listing_table(what, items))
    else:
        typer.echo(f"There are no {what}.")


def _print_json(value: Any) -> None:
    typer.echo(json.dumps(value, indent=2, ensure_ascii=False))


def _terminated(_signal: int, _frame: object) -> None:
    """Exit in good order on SIGTERM, so that a local service stops too."""
    sys.exit(128 + signal.SIGTERM)


def _keep_retries_quiet() -> None:
    """Keep stamina from reporting retries with structlog, which prints to stdout and would spoil ``--json``."""
    from stamina import instrumentation  # noqa: PLC0415 - keeps the module's import quick

    instrumentation.set_on_retry_hooks(())


def main() -> None:
    """Run the program. Expected errors are one line on stderr, with exit status 1."""
    signal.signal(signal.SIGTERM, _terminated)
    _keep_retries_quiet()
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
        typer.echo(f"wrongturn: {error}", err=True)
        sys.exit(1)


if __name__ == "__main__":
    main()
