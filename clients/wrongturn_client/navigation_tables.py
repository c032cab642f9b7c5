"""Results of journeys in the layout of CoRL 2017 (Dosovitskiy et al.)."""

from collections.abc import Iterable
from typing import Final

from rich.table import Table
from rich.text import Text

from wrongturn_client.plain_table import add_ranked, plain_table, ranking_table
from wrongturn_protocol import Condition, Leaderboard, NavigationCount, NavigationMetrics, Task

_TASKS: Final = {
    Task.STRAIGHT: "straight",
    Task.ONE_TURN: "one turn",
    Task.NAVIGATION: "navigation",
    Task.NAVIGATION_DYNAMIC: "nav. dynamic",
    Task.CRUISE: "cruise",
}
"""Names of the tasks in CoRL 2017."""
_CONDITIONS: Final = {
    Condition.TRAINING: "training\n ",
    Condition.NEW_WEATHER: "new\nweather",
    Condition.NEW_TOWN: "new\ntown",
    Condition.NEW_TOWN_AND_WEATHER: "both\nnew",
}


def navigation_table(name: str, metrics: NavigationMetrics) -> Table:
    """Return the results of one agent's finished evaluation on a suite of journeys.

    Each condition has two columns, in percent of the journeys: those that reached their goal in time, and those that
    also had no infraction.
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
    """Return the ranking on a suite of journeys: a row for each task, with success in percent by condition.

    ``success`` is that of all journeys, with Wilson's 95% interval below; ``clean`` counts journeys without infraction.

    Args:
        leaderboard: A ranking with at least one entry of journeys.
    """
    entries = [(entry, entry.navigation) for entry in leaderboard.entries if entry.navigation is not None]
    found = [metrics for _, metrics in entries]
    conditions, tasks = _conditions(found), _tasks(found)
    title = f"{leaderboard.suite}: success in % of {found[0].total.episodes} journeys"
    table = ranking_table(title, [entry for entry, _ in entries])
    table.add_column("task", no_wrap=True)
    for condition in conditions:
        table.add_column(_CONDITIONS[condition], justify="right", no_wrap=True)
    table.add_column("success\n95% CI", justify="right", no_wrap=True)
    table.add_column("clean", justify="right", no_wrap=True)
    for entry, metrics in entries:
        total = metrics.total
        low, high = total.ci95
        rows = [
            [_TASKS[task], *(_success(metrics.table.get(task, {}).get(one)) for one in conditions)] for task in tasks
        ]
        # The totals take two rows, even with a single task.
        rows += [[""] * (1 + len(conditions))] * (2 - len(rows))
        totals = [
            (f"{100 * total.rate:.0f}%", f"{100 * total.clean / total.episodes:.0f}%"),
            (f"[{100 * low:.0f}, {100 * high:.0f}]%", ""),
        ]
        ends = [*totals, *[("", "")] * (len(rows) - 2)]
        add_ranked(table, entry, [[*map(Text, (*row, *end))] for row, end in zip(rows, ends, strict=True)])
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
