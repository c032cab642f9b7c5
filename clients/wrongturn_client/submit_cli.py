"""``wrongturn submit`` and ``wrongturn submissions``. Slow imports wait until a command runs."""

from pathlib import Path
from typing import Annotated

import typer

from wrongturn_client.errors import WrongturnError
from wrongturn_client.options import Url
from wrongturn_protocol.json_output import JsonTo, check_json_file


def submit(
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE", help="The model, an ONNX file. Example: my_agent.onnx")
    ] = None,
    *,
    suite: Annotated[str, typer.Option(help="Suite to drive. Example: --suite smoke@3")] = "wrong-command-unseen@1",
    name: Annotated[
        str | None,
        typer.Option(
            help="Name on the leaderboard; by default the file's name without .onnx. Example: --name my-agent"
        ),
    ] = None,
    url: Url = None,
    owner_name: Annotated[
        str | None,
        typer.Option(
            help="Owner of the agent; a new one is registered. By default the one used last at this service, or a new "
            "one with your login name. Example: --owner-name 'our group'"
        ),
    ] = None,
    follow: Annotated[
        str | None,
        typer.Option(metavar="ID", help="Follow a submission that was handed in before. Example: --follow su_…"),
    ] = None,
    cancel: Annotated[
        str | None, typer.Option(metavar="ID", help="Cancel a submission. Example: --cancel su_…")
    ] = None,
    wait: Annotated[
        bool, typer.Option("--wait/--no-wait", help="Follow the submission to its end, or only hand it in.")
    ] = True,
    json_to: JsonTo = None,
) -> None:
    """Hand in a model, which the service checks, drives and ranks.

    Example: wrongturn submit my_agent.onnx --suite wrong-command@3

    Ctrl-C leaves the submission running. To come back: wrongturn submit --follow ID

    The JSON of --json is the submission and its entry on the leaderboard.

    The exit status is 0 if the submission finished, and 1 if it failed or was cancelled.

    WRONGTURN_OWNER_TOKEN: the token of the owner to whom the new agent will belong.

    WRONGTURN_HOME: the folder of owners.json, which keeps the token if this command registers you as an owner.

    WRONGTURN_TOKEN: the token of an agent that is registered already and has not begun the suite.
    """
    given = [name for name, value in (("FILE", file), ("--follow", follow), ("--cancel", cancel)) if value is not None]
    if not given:
        raise WrongturnError("FILE: name the model, or an earlier submission by --follow ID or --cancel ID")
    if len(given) > 1:
        raise WrongturnError(f"{' and '.join(given)}: give only one of them")
    check_json_file(json_to)
    from wrongturn_client.submitting import Order  # noqa: PLC0415

    order = Order(url, owner_name, json_to)
    if file is not None:
        order.hand_in(file, suite, name, wait=wait)
    elif follow is not None:
        order.come_back(follow)
    elif cancel is not None:
        order.cancel(cancel)


def submissions(
    *,
    url: Url = None,
    owner_name: Annotated[
        str | None,
        typer.Option(help="Owner whose submissions to list; by default the one used last. Example: --owner-name lab"),
    ] = None,
    json_to: JsonTo = None,
) -> None:
    """List your submissions at a service, the newest first.

    Example: wrongturn submissions --url http://127.0.0.1:8000
    """
    check_json_file(json_to)
    from wrongturn_client.submitting import Order  # noqa: PLC0415

    Order(url, owner_name, json_to).list_all()
