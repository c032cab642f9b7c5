"""``wrongturn trials``: the trials that a secret draws of a suite."""

import contextlib
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

import typer

from wrongturn_networks.draws import Draw, commitment_of
from wrongturn_networks.errors import CommitmentError, SecretError
from wrongturn_networks.loading import town_of, write_town
from wrongturn_networks.suites import Suite, load_suite, suite_named
from wrongturn_protocol import Trial
from wrongturn_protocol.json_output import STDOUT, JsonTo, check_json_file, give_json

_HEADS: Final = ("trial", "approach", "type", "route", "fault", "start m", "m/s", "window m")


def _hexadecimal(value: str | None) -> str | None:
    if value is not None and not re.fullmatch(r"[0-9a-fA-F]{64}", value):
        raise typer.BadParameter(f"{value[:80]!r} is no SHA-256; give the evaluation's 64 hexadecimal digits")
    return value


def trials(
    suite: Annotated[
        str, typer.Argument(help="Id or file of the suite. Example: wrong-command@3")
    ] = "wrong-command-unseen@1",
    secret: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            help="Secret of a finished evaluation. Without it you get the open draw. Example: --secret 5f0c…",
        ),
    ] = None,
    commitment: Annotated[
        str | None,
        typer.Option(
            metavar="HEX",
            callback=_hexadecimal,
            help="What the evaluation told at its beginning. Fails if it is not the secret's SHA-256. "
            "Example: --commitment 91ab…",
        ),
    ] = None,
    towns: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            file_okay=False,
            help="Write the towns with their drawn scenery into this folder, each into one of its own. "
            "Example: --towns towns",
        ),
    ] = None,
    json_to: JsonTo = None,
) -> None:
    """Show the trials that a secret draws, to rebuild and check an evaluation.

    Example: wrongturn trials wrong-command@3 --secret 5f0c… --json trials.json

    The JSON of --json has every field of the trials and twins. Towns that the secret makes are built first.
    """
    check_json_file(json_to)
    chosen = load_suite(suite_named(suite))
    if commitment is not None:
        _check(secret, commitment)
    draw = _drawn(chosen, secret) if towns is None else _with_towns(chosen, secret, towns)
    give_json(_content(chosen, draw), json_to)
    if json_to == STDOUT:
        return
    for line in (*_head(chosen, draw), *_table(draw)):
        typer.echo(line)


@contextlib.contextmanager
def _home(folder: str) -> Iterator[None]:
    """Let another folder be the home of this process and of those that it starts."""
    before = os.environ.get("WRONGTURN_HOME")
    os.environ["WRONGTURN_HOME"] = folder
    try:
        yield
    finally:
        os.environ.pop("WRONGTURN_HOME")
        if before is not None:
            os.environ["WRONGTURN_HOME"] = before


def _with_towns(suite: Suite, secret: str | None, folder: Path) -> Draw:
    """Return a draw, and write its towns. What is kept at home may have been changed, so they are built anew."""
    try:
        if folder.exists() and any(folder.iterdir()):
            raise typer.BadParameter(f"{folder} is not empty; name a new folder", param_hint="--towns")
        folder.mkdir(parents=True, exist_ok=True)
        with (
            tempfile.TemporaryDirectory() as scratch,
            _home(scratch) if suite.makes_towns else contextlib.nullcontext(),
        ):
            draw = _drawn(suite, secret)
            for town in dict.fromkeys(map(town_of, draw.trials)):
                write_town(town, folder / town.name)
    except OSError as error:
        raise typer.BadParameter(f"{folder}: {error.strerror or error}; name another", param_hint="--towns") from None
    return draw


def _drawn(suite: Suite, secret: str | None) -> Draw:
    if secret is None:
        return suite.open_draw
    if not suite.cells:
        raise SecretError(f"secret: {suite.id} lists its trials and draws none; leave --secret out")
    return suite.draw(secret)


def _check(secret: str | None, commitment: str) -> None:
    """Check a secret against what was told of it. Raises SecretError without one, and CommitmentError."""
    if secret is None:
        raise SecretError("secret: missing; --commitment checks a secret, so give --secret too")
    found = commitment_of(secret)
    if found != commitment.lower():
        raise CommitmentError(
            f"commitment: the secret's SHA-256 is {found}, not {commitment.lower()}; the evaluation was not drawn "
            "from this secret, or one of the two was copied wrongly"
        )


def _content(suite: Suite, draw: Draw) -> dict[str, object]:
    return {
        "suite": suite.id,
        "sha256": suite.sha256,
        "secret": draw.secret,
        "commitment": draw.commitment,
        "trials": [trial.model_dump(mode="json") for trial in draw.trials],
        "twins": [twin.model_dump(mode="json") for twin in draw.twins],
    }


def _head(suite: Suite, draw: Draw) -> list[str]:
    if draw.secret is None:
        return [f"{suite.id} lists its trials: every evaluation drives the same.", ""]
    kind = "the open draw, which is never ranked" if draw.secret == suite.id else "the draw of this secret"
    return [f"{suite.id}: {kind}", f"secret      {draw.secret}", f"commitment  {draw.commitment}", ""]


def _table(draw: Draw) -> list[str]:
    """Return a line for each trial below the heads. No id is ever broken, so that it can be copied and searched for."""
    twins: list[tuple[str, ...]] = [(twin.id,) for twin in draw.twins] or [()] * len(draw.trials)
    heads = (*_HEADS, *(("twin",) if draw.twins else ()))
    rows = [heads, *((*_row(trial), *twin) for trial, twin in zip(draw.trials, twins, strict=True))]
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def _row(trial: Trial) -> tuple[str, ...]:
    """Return the cells of a trial's row; a journey shows its task for the fault."""
    return (
        trial.id,
        trial.approach,
        trial.junction_type.value,
        trial.route.name,
        trial.journey.task.value if trial.journey else trial.fault.label,
        f"{trial.start.distance:.1f}",
        f"{trial.start.speed:.1f}",
        "15" if trial.window is None else f"{trial.window:.1f}",
    )
