"""``wrongturn verify``. Heavy imports wait until the command runs."""

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

if TYPE_CHECKING:
    from wrongturn_protocol.certificates import Certificate

_LARGEST: Final = 64 << 20
"""Bytes of the largest certificate."""
_KEY: Final = re.compile(rb"[0-9a-f]{64}")
_WORDS: Final = {True: "good", False: "refused", None: "not checked"}


def verify(
    file: Annotated[Path, typer.Argument(help="The certificate. Example: ev_5f0c.certificate.json")],
    key: Annotated[
        str | None,
        typer.Option(
            metavar="HEX|FILE",
            help="The public key that you trust, or what GET /v1/keys gave. Example: --key keys.json",
        ),
    ] = None,
    url: Annotated[
        str | None,
        typer.Option(
            metavar="URL", help="Trust the keys of this service, and ask it. Example: --url http://127.0.0.1:8000"
        ),
    ] = None,
    rejudge: Annotated[
        bool, typer.Option("--rejudge", help="Judge the trajectories again: of --trajectories, or of --url.")
    ] = False,
    trajectories: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Has the trajectories, each EPISODE.json; takes those of --url. Example: --trajectories drives",
        ),
    ] = None,
) -> None:
    """Check the certificate of an evaluation, offline unless you give --url.

    Example: wrongturn verify ev_5f0c.certificate.json --key keys.json

    Exit status 0: what was checked is good; 1: refused; 2: a file or an option cannot be used.
    """
    from wrongturn_certificates import checking  # noqa: PLC0415 - loads the judge

    if rejudge and url is None and trajectories is None:
        raise typer.BadParameter("needs --trajectories or --url", param_hint="--rejudge")
    certificate, plain = _read(file)
    record = certificate.record
    findings = [*checking.check_signature(certificate, plain, _keys(key, url)), *checking.check_record(record)]
    shown = None if url is None else _get(url, f"v1/evaluations/{record.evaluation}/certificate")
    if shown is not None:
        now = json.loads(shown)["record"]
        wrong = checking.in_words(list(checking.differences(plain, now, "record")))
        findings.append(("record", not wrong, wrong or f"{url} shows the same"))
    elif url is not None:
        findings.append(("record", None, f"{url} does not show this evaluation"))
    if rejudge and all(good is not False for _, good, _ in findings):
        findings += checking.check_trajectories(record, lambda episode: _trajectory(episode, url, trajectories))
    else:
        findings.append(("trajectories", None, "--rejudge checks them, if all else is good"))
    lines = [f"{_WORDS[good]:<12}{about}: {text}" for about, good, text in findings]
    refused = any(good is False for _, good, _ in findings)
    unsafe, words = record.metrics.unsafe_strict, "Refused" if refused else "Good" if key or url else "Consistent"
    lines.append(f"{words}: {record.agent.name} on {record.suite}, {unsafe.count} of {unsafe.trials} trials unsafe")
    for line in lines:  # what a forger wrote must not steer the terminal
        typer.echo("".join(letter if letter.isprintable() else "?" for letter in line))
    raise typer.Exit(int(refused))


def _read(file: Path) -> tuple["Certificate", dict[str, Any]]:
    """Return the certificate in a file, and its record as plain values. Raises BadParameter."""
    from pydantic import ValidationError  # noqa: PLC0415

    from wrongturn_protocol.certificates import Certificate  # noqa: PLC0415

    try:
        with file.open("rb") as opened:
            body = opened.read(_LARGEST + 1)
        if len(body) > _LARGEST:
            raise ValueError(f"it is larger than {_LARGEST >> 20} MiB")
        plain = json.loads(body, object_pairs_hook=_object, parse_constant=_no_number)
        return Certificate.model_validate(plain), plain["record"]
    except OSError as error:
        reason = f"cannot be read: {error.strerror}"
    except ValidationError as error:
        first = min(error.errors(), key=lambda one: one["loc"] != ("record", "version"))
        reason = f"is no certificate of version 1: {'.'.join(map(str, first['loc']))}: {first['msg']}"
    except (ValueError, RecursionError) as error:
        reason = f"is no JSON of a certificate: {error}"
    raise typer.BadParameter(f"{file} {reason}", param_hint="FILE")


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    if len(dict(pairs)) < len(pairs):
        raise ValueError("an object has a field twice")
    return dict(pairs)


def _no_number(word: str) -> None:
    raise ValueError(f"{word} is no number")


def _keys(key: str | None, url: str | None) -> dict[str, str]:
    """Return a note on each trusted key. Raises BadParameter."""
    from pydantic import ValidationError  # noqa: PLC0415

    from wrongturn_protocol.certificates import KeyList  # noqa: PLC0415

    if key is None and url is None:
        return {}
    try:
        body = (_get(url or "", "v1/keys") or b"") if key is None else key.encode()
        if key is not None and not _KEY.fullmatch(body):
            body = Path(key).read_bytes().strip()
        if _KEY.fullmatch(body):
            return {body.decode(): ""}
        listed = KeyList.model_validate_json(body).keys
        return {one.key: f", retired {one.retired}" if one.retired else "" for one in listed}
    except OSError as error:
        reason = f"is neither 64 hexadecimal digits nor a file that can be read: {error.strerror}"
    except (ValidationError, ValueError):
        reason = "holds neither a key of 64 hexadecimal digits nor what GET /v1/keys gives"
    raise typer.BadParameter(reason, param_hint="--url" if key is None else "--key")


def _trajectory(episode: str, url: str | None, folder: Path | None) -> bytes:
    file = (folder or Path()) / f"{episode}.json"
    try:
        if folder is not None and (url is None or file.exists()):
            return file.read_bytes()
        body = _get(url or "", f"v1/episodes/{episode}/trajectory")
        if body is None:
            raise typer.BadParameter(f"{url} does not show the trajectory of {episode}", param_hint="--url")
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
            file.write_bytes(body)
        return body
    except OSError as error:
        raise typer.BadParameter(f"{file}: {error.strerror}", param_hint="--trajectories") from None


def _get(url: str, path: str) -> bytes | None:
    """Return the reply to a GET, None if the service does not show that. Raises BadParameter."""
    import httpx  # noqa: PLC0415

    try:
        response = httpx.get(f"{url.rstrip('/')}/{path}", timeout=60)
        return None if response.status_code in {401, 404} else response.raise_for_status().content
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        raise typer.BadParameter(f"{url} does not give {path}: {error}", param_hint="--url") from None
