"""``wrongturn register``: register shipped agents as the operator, so that their workers need no operator's token."""

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from wrongturn_agents.errors import RunError
from wrongturn_agents.registry import AgentSource, list_agents, resolve
from wrongturn_agents.saved_run import ensure_folder
from wrongturn_client import AgentNameTakenError, Client, settings
from wrongturn_client.administration import Administration
from wrongturn_client.settings import OPERATOR_TOKEN
from wrongturn_protocol.administration import AdminItem
from wrongturn_protocol.json_output import write_whole
from wrongturn_protocol.vocabulary import Collection


def register(
    agents: Annotated[
        list[str], typer.Argument(help="Shipped agents, as 'wrongturn agents' lists them. Example: careful parked")
    ],
    *,
    tokens: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for the tokens: NAME/token of each. Example: --tokens agents")
    ],
    url: Annotated[
        str, typer.Option(envvar="WRONGTURN_URL", help="Service to register at. Example: --url http://127.0.0.1:8000")
    ] = settings.DEFAULT_URL,
    renew: Annotated[
        bool, typer.Option("--renew", help="Make a new token for an agent that has one already. The old token ends.")
    ] = False,
) -> None:
    """Register shipped agents with the operator's token, and write each one's own token into a file.

    Example: wrongturn register careful parked --tokens agents

    A worker then needs only its agent's token: WRONGTURN_TOKEN_FILE=agents/careful/token wrongturn run careful

    WRONGTURN_OPERATOR_TOKEN, or the file that WRONGTURN_OPERATOR_TOKEN_FILE names: the operator's token.

    Safe to call again: an agent whose file is there stays as it is.
    """
    shipped = {agent.name for agent in list_agents()}
    unknown = [name for name in agents if name not in shipped]
    if unknown:
        raise RunError(f"AGENTS: {', '.join(unknown)}: only shipped agents; known are {', '.join(sorted(shipped))}")
    operator_token = settings.secret(OPERATOR_TOKEN)
    if operator_token is None:
        raise RunError(f"{OPERATOR_TOKEN}: set it, or {OPERATOR_TOKEN}_FILE, to the operator's token of {url}")
    with Client(url, operator_token) as client:
        for name in agents:
            file = tokens / name / "token"
            if file.exists() and not renew:
                typer.echo(f"{name} is registered already; its token is in {file}")
                continue
            try:  # before a name is taken whose token would be lost
                ensure_folder(file.parent)
            except OSError as error:
                raise RunError(
                    f"--tokens: {file.parent} cannot be written ({error.strerror}); name another folder"
                ) from error
            token = _token(client, operator_token, resolve(name), renew=renew)
            write_whole([f"{token}\n".encode()], file, private=True)
            typer.echo(f"{name} is registered; its token is in {file}")


def _token(client: Client, operator_token: str, source: AgentSource, *, renew: bool) -> str:
    """Register an agent and return its token, or a new token of the agent that is registered already."""
    try:
        registered = client.register(
            source.name,
            source.track,
            description=source.description or None,
            kind=source.kind,
            trained_on_faults=source.trained_on_faults,
            rig=source.rig,
        )
    except AgentNameTakenError as error:
        agent = _holder(client.url, operator_token, source.name)
        if agent is None:
            raise RunError(
                f"{source.name}: the name is kept at {client.url} after a deletion; delete with --free to use it again"
            ) from error
        if agent.kind is not source.kind:
            raise RunError(
                f"{source.name}: at {client.url} somebody's agent of kind {agent.kind} is called so"
            ) from error
        if not renew:
            raise RunError(
                f"{source.name}: it is registered at {client.url}, and its token is not here; "
                "--renew makes a new token and ends the old one"
            ) from error
        registered = client.rotate_token(agent.id)
    return registered.token


def _holder(url: str, operator_token: str, name: str) -> AdminItem | None:
    """Return the agent that has a name, whether or not the public lists show it."""
    with closing(Administration(url, operator_token)) as administration:
        found = administration.items(Collection.AGENTS, 100, name=name)
        return next((agent for agent in found if agent.name.lower() == name.lower()), None)
