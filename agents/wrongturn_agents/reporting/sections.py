"""Everything that is made of the stored results, by the name of its section on a page."""

from functools import partial
from typing import Any

from wrongturn_agents.reporting import navigation, order, wrong_command
from wrongturn_agents.reporting.ablations import ablation_table
from wrongturn_agents.reporting.collection import Collection, describe
from wrongturn_agents.reporting.curve_picture import PICTURE
from wrongturn_agents.reporting.curves import Curve, plain
from wrongturn_agents.reporting.endings import endings_table
from wrongturn_agents.reporting.pages import Sections
from wrongturn_agents.reporting.report_table import ReportTable
from wrongturn_agents.reporting.training_table import time_table, training_table
from wrongturn_agents.suites import NAVIGATION, WRONG_COMMAND


def tables(collection: Collection, curves: tuple[Curve, ...]) -> dict[str, ReportTable]:
    """The tables by section, in the order in which the terminal shows them."""
    return {
        "navigation": navigation.navigation_table(collection),
        "tasks": navigation.tasks_table(collection),
        "clean": navigation.tasks_table(collection, clean=True),
        "wrong-command": wrong_command.wrong_command_table(collection),
        "seeds": wrong_command.seeds_table(collection),
        "endings": endings_table(collection),
        "ablations": ablation_table(collection),
        "training": training_table(curves),
        "time": time_table(curves),
    }


def sections(collection: Collection, curves: tuple[Curve, ...]) -> Sections:
    """What makes each section's Markdown."""
    made = {name: partial(_markdown, table) for name, table in tables(collection, curves).items()}
    order_text = partial(_order, collection)
    return {**made, "order": order_text, "curves": partial(_picture, curves), "missing": partial(_missing, collection)}


def lines_of_missing(collection: Collection) -> tuple[str, ...]:
    """What the tables lack, and where the two ways of driving disagree."""
    differing = (
        f"{describe(file)}: {number} of {len(file.trials)} verdicts differ from those over the service"
        for file, number in collection.differences()
        if number
    )
    return (*collection.missing((NAVIGATION, WRONG_COMMAND)), *differing)


def as_json(collection: Collection) -> dict[str, Any]:
    """All figures for a program."""
    return {
        "navigation": navigation.as_json(collection),
        "wrong_command": wrong_command.as_json(collection),
        "order": order.as_json(collection),
        "ablations": [
            {
                "agent": agent,
                "variant": variant,
                "unsafe_by_seed": {
                    str(seed): one.unsafe for seed, one in wrong_command.by_seed(collection, agent, variant).items()
                },
                "navigation_by_seed": {
                    str(seed): {f"{task}.{condition}": one.arrived for (task, condition), one in cells.items()}
                    for seed, cells in navigation.by_seed(collection, agent, variant).items()
                },
            }
            for agent, variant in collection.variants
        ],
        "missing": list(lines_of_missing(collection)),
    }


def _markdown(table: ReportTable) -> str:
    return table.markdown() if table.rows else "*Nothing is stored yet.*\n"


def _picture(curves: tuple[Curve, ...]) -> str:
    """For pages of ``docs/``."""
    if not plain(curves):
        return "*No learning curve is stored yet.*\n"
    return f"![Reward and held-out success of every seed over environment steps]({PICTURE.relative_to('docs')})\n"


def _order(collection: Collection) -> str:
    return order.order_in_words(order.unsafe_by_seed(collection)) + order.left_out(collection)


def _missing(collection: Collection) -> str:
    lines = lines_of_missing(collection)
    return "".join(f"- {line}\n" for line in lines) or "Nothing is missing.\n"
