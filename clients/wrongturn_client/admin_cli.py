"""``wrongturn admin``: what the operator of a service does. Slow imports wait until a command runs."""

import contextlib
import os
import secrets
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from wrongturn_client.errors import WrongturnError
from wrongturn_client.options import Url
from wrongturn_protocol.json_output import JsonTo, check_json_file, give_json
from wrongturn_protocol.vocabulary import AuditAction, Collection

if TYPE_CHECKING:
    from wrongturn_client.administration import Administration
    from wrongturn_protocol.administration import Contents

admin = typer.Typer(
    help="Administer a service: list, hide, revoke and delete owners, agents, evaluations and submissions.",
    no_args_is_help=True,
    epilog="These commands need the operator's token, in WRONGTURN_OPERATOR_TOKEN or in the file that "
    "WRONGTURN_OPERATOR_TOKEN_FILE names. Example: wrongturn admin agents --name test",
)
_KINDS: Final = {
    "ow_": Collection.OWNERS,
    "ag_": Collection.AGENTS,
    "ev_": Collection.EVALUATIONS,
    "su_": Collection.SUBMISSIONS,
}
_NAMED: Final = {"owner": Collection.OWNERS, "agent": Collection.AGENTS}
_BROKEN: Final = frozenset({"contact", "reason", "rows", "why"})
"""Columns of tables with long texts, which are broken."""
_BROADEST: Final = 1000
_TARGET: Final = "An id, or owner:NAME or agent:NAME. Example: agent:test-7"
_Limit = Annotated[int, typer.Option(min=1, help="How many lines to show at most. Example: --limit 1000")]
_Target = Annotated[str, typer.Argument(metavar="TARGET", help=_TARGET)]
_Targets = Annotated[list[str], typer.Argument(metavar="TARGET...", help=_TARGET)]
_Reason = Annotated[str | None, typer.Option(help="Why, for the audit log. Example: --reason 'asked by mail'")]
_Name = Annotated[str | None, typer.Option(help="Part of the name. Example: --name test")]
_Owner = Annotated[
    str | None, typer.Option(metavar="OWNER", help="Only those of this owner, by its id or name. Example: --owner lab")
]
_Agent = Annotated[
    str | None,
    typer.Option(metavar="AGENT", help="Only those of this agent, by its id or name. Example: --agent test-7"),
]
_Suite = Annotated[str | None, typer.Option(help="Only those on this suite. Example: --suite smoke@3")]
_Hidden = Annotated[bool | None, typer.Option("--hidden/--shown", help="Only hidden ones, or only others.")]


@admin.command()
def owners(
    name: _Name = None, hidden: _Hidden = None, limit: _Limit = 100, url: Url = None, json_to: JsonTo = None
) -> None:
    """List owners, newest first, with their contact.

    Example: wrongturn admin owners --name lab
    """
    _list(Collection.OWNERS, url, limit, json_to, name=name, hidden=hidden)


@admin.command()
def agents(
    name: _Name = None,
    owner: _Owner = None,
    hidden: _Hidden = None,
    limit: _Limit = 100,
    url: Url = None,
    json_to: JsonTo = None,
) -> None:
    """List agents, newest first.

    Example: wrongturn admin agents --owner lab --json agents.json
    """
    _list(Collection.AGENTS, url, limit, json_to, name=name, owner=owner, hidden=hidden)


@admin.command()
def evaluations(
    name: _Name = None,
    owner: _Owner = None,
    agent: _Agent = None,
    suite: _Suite = None,
    state: Annotated[str | None, typer.Option(help="running, finished or cancelled. Example: --state running")] = None,
    hidden: _Hidden = None,
    limit: _Limit = 100,
    url: Url = None,
    json_to: JsonTo = None,
) -> None:
    """List evaluations, newest first.

    Example: wrongturn admin evaluations --agent test-7 --state running
    """
    filters = {"name": name, "owner": owner, "agent": agent, "suite": suite, "state": state, "hidden": hidden}
    _list(Collection.EVALUATIONS, url, limit, json_to, **filters)


@admin.command()
def submissions(
    name: _Name = None,
    owner: _Owner = None,
    agent: _Agent = None,
    suite: _Suite = None,
    state: Annotated[
        str | None,
        typer.Option(help="queued, checked, running, finished, failed or cancelled. Example: --state failed"),
    ] = None,
    limit: _Limit = 100,
    url: Url = None,
    json_to: JsonTo = None,
) -> None:
    """List submissions, newest first.

    Example: wrongturn admin submissions --state failed
    """
    filters = {"name": name, "owner": owner, "agent": agent, "suite": suite, "state": state}
    _list(Collection.SUBMISSIONS, url, limit, json_to, **filters)


@admin.command()
def show(target: _Target, url: Url = None, json_to: JsonTo = None) -> None:
    """Show one owner, agent, evaluation or submission, and what a deletion would delete with it.

    Example: wrongturn admin show agent:test-7
    """
    check_json_file(json_to)
    with _service(url) as service:
        found = service.item(*_found(service, target))
    if not give_json(found.model_dump(mode="json"), json_to):
        return
    for field, value in found.model_dump(mode="json", exclude={"contents"}).items():
        typer.echo(f"{field}: {value}")
    typer.echo(f"holds: {_words_of(found.contents)}")


@admin.command()
def hide(targets: _Targets, reason: _Reason = None, url: Url = None) -> None:
    """Hide owners, agents or evaluations from everybody but their owner. They still count.

    Example: wrongturn admin hide agent:test-7 --reason 'driven by hand'
    """
    for service, collection, item in _each(targets, url):
        changed = service.hide(collection, item, reason).changed
        typer.echo(f"{item}: {'hidden' if changed else 'was hidden before'}")


@admin.command()
def unhide(targets: _Targets, reason: _Reason = None, url: Url = None) -> None:
    """Show again what was hidden.

    Example: wrongturn admin unhide agent:test-7
    """
    for service, collection, item in _each(targets, url):
        changed = service.unhide(collection, item, reason).changed
        typer.echo(f"{item}: {'shown again' if changed else 'was not hidden'}")


@admin.command()
def revoke(targets: _Targets, reason: _Reason = None, url: Url = None) -> None:
    """End the tokens of owners and their agents, or of single agents.

    Example: wrongturn admin revoke owner:lab --reason 'token was published'
    """
    for service, collection, item in _each(targets, url):
        typer.echo(f"{item}: tokens ended: {service.revoke(collection, item, reason).changed}")


@admin.command()
def delete(
    target: _Target,
    *,
    free: Annotated[
        bool,
        typer.Option(
            "--free", help="Give back the names, or the agent's place on the suite. Otherwise they stay taken."
        ),
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would be deleted.")] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")] = False,
    reason: _Reason = None,
    url: Url = None,
    json_to: JsonTo = None,
) -> None:
    """Delete one owner, agent, evaluation or submission for good, with all that belongs to it. Asks first.

    Example: wrongturn admin delete agent:test-7 --dry-run

    To free later what a deletion keeps taken, repeat it with the id and --free.
    """
    from wrongturn_client.errors import NotFoundError  # noqa: PLC0415

    check_json_file(json_to)
    with _service(url) as service:
        collection, item = _found(service, target)
        try:
            found = service.item(collection, item)
        except NotFoundError:  # it may have been deleted before
            if dry_run:
                raise
        else:
            typer.echo(f"{collection.one} {item} ({found.name}): {_words_of(found.contents)}", err=True)
            if dry_run:
                give_json(found.contents.model_dump(mode="json"), json_to)
                return
            if not yes:
                typer.confirm("Delete all this for good?", abort=True, err=True)
        deletion = service.delete(collection, item, free=free, reason=reason)
    if not give_json(deletion.model_dump(mode="json"), json_to):
        return
    typer.echo(f"Deleted: {_words_of(deletion.deleted)}.")
    for held in deletion.held:
        typer.echo(f"Stays taken: {held}. To free it: wrongturn admin delete {item} --free")


@admin.command()
def usage(
    limit: _Limit = 20,
    cursor: Annotated[
        str | None,
        typer.Option(metavar="NEXT", help="Go on after an earlier list: `next` of its --json. Example: --cursor dDE3"),
    ] = None,
    url: Url = None,
    json_to: JsonTo = None,
) -> None:
    """Show which owners have stored the most, as their quotas count it.

    A running evaluation counts with the most bytes that it can need.

    Example: wrongturn admin usage --limit 50
    """
    check_json_file(json_to)
    with _service(url) as service:
        found = service.usage(limit, cursor)
    if not give_json(found.model_dump(mode="json"), json_to):
        return
    rows = [(owner.name, owner.id, owner.contents) for owner in found.owners] + [("all", "", found.total)]
    heads = ("owner", "id", "bytes", "agents", "evaluations", "episodes", "submissions")
    _print_table(heads, [(name, item, *(str(getattr(held, head)) for head in heads[2:])) for name, item, held in rows])


@admin.command()
def audit(
    target: Annotated[
        str | None, typer.Option(metavar="TARGET", help=f"Only what was done to it, also if it is deleted. {_TARGET}")
    ] = None,
    action: Annotated[AuditAction | None, typer.Option(help="Only this. Example: --action delete")] = None,
    limit: _Limit = 100,
    url: Url = None,
    json_to: JsonTo = None,
) -> None:
    """List what the operator did, newest first.

    Example: wrongturn admin audit --target agent:test-7
    """
    check_json_file(json_to)
    with _service(url) as service:
        entries = list(service.audit(limit, target=target, action=None if action is None else action.value))
    if not give_json([entry.model_dump(mode="json") for entry in entries], json_to):
        return
    if not entries:
        typer.echo("There are no such entries.")
        return
    heads = ("time", "by", "from", "did", "what", "name", "rows", "why")
    rows = [
        (
            _minute(entry.time),
            entry.actor,
            entry.address,
            entry.action.value,
            entry.target,
            entry.name,
            _words_of(entry.contents),
            entry.reason or "",
        )
        for entry in entries
    ]
    _print_table(heads, rows)


@admin.command()
def rotate_token(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            envvar="WRONGTURN_OPERATOR_TOKEN_FILE",
            help="The file with the token. Example: docker/secrets/operator_token",
        ),
    ],
    *,
    create: Annotated[bool, typer.Option("--create", help="Make the file if it does not exist.")] = False,
) -> None:
    """Write a new token into the file of the operator's token, or of another one.

    The service reads the file at each use, so the old token ends at once and nothing needs a restart. Run this where
    the file can be written.

    A file that does not exist may be a mistake, so --create makes one.

    Example: wrongturn admin rotate-token docker/secrets/operator_token
    """
    new = f"wt_{secrets.token_urlsafe(32)}\n".encode()
    if not create and not file.exists():
        raise WrongturnError(
            f"FILE: there is no {file}, so no token has changed; name the file that the service reads, or send --create"
        )
    try:
        # In place: a container that has the file mounted would go on with a replaced one.
        with contextlib.closing(os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT, 0o600), "wb", buffering=0)) as opened:
            opened.write(new)
            opened.truncate(len(new))
            os.fsync(opened.fileno())
    except OSError as error:
        raise WrongturnError(f"FILE: {file} cannot be written ({error.strerror}); run this where it can be") from error
    typer.echo(f"{file} has a new token. For a service that reads this file, the old one has ended.")
    typer.echo("To check: 'wrongturn admin usage' must fail with the old token.")


@admin.command()
def rotate_key(reason: _Reason = None, url: Url = None) -> None:
    """Let the service sign certificates with a new key. The old public key stays published.

    Example: wrongturn admin rotate-key --reason 'yearly'

    If WRONGTURN_SIGNING_KEY_FILE is set, write the new key into that file first.
    """
    with _service(url) as service:
        new = service.rotate_key(reason)
    typer.echo(f"The new key is {new.key}.\nIts fingerprint (SHA-256) is {new.fingerprint}.")


def _service(url: str | None) -> "Administration":
    from wrongturn_client.administration import Administration  # noqa: PLC0415

    return Administration(url)


def _each(targets: Sequence[str], url: str | None) -> Iterator[tuple["Administration", Collection, str]]:
    """Yield what each target is, and its id, once all are known to exist."""
    with _service(url) as service:
        for collection, item in [_found(service, target) for target in targets]:
            yield service, collection, item


def _found(service: "Administration", target: str) -> tuple[Collection, str]:
    """Return what a target is, and its id. Raises WrongturnError."""
    kind, separator, name = target.partition(":")
    if separator and kind in _NAMED:
        same = [one for one in service.items(_NAMED[kind], 1000, name=name) if one.name.lower() == name.lower()]
        if not same:
            raise WrongturnError(f"TARGET: there is no {kind} {name!r}; 'wrongturn admin {kind}s' lists them")
        return _NAMED[kind], same[0].id
    if target[:3] not in _KINDS:
        raise WrongturnError(f"TARGET: {target!r} is neither an id, such as ag_…, nor owner:NAME or agent:NAME")
    return _KINDS[target[:3]], target


def _list(collection: Collection, url: str | None, limit: int, json_to: Path | None, **filters: object) -> None:
    check_json_file(json_to)
    with _service(url) as service:
        items = list(service.items(collection, limit, **filters))
    if not give_json([item.model_dump(mode="json") for item in items], json_to):
        return
    if items:
        always = {"contact"} if collection is Collection.OWNERS else set()
        fields = [
            field
            for field in type(items[0]).model_fields
            if field in always or any(getattr(item, field) is not None for item in items)
        ]
        _print_table(fields, [[_cell(field, getattr(item, field)) for field in fields] for item in items])
    else:
        typer.echo(f"There are no such {collection.value}.")


def _cell(field: str, value: object) -> str:
    """Return a field's value as a table shows it."""
    if field == "created":
        return _minute(str(value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else str(value)


def _minute(time: str) -> str:
    """Return an ISO 8601 time in UTC as tables show it, such as ``2026-11-22 16:13``."""
    return time[:16].replace("T", " ")


def _words_of(contents: "Contents") -> str:
    """Return what there is in words, such as ``1 agent, 12 episodes, 3.4 MB``."""
    ones = {"replies": "reply", "trajectories": "trajectory", "results": "record of results"}
    counts = contents.model_dump(exclude={"bytes"})
    parts = [f"{n} {kind if n != 1 else ones.get(kind, kind[:-1])}" for kind, n in counts.items() if n]
    if contents.bytes:
        parts.append(f"{contents.bytes / 1e6:.1f} MB" if contents.bytes >= 1e5 else f"{contents.bytes} bytes")
    return ", ".join(parts) or "nothing"


def _print_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    from rich.measure import Measurement  # noqa: PLC0415

    from wrongturn_client.tables import console, list_table  # noqa: PLC0415

    table = list_table(heads, rows, whole=set(heads) - _BROKEN)
    screen = console()
    # What can be copied, such as an id, is never broken: on a narrow terminal the lines are longer than it is.
    broad = screen.options.update(max_width=_BROADEST)
    screen.width = max(screen.width, Measurement.get(screen, broad, table).minimum)
    screen.print(table)
