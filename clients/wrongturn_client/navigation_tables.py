"""Journeys in the layout of CoRL 2017 (Dosovitskiy et al.): a column for each condition, a row for each task."""

from collections.abc import Iterable
from typing import Final

from rich.table import Table
from rich.text import Text

from wrongturn_client.plain_table import plain_table
from wrongturn_protocol import Condition, Leaderboard, NavigationCount, NavigationMetrics, Task

_TASKS: Final = {
    Task.STRAIGHT: "straight",
    Task.ONE_TURN: "one turn",
    Task.NAVIGATION: "navigation",
    Task.NAVIGATION_DYNAMIC: "nav. dynamic",
    Task.CRUISE: "cruise",
}
"""CoRL 2017's words."""
_CONDITIONS: Final = {
    Condition.TRAINING: "training\n ",
    Condition.NEW_WEATHER: "new\nweather",
    Condition.NEW_TOWN: "new\ntown",
    Condition.NEW_TOWN_AND_WEATHER: "both\nnew",
}


def navigation_table(name: str, metrics: NavigationMetrics) -> Table:
    """What one agent's evaluation on a suite of journeys came to.

    Each condition has two columns, both in percent of the journeys: those that reached their goal in time, and those
    that did so without any infraction.

    Args:
        name: of the agent.
        metrics: of its finished evaluation.
    """
    conditions = _conditions([metrics])
    table = plain_table(f"{name}: success and clean, in %")
    table.add_column("task", no_wrap=True)
    for condition in conditions:
        table.add_column(_CONDITIONS[condition], justify="right", no_wrap=True)
        table.add_column(" \nclean", justify="right", no_wrap=True)
    for task in _tasks([metrics]):
        counts = [metrics.table.get(task, {}).get(condition) for condition in conditions]
        cells = [text for count in counts for text in (_success(count), _clean(count))]
        table.add_row(*map(Text, (_TASKS[task], *cells)))
    total = metrics.total
    low, high = total.ci95
    lines = [
        f"{total.success} of {total.episodes} reached their goal, 95% CI [{100 * low:.0f}, {100 * high:.0f}]%; "
        f"{total.clean} without any infraction; {100 * total.completion:.0f}% of the way was covered",
    ]
    if (rate := total.per_km) is not None:
        lines.append(
            f"for each of {total.distance:.1f} km: {rate.off_road:.2f} times off the road, {rate.wrong_lane:.2f} in an "
            f"oncoming lane, {rate.collisions:.2f} collisions",
        )
    table.caption = Text("\n".join(lines))
    return table


def navigation_leaderboard(leaderboard: Leaderboard) -> Table:
    """The ranking on a suite of journeys: for each agent a row for each task, success in percent by condition.

    ``success`` is that of all journeys, with Wilson's 95% interval below; ``clean`` without any infraction; ``=``
    behind a rank says that it is shared.

    Args:
        leaderboard: with one entry of journeys at least.
    """
    entries = [(entry, entry.navigation) for entry in leaderboard.entries if entry.navigation is not None]
    found = [metrics for _, metrics in entries]
    conditions, tasks = _conditions(found), _tasks(found)
    table = plain_table(f"{leaderboard.suite}: success in % of {found[0].total.episodes} journeys")
    table.add_column("rank", justify="right", no_wrap=True)
    table.add_column(
        "agent", overflow="fold", min_width=max((len(entry.agent.track) for entry, _ in entries), default=0)
    )
    table.add_column("task", no_wrap=True)
    for condition in conditions:
        table.add_column(_CONDITIONS[condition], justify="right", no_wrap=True)
    table.add_column("success\n95% CI", justify="right", no_wrap=True)
    table.add_column("clean", justify="right", no_wrap=True)
    for entry, metrics in entries:
        rank = "-" if entry.rank is None else f"{entry.rank}{'=' if entry.tied_with else ''}"
        total = metrics.total
        low, high = total.ci95
        heads = [(rank, entry.agent.name), ("", entry.agent.track.value)]
        totals = [
            (f"{100 * total.rate:.0f}%", f"{100 * total.clean / total.episodes:.0f}%"),
            (f"[{100 * low:.0f}, {100 * high:.0f}]%", ""),
        ]
        # The totals take two rows, however few tasks there are.
        for number in range(max(2, len(tasks))):
            task = tasks[number] if number < len(tasks) else None
            cells = [_success(metrics.table.get(task, {}).get(one)) if task else "" for one in conditions]
            head, sums = (heads[number], totals[number]) if number < 2 else (("", ""), ("", ""))
            last = number == max(2, len(tasks)) - 1
            table.add_row(*map(Text, (*head, _TASKS[task] if task else "", *cells, *sums)), end_section=last)
    return table


def _tasks(found: Iterable[NavigationMetrics]) -> list[Task]:
    present = {task for metrics in found for task in metrics.table}
    return [task for task in Task if task in present]


def _conditions(found: Iterable[NavigationMetrics]) -> list[Condition]:
    present = {condition for metrics in found for cells in metrics.table.values() for condition in cells}
    return [condition for condition in Condition if condition in present]


def _success(count: NavigationCount | None) -> str:
    return "-" if count is None else f"{100 * count.success / count.episodes:.0f}"


def _clean(count: NavigationCount | None) -> str:
    return "-" if count is None else f"{100 * count.clean / count.episodes:.0f}"
