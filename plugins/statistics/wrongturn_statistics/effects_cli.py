"""``wrongturn effects``: what fault, type, town, weather and traffic do to an agent's unsafe rate."""

from typing import Annotated

import typer
from rich.table import Table

from wrongturn_agents.records.cli import find_records
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_client.tables import console, plain_table
from wrongturn_protocol.json_output import JsonTo, check_json_file, give_json
from wrongturn_statistics.effects import Effect, Effects, Observed, effects_of


def effects(
    runs: Annotated[
        list[str],
        typer.Argument(
            metavar="RUN...",
            help="Files of 'wrongturn run --json' or 'wrongturn score --json', or names of agents with stored results. "
            "With several agents the agent is a factor too. Example: run.json.gz",
        ),
    ],
    *,
    suite: Annotated[
        str, typer.Option(help="Suite of the agents that you name without a file. Example: --suite smoke@3")
    ] = WRONG_COMMAND,
    json_to: JsonTo = None,
) -> None:
    """Tell what each factor does to the strict unsafe rate, all others alike, with 95 % intervals.

    Example: wrongturn effects run.json.gz --json effects.json

    Example: wrongturn effects ppo-image marln

    Factors are fault, junction type, town, weather and traffic, where trials differ in them. Twins do not count.
    """
    check_json_file(json_to)
    records = [record for run in runs for record in find_records(run, None, suite)]
    found = effects_of(
        [
            Observed(record.agent, drive.trial, drive.result.unsafe_strict)
            for record in records
            for drive in record.trials
            if drive.trial.journey is None
        ]
    )
    content = {**found._asdict(), "effects": [one._asdict() for one in found.effects]}
    if give_json(content, json_to):
        console().print(effects_table(found))


def effects_table(found: Effects) -> Table:
    """Return a line for each level of each factor."""
    table = plain_table(f"{found.trials} trials, {found.clusters} junctions or drawn towns")
    for head in ("factor", "level"):
        table.add_column(head)
    for head in ("unsafe", "difference", "95 %", "p"):
        table.add_column(head, justify="right")
    factor = None
    for one in found.effects:
        table.add_row(
            one.factor if one.factor != factor else "", one.level, f"{one.unsafe} of {one.trials}", *_numbers(one)
        )
        factor = one.factor
    table.caption = found.why_none
    return table


def _numbers(one: Effect) -> tuple[str, str, str]:
    if one.level == one.reference:
        return "compared with", "", ""
    if one.difference is None or one.low is None or one.high is None or one.p is None:
        return "–", "", ""
    return f"{one.difference:+.2f}", f"{one.low:+.2f} to {one.high:+.2f}", "< 0.001" if one.p < 1e-3 else f"{one.p:.2g}"
