"""What each part of a training is worth: variants without it, beside the algorithm as it is."""

from wrongturn_agents.reporting import navigation, wrong_command
from wrongturn_agents.reporting.collection import Collection
from wrongturn_agents.reporting.report_table import ReportTable
from wrongturn_agents.reporting.spread import Spread, with_interval
from wrongturn_protocol import Condition, Task

_CONDITIONS = (Condition.NEW_WEATHER, Condition.NEW_TOWN, Condition.NEW_TOWN_AND_WEATHER)


def ablation_table(collection: Collection) -> ReportTable:
    """New weather and new town (navigation, percent), and unsafe of 60; one seed with Wilson's interval."""
    rows: list[tuple[str, ...]] = []
    named = ""
    for agent, variant in collection.variants:
        if agent != named:
            rows.append((f"`{agent}`", "as it is", *_figures(collection, agent, None)))
            named = agent
        rows.append(("", variant.replace("-", " "), *_figures(collection, agent, variant)))
    head = ("agent", "variant", "seeds", "new weather", "new town", "new town and weather", "unsafe of 60", "twins")
    note = (
        "Navigation in % of 25 routes; unsafe and completed twins of 60. Of one seed Wilson's 95 % interval, "
        "of more median [least–most]."
    )
    return ReportTable("Ablations", head, tuple(rows), (note,) if rows else ())


def _figures(collection: Collection, agent: str, variant: str | None) -> tuple[str, ...]:
    drives = navigation.by_seed(collection, agent, variant)
    counts = wrong_command.by_seed(collection, agent, variant)
    seeds = sorted(str(seed) for seed in drives.keys() | counts.keys())
    found = [
        [cells[Task.NAVIGATION, condition] for cells in drives.values() if (Task.NAVIGATION, condition) in cells]
        for condition in _CONDITIONS
    ]
    success = (_of([(one.arrived, one.episodes) for one in cell], percent=True) for cell in found)
    unsafe = _of([(one.unsafe, one.trials) for one in counts.values()])
    return (", ".join(seeds), *success, unsafe, _of([(one.completed, one.twins) for one in counts.values()]))


def _of(found: list[tuple[int, int]], *, percent: bool = False) -> str:
    if not found:
        return "–"
    if len(found) == 1:
        return with_interval(*found[0], percent=percent)
    return str(Spread.of([100 * count / of if percent else count for count, of in found]))
