"""``wrongturn results``: the paper's tables from the stored results, ours beside the paper's."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from wrongturn_agents.reporting.collection import Collection
    from wrongturn_agents.reporting.curves import Curve


def results(
    directory: Annotated[
        Path | None,
        typer.Option(
            metavar="DIRECTORY", help="Of the results files; the package's own by default.", show_default=False
        ),
    ] = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print all figures as JSON, and nothing else.")] = False,
    write: Annotated[
        list[Path] | None,
        typer.Option(metavar="PAGE", help="Write the sections of a page, as README.md.", show_default=False),
    ] = None,
    check: Annotated[
        bool,
        typer.Option("--check", help="Fail where README, docs or the picture say something else; writes nothing."),
    ] = False,
    curves: Annotated[
        bool, typer.Option("--curves", help="Draw the learning curves into docs/pictures/learning-curves.svg.")
    ] = False,
    take: Annotated[
        list[Path] | None,
        typer.Option(
            "--import",
            metavar="FILE|RUN",
            help="Keep a file of 'wrongturn score --json' or 'wrongturn run --json', or a training run's curve.",
            show_default=False,
        ),
    ] = None,
    agent: Annotated[
        str | None, typer.Option(help="Of what is imported, where it does not say so.", show_default=False)
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of the training of what is imported.", min=0, show_default=False)
    ] = None,
    variant: Annotated[
        str | None, typer.Option(help="Ablation that is imported, as without-augmentation.", show_default=False)
    ] = None,
    steps: Annotated[
        int | None, typer.Option(help="That the training of what is imported took.", min=0, show_default=False)
    ] = None,
) -> None:
    """Show both of the paper's tables, ours beside the paper's, and how far figures move from seed to seed."""
    from wrongturn_agents.reporting.collection import STORED, Collection  # noqa: PLC0415
    from wrongturn_agents.reporting.curves import read_curves  # noqa: PLC0415
    from wrongturn_agents.reporting.errors import ResultsError  # noqa: PLC0415
    from wrongturn_agents.suites import installed_suite  # noqa: PLC0415

    directory = STORED if directory is None else directory
    if not take and any(value is not None for value in (agent, seed, variant, steps)):
        raise ResultsError("--agent, --seed, --variant, --steps: say of what is imported; give --import too")
    if take:
        from wrongturn_agents.reporting.importing import Origin, take_in  # noqa: PLC0415

        for source in take:
            kept = take_in(source, directory, Origin(agent, seed, variant, steps), installed_suite)
            typer.echo(f"{source}: kept as {kept.name}", err=True)
    collection = Collection.read(directory, installed_suite)
    runs = read_curves(directory / "curves")
    if check:
        _check(collection, runs, write or [])
        return
    if curves:
        _draw(runs)
    if write:
        _write(collection, runs, write)
    if as_json:
        _print_json(collection)
    elif not (curves or write or take):
        _print(collection, runs)


def _check(collection: "Collection", runs: "tuple[Curve, ...]", named: list[Path]) -> None:
    from wrongturn_agents.reporting import curve_picture, pages  # noqa: PLC0415
    from wrongturn_agents.reporting.errors import ResultsError  # noqa: PLC0415
    from wrongturn_agents.reporting.sections import sections  # noqa: PLC0415

    found = named or [Path(page) for page in pages.PAGES if Path(page).is_file()]
    if not found:
        raise ResultsError(
            "--check: there is no README.md here; go to the repository's root, or name a page by --write"
        )
    made = sections(collection, runs)
    for page in found:
        pages.check(page, made)
    if not named:
        curve_picture.check(runs, curve_picture.PICTURE)
    typer.echo(f"{', '.join(map(str, found))}: as the stored results have it")


def _draw(runs: "tuple[Curve, ...]") -> None:
    from wrongturn_agents.reporting.curve_picture import PICTURE, draw  # noqa: PLC0415

    draw(runs, PICTURE)
    typer.echo(f"{PICTURE}: {len(runs)} curves", err=True)


def _write(collection: "Collection", runs: "tuple[Curve, ...]", named: list[Path]) -> None:
    from wrongturn_agents.reporting import pages  # noqa: PLC0415
    from wrongturn_agents.reporting.sections import sections  # noqa: PLC0415

    made = sections(collection, runs)
    for page in named:
        typer.echo(f"{page}: {'written' if pages.write(page, made) else 'says so already'}", err=True)


def _print_json(collection: "Collection") -> None:
    import json  # noqa: PLC0415

    from wrongturn_agents.reporting.sections import as_json  # noqa: PLC0415

    typer.echo(json.dumps(as_json(collection), indent=2, ensure_ascii=False))


def _print(collection: "Collection", runs: "tuple[Curve, ...]") -> None:
    from rich.text import Text  # noqa: PLC0415

    from wrongturn_agents.reporting.order import left_out, order_in_words, unsafe_by_seed  # noqa: PLC0415
    from wrongturn_agents.reporting.sections import lines_of_missing, tables  # noqa: PLC0415
    from wrongturn_client.tables import console  # noqa: PLC0415

    screen = console()
    for table in tables(collection, runs).values():
        if table.rows:
            screen.print(table.rich())
            screen.print()
    words = order_in_words(unsafe_by_seed(collection)) + left_out(collection)
    screen.print(Text(words.replace("`", "")))
    for line in lines_of_missing(collection):
        typer.echo(f"Missing: {line}" if "differ" not in line else f"Note: {line}", err=True)
