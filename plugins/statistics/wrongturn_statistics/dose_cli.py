"""``wrongturn dose``: at which dose of a fault half of an agent's trials fail."""

import sys
from collections import Counter
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.table import Table

from wrongturn_agents.progress import ProgressStyle, show_progress
from wrongturn_agents.registry import resolve, with_absolute_file
from wrongturn_client.tables import console, plain_table
from wrongturn_networks.faults import available_faults, fault_class
from wrongturn_networks.loading import town_named
from wrongturn_protocol import PAPER_TYPES, FaultKind, JunctionType
from wrongturn_protocol.json_output import STDOUT, JsonTo, check_json_file, write_json
from wrongturn_protocol.suggestions import did_you_mean
from wrongturn_protocol.trial_options import DEFAULT_TOWN
from wrongturn_statistics.dose_file import DoseFile

_MOST: Final = 2000


_DOSED: Final = tuple(kind for kind in available_faults() if fault_class(kind).dose is not None)
"""The faults that have a dose."""


def _dosed(text: str) -> str:
    """Return the name of a fault. Raises BadParameter unless it has a dose."""
    if text not in _DOSED:
        raise typer.BadParameter(
            f"{text!r} is no fault with a dose; take one of {', '.join(_DOSED)}{did_you_mean(text, _DOSED)}"
        )
    return text


def dose(
    agent: Annotated[
        str, typer.Argument(metavar="AGENT", help="The agent, as 'wrongturn run' takes it. Example: ppo-segmentation")
    ],
    *,
    fault: Annotated[
        str,  # an enumeration would offer all faults where the option is missing
        typer.Option(
            parser=_dosed,
            metavar=f"[{'|'.join(_DOSED)}]",
            help="The fault or disturbance whose dose to find. Example: --fault late",
        ),
    ],
    trials: Annotated[int, typer.Option(min=1, max=_MOST, help="Trials to drive in all. Example: --trials 120")] = 60,
    low: Annotated[
        float | None, typer.Option(help="Smallest dose; by default the fault's own. Example: --low 5")
    ] = None,
    high: Annotated[
        float | None, typer.Option(help="Largest dose; by default the fault's own. Example: --high 40")
    ] = None,
    towns: Annotated[
        list[str] | None,
        typer.Option("--town", help="A town; give it again for another. By default Town01. Example: --town Town02"),
    ] = None,
    types: Annotated[
        list[JunctionType] | None,
        typer.Option("--type", help="A type of junctions; give it again for another. Example: --type LEFT_RIGHT"),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the approaches and starts. Example: --seed 7")] = 0,
    json_to: JsonTo = None,
    progress: Annotated[
        ProgressStyle, typer.Option(help="How to show progress on stderr. Example: --progress json")
    ] = ProgressStyle.AUTO,
) -> None:
    """Find the dose of a fault at which half of an agent's trials are unsafe (D50).

    Example: wrongturn dose ppo-segmentation --fault late --json late.json

    Example: wrongturn dose ppo-segmentation --fault noise --trials 120

    With a disturbance, trials count that are not completed. The same command goes on with what the file of --json has.
    """
    check_json_file(json_to)
    source = resolve(agent)
    from wrongturn_statistics import dose_run as core  # noqa: PLC0415 - slow: it drives

    kind = FaultKind(fault)
    asked = core.dose_of(kind, low, high, source.track)
    aside = json_to == STDOUT
    file = None if aside else json_to
    begun = DoseFile(
        agent=source.name,
        fault=kind,
        low=asked.low,
        high=asked.high,
        unit=asked.unit,
        towns=tuple(dict.fromkeys(map(town_named, towns or (DEFAULT_TOWN,)))),
        types=tuple(dict.fromkeys(types or PAPER_TYPES)),
        seed=seed,
        counted=core.counted_by(kind),
    ).resumed(file)
    run = core.DoseRun(with_absolute_file(agent), str(Path.cwd()), asked, begun)
    with show_progress(progress, source.name) as update:
        update(len(begun.trials), trials)
        for done in run.drive(trials):
            write_json(done.text(), file)
            update(len(done.trials), trials)
    console(stderr=aside).print(dose_table(run.file))
    typer.echo(sentence(run.file), err=aside)
    if aside:
        sys.stdout.write(run.file.text())


def dose_table(file: DoseFile) -> Table:
    """Return the trials and failures at each dose."""
    table = plain_table(f"{file.agent}: {file.fault}")
    for head in (f"dose {file.unit}".rstrip(), "trials", file.counted):
        table.add_column(head, justify="right")
    driven = Counter(one.dose for one in file.trials)
    failed = Counter(one.dose for one in file.trials if one.failed)
    for amount in sorted(driven):
        table.add_row(f"{amount:.4g}", str(driven[amount]), str(failed[amount]))
    return table


def sentence(file: DoseFile) -> str:
    """Return D50 and the width in words. The file has trials."""
    assert file.d50 is not None
    assert file.width is not None
    value, low, high = (file.d50[name] for name in ("value", "low", "high"))
    unit = f" {file.unit}".rstrip()
    if value is None:
        bound = low if high is None else high
        of = f"in {file.low:g} to {file.high:g}{unit}"
        if bound is not None:
            way = "above" if high is None else "below"
            return f"D50 is not {of}, as it seems: it lies {way} {bound:.3g}{unit} (97.5 %)."
        which = "No dose" if file.side == "harder" else "Every dose"
        return f"{which} {of} makes half of the trials {file.counted}{'' if file.side == 'harder' else ', or more'}."
    from_ = f"below {file.low:g}" if low is None else f"{low:.3g}"
    to = f"above {file.high:g}" if high is None else f"{high:.3g}"
    wide, narrow, widest = (f"{file.width[name]:.2g}" for name in ("value", "low", "high"))
    return (
        f"D50: half of the trials are {file.counted} at {value:.3g}{unit} (95 %: {from_} to {to}). "
        f"From 10 to 90 % it takes {wide}{unit} ({narrow} to {widest})."
    )
