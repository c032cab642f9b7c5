"""``wrongturn power``: how often a suite shows a difference between two agents."""

from functools import cache, partial
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from wrongturn_agents.errors import RunError
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite
from wrongturn_client.tables import console, plain_table
from wrongturn_protocol.json_output import JsonTo, check_json_file, give_json

if TYPE_CHECKING:
    from collections.abc import Callable

ENOUGH: Final = 0.8
"""The chance that is usually asked for."""
MOST_DRAWS: Final = 32
"""More draws than this are not tried."""


def power(
    *,
    difference: Annotated[
        float, typer.Option(min=0.001, max=1, help="True difference of the unsafe rates. Example: --difference 0.1")
    ],
    rate: Annotated[
        float, typer.Option(min=0, max=1, help="True unsafe rate of the safer agent. Example: --rate 0.05")
    ] = 0.3,
    suite: Annotated[
        str, typer.Option(help="Suite of trials with faults. Example: --suite wrong-command-unseen@1")
    ] = WRONG_COMMAND,
    draws: Annotated[
        int, typer.Option(min=1, max=MOST_DRAWS, help="Draws that each agent drives. Example: --draws 4")
    ] = 1,
    json_to: JsonTo = None,
) -> None:
    """Tell how often a suite finds a true difference between two agents at 5 %, and how many draws find it in 80 %.

    Example: wrongturn power --difference 0.1

    Example: wrongturn power --difference 0.05 --rate 0 --suite wrong-command-unseen@1 --json power.json

    The test is that of 'compare' and of ties. Trials are simulated; no agent is driven.
    """
    if rate + difference > 1:
        raise RunError(f"--difference: {rate:g} and {difference:g} are more than 1; give a smaller one")
    check_json_file(json_to)
    from wrongturn_statistics import power as core  # noqa: PLC0415 - slow

    trials = list(installed_suite(suite).trials.values())
    cells = len(core.strata(trials))
    if not any(trial.is_twin for trial in trials):
        raise RunError(f"--suite: {suite} has journeys; name a suite of faults")
    rows: list[tuple[str, float, int | None]] = []
    with console(stderr=True).status("Simulating evaluations …"):
        for name, agent in core.AGENTS.items():
            chance = cache(partial(core.chance, trials, agent(rate, cells), agent(rate + difference, cells)))
            rows.append((name, chance(draws), _needed(chance)))
    content: dict[str, Any] = {"suite": suite, "rate": rate, "difference": difference, "draws": draws}
    content["agents"] = [dict(zip(("fail", "chance", "draws_needed"), row, strict=True)) for row in rows]
    if not give_json(content, json_to):
        return
    table = plain_table(f"{suite}: {100 * rate:g} and {100 * (rate + difference):g} % unsafe, draws: {draws}")
    for head in ("the agents fail", "found at 5 %", "draws for 80 %"):
        table.add_column(head, justify="left" if head == "the agents fail" else "right")
    for name, found, needed in rows:
        table.add_row(name, f"{100 * found:.0f} %", f"> {MOST_DRAWS}" if needed is None else str(needed))
    console().print(table)


def _needed(chance: "Callable[[int], float]") -> int | None:
    """Return the least number of draws with ENOUGH chance, by bisection; None beyond MOST_DRAWS."""
    high = 1
    while chance(high) < ENOUGH:
        if high >= MOST_DRAWS:
            return None
        high *= 2
    low = high // 2
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if chance(middle) >= ENOUGH else (middle, high)
    return high
