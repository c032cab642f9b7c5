"""``wrongturn judge``: judge drives that were recorded elsewhere."""

from pathlib import Path
from typing import Annotated, Any

import typer

from wrongturn_protocol.json_output import JsonTo, check_json_file, give_json


def judge(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="CSV or JSON. Example: drive.csv")],
    *,
    picture: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Draw each drive into this folder. Example: --picture pictures")
    ] = None,
    json_to: JsonTo = None,
) -> None:
    """Judge drives that were recorded in another simulator. Nothing is ranked.

    Example: wrongturn judge drive.csv --picture pictures

    The page docs/judge.md has a whole file. The command fails if a file cannot be judged.
    """
    from wrongturn_judge.recording_file import judge_file  # noqa: PLC0415 - a compiler
    from wrongturn_sim.view.shown import show  # noqa: PLC0415 - OpenCV

    check_json_file(json_to)
    told: list[dict[str, Any]] = []
    lines: list[str] = []
    for file in files:
        try:
            judgement, trajectory = judge_file(file)
            told.append({"file": str(file), **judgement.model_dump(mode="json")})
            figures = {**told[-1], **(told[-1]["outcome"] or {}), "file": None, "outcome": None, "notes": None}
            lines.append(f"{file}: {figures.pop('verdict') or 'undecided'}")
            for name, one in figures.items():
                lines += [] if one in (None, []) else [f"  {name}: {f'{one:.2f}' if isinstance(one, float) else one}"]
            lines += [f"  {note}" for note in judgement.notes]
            if picture is not None:
                picture.mkdir(parents=True, exist_ok=True)
                lines += show(trajectory.to_json(), judgement.outcome, picture=picture / f"{file.name}.png")
        except (ValueError, OSError) as error:
            told.append({"file": str(file), "error": str(error)})
            typer.echo(f"{file}: {error}", err=True)
    if give_json(told, json_to) and lines:
        typer.echo("\n".join(lines))
    if any("error" in one for one in told):
        raise typer.Exit(1)
