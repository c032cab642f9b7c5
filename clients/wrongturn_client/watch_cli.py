"""``wrongturn watch``. Slow imports wait until the command runs."""

from typing import Annotated

import typer

from wrongturn_client.errors import AuthenticationError, WrongturnError
from wrongturn_client.options import Url


def watch(
    evaluation: Annotated[
        str, typer.Argument(metavar="EVALUATION", help="Id of an evaluation. Example: ev_e8418ce762fe141ca18313b8")
    ],
    url: Url = None,
) -> None:
    """Watch a running evaluation: how many episodes are driven, and how long it takes; at the end its rank.

    Example: wrongturn watch ev_e8418ce762fe141ca18313b8 --url http://127.0.0.1:8000

    Ctrl-C ends the watching; the evaluation goes on.

    WRONGTURN_TOKEN: the token of the agent or its owner. A finished evaluation is public.
    """
    if not (evaluation.startswith("ev_") and evaluation.isidentifier()):
        raise WrongturnError(f"EVALUATION: {evaluation!r} is no evaluation's id; give one, which begins with ev_")
    from wrongturn_client.client import Client  # noqa: PLC0415
    from wrongturn_client.following import watch as follow  # noqa: PLC0415
    from wrongturn_client.tables import standing  # noqa: PLC0415
    from wrongturn_protocol import EvaluationState  # noqa: PLC0415

    with Client(url) as client:
        try:
            found = follow(client, evaluation)
        except KeyboardInterrupt:
            typer.echo("The evaluation goes on without you.", err=True)
            raise typer.Exit(130) from None
        except AuthenticationError as error:
            why = f"{client.url} has no finished evaluation {evaluation}; to watch a running one, set WRONGTURN_TOKEN"
            raise WrongturnError(f"EVALUATION: {why} to its agent's token") from error
        if found.state is EvaluationState.CANCELLED:
            raise WrongturnError(f"EVALUATION: {evaluation} was cancelled, so it has no result; watch another one")
        typer.echo(standing(client.leaderboard(found.suite), found.id))
        typer.echo(f"{client.url}/agents/{found.agent}?evaluation={found.id}")
