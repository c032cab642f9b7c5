"""``wrongturn suites make``: a suite of the user's own, in towns of the user's own."""

import itertools
import re
from pathlib import Path
from typing import Annotated

import typer

from wrongturn_networks.errors import NetworkError
from wrongturn_networks.faults import available_faults, faults_at
from wrongturn_networks.loading import load_town, town_named
from wrongturn_networks.making.writing_suites import write_suite
from wrongturn_networks.suites import load_suite, shelf, suite_named
from wrongturn_networks.town import Town
from wrongturn_protocol import Cell, Fault, FaultKind, JunctionType, Traffic, Weather
from wrongturn_protocol.home import home
from wrongturn_protocol.suggestions import did_you_mean

_CELL = re.compile(r"(?P<kind>[a-z_]+)(?:=(?P<dose>-?\d+(?:\.\d+)?))?(?:@(?P<type>[A-Z_]+))?(?:\*(?P<count>\d+))?")


def make(
    towns: Annotated[
        list[str],
        typer.Option(
            "--town", metavar="TOWN", help="A town's name or folder; can be repeated. Example: --town village"
        ),
    ],
    name: Annotated[str, typer.Option(metavar="NAME@VERSION", help="The suite's id. Example: --name village@1")],
    cells: Annotated[
        list[str] | None,
        typer.Option(
            metavar="FAULT[=DOSE][@TYPE][*NUMBER]",
            help="Trials with a fault: at one type of junction or at each, NUMBER of them or 5; can be repeated. By "
            "default infeasible and omission at each type. Example: --cells late=8@LEFT_RIGHT*10",
        ),
    ] = None,
    to: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder for the file; by default WRONGTURN_HOME/suites, where every command finds it. "
            "Example: --to mine",
        ),
    ] = None,
    title: Annotated[str | None, typer.Option(help="The suite in a line. Example: --title 'Our village'")] = None,
    weather: Annotated[
        Weather, typer.Option(help="Weather of all trials. Example: --weather WetNoon")
    ] = Weather.CLEAR_NOON,
    vehicles: Annotated[int, typer.Option(min=0, help="Other cars of each trial. Example: --vehicles 10")] = 0,
) -> None:
    """Make a suite of trials in towns of your own. Its leaderboard is its own; it never mixes with the shipped ones.

    Example: wrongturn suites make --town village --name village@1 --cells infeasible*5 --cells omission*5
    """
    found = [load_town(town_named(one)) for one in towns]
    wanted = [
        Cell(town=town.name, junction_type=kind, fault=fault, weather=weather, traffic=Traffic(vehicles=vehicles))
        for text in cells or ("infeasible", "omission")
        for fault, only, count in [_parsed(text)]
        for town, kind in itertools.product(found, JunctionType)
        if kind == (only or kind) and _fits(town, kind, fault)
        for _ in range(count)
    ]
    if not wanted:
        raise NetworkError("--cells: no approach of these towns suits them; 'wrongturn towns check' shows what fits")
    if name in shelf().names():
        raise NetworkError(f"--name: there is a suite {name}; suites never change, so give yours a new version")
    file = (home() / "suites" if to is None else to).expanduser().resolve() / f"{name}.json"
    try:
        write_suite(file, title or f"Own suite in {', '.join(town.name for town in found)}", wanted)
    except NetworkError:
        raise
    except (ValueError, OSError) as error:
        raise NetworkError(f"--name: {error}") from error
    suite = load_suite(suite_named(str(file)))
    typer.echo(
        f"{suite.id}: {suite.counts[0]} trials and {suite.counts[1]} twins\nsha256  {suite.sha256}\nfile    {file}"
    )


def _parsed(text: str) -> tuple[Fault, JunctionType | None, int]:
    """Return fault, type and number of a cell. Raises NetworkError."""
    match = _CELL.fullmatch(text)
    if match is None:
        raise NetworkError(f"--cells: {text!r} is no cell; write FAULT[=DOSE][@TYPE][*NUMBER], as late=8@LEFT_RIGHT*10")
    for what, given, known in (("fault", match["kind"], available_faults()), ("type", match["type"], JunctionType)):
        if given is not None and given not in {one.value for one in known}:
            raise NetworkError(
                f"--cells: {given!r} is no {what}; there are: {', '.join(known)}{did_you_mean(given, tuple(known))}"
            )
    dose = None if match["dose"] is None else float(match["dose"])
    only = None if match["type"] is None else JunctionType(match["type"])
    return Fault(kind=FaultKind(match["kind"]), dose=dose), only, int(match["count"] or 5)


def _fits(town: Town, kind: JunctionType, fault: Fault) -> bool:
    return any(fault.kind in faults_at(town, one.id) for one in town.approaches.values() if one.type is kind)
