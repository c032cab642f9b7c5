"""``wrongturn towns import``, ``make`` and ``check``: towns of the user's own."""

from pathlib import Path
from typing import Annotated

import typer

from wrongturn_networks.drawn import make_town
from wrongturn_networks.errors import ImportTownError, NetworkError
from wrongturn_networks.loading import read_town
from wrongturn_networks.town import Town
from wrongturn_protocol.home import home
from wrongturn_protocol.json_output import JsonTo, check_json_file, give_json

To = Annotated[
    Path | None,
    typer.Option(
        "--to",
        metavar="FOLDER",
        help="Where the town's folder is made; by default WRONGTURN_HOME/towns, where every command finds it. "
        "Example: --to mine",
    ),
]
Name = Annotated[
    str | None, typer.Option(metavar="NAME", help="Name of the town; by default the file's. Example: --name village")
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the scenery. Example: --seed 7")]


def import_file(
    file: Annotated[
        Path,
        typer.Argument(
            help="SUMO network (.net.xml), OpenDRIVE (.xodr) or OpenStreetMap (.osm) file. Example: village.osm"
        ),
    ],
    name: Name = None,
    to: To = None,
    seed: Seed = 1,
    left_hand: Annotated[
        bool, typer.Option("--left-hand", help="Traffic keeps to the left: for OSM and OpenDRIVE files.")
    ] = False,
    option: Annotated[
        list[str] | None,
        typer.Option(
            metavar="OPTION",
            help="An option of netconvert; can be repeated. Example: --option=--default.junctions.radius=6",
        ),
    ] = None,
    json_to: JsonTo = None,
) -> None:
    """Make a town of a SUMO network, an OpenDRIVE or an OpenStreetMap file, and report what works in it.

    Example: wrongturn towns import village.osm
    """
    from wrongturn_networks.making.importing import import_town  # noqa: PLC0415 - it starts netconvert
    from wrongturn_networks.making.reports import report_lines, report_of, write_map  # noqa: PLC0415

    check_json_file(json_to)
    stem = file.name.removesuffix(".gz").removesuffix(".xml").rpartition(".")[0] or file.name
    folder = _folder(name or stem, to)
    found = import_town(file, folder, left_hand=left_hand, seed=seed, options=tuple(option or ()))
    write_map(found.town, found.left_out, folder / "map.svg")
    report = report_of(found.town, found.left_out)
    if give_json(report | {"folder": str(folder), "warnings": list(found.warnings)}, json_to):
        typer.echo("\n".join([*report_lines(report), "", f"map     {folder / 'map.svg'}", f"folder  {folder}"]))
        for warning in found.warnings[:5]:
            typer.echo(f"netconvert: {warning[:200]}", err=True)


def make(
    seed: Annotated[int, typer.Option(min=0, help="The town's seed. Example: --seed 7")],
    name: Name = None,
    to: To = None,
) -> None:
    """Make a town by the generator that draws the unseen suite's towns.

    Example: wrongturn towns make --seed 7
    """
    folder = _folder(name or f"made-{seed}", to)
    if folder.exists():
        raise ImportTownError(f"{folder} exists; give another --name")
    try:
        make_town(folder.name, folder)
    except (RuntimeError, OSError) as error:
        raise ImportTownError(f"{folder}: {error}") from error
    typer.echo("\n".join([*_lines(read_town(folder)), f"folder  {folder}"]))


def check(
    folder: Annotated[Path, typer.Argument(help="A town's folder. Example: mine/village")], json_to: JsonTo = None
) -> None:
    """List all that keeps a folder from being a town. The exit status is 1 if there is anything.

    Example: wrongturn towns check mine/village
    """
    from wrongturn_networks.making.importing import check_folder  # noqa: PLC0415 - it starts netconvert

    check_json_file(json_to)
    if not folder.is_dir():
        raise NetworkError(f"FOLDER: {folder} is no folder; name the one that holds the town's .net.xml")
    flaws = check_folder(folder.resolve())
    if give_json({"town": folder.resolve().name, "flaws": flaws}, json_to):
        typer.echo("\n".join(flaws) if flaws else "\n".join([*_lines(read_town(folder.resolve())), "It is a town."]))
    if flaws:
        raise typer.Exit(1)


def _folder(name: str, to: Path | None) -> Path:
    return (home() / "towns" if to is None else to).expanduser().resolve() / name


def _lines(town: Town) -> list[str]:
    from wrongturn_networks.making.reports import report_lines, report_of  # noqa: PLC0415 - it draws trials

    return report_lines(report_of(town, {}))
