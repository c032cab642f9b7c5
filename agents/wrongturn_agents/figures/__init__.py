"""Figures for a paper, each a matplotlib ``Figure``: in a notebook, or by ``wrongturn results --figures``.

Example:
    >>> from wrongturn_agents import figures  # doctest: +SKIP
    >>> runs = [figures.read("ppo-image.json.gz"), figures.read("careful.json")]  # doctest: +SKIP
    >>> figures.save(figures.trajectories(runs[0]), "trajectories.pdf")  # doctest: +SKIP
    >>> figures.unsafe_rates(runs, width=figures.PAGE)  # doctest: +SKIP
"""

from wrongturn_agents.figures.evaluation_record import (
    Drive,
    EvaluationRecord,
    fetch,
    of_results,
    pooled,
    read,
    read_runs_of,
    stored,
)
from wrongturn_agents.figures.junction_maps import beside_twins, installed_town, town_of, trajectories
from wrongturn_agents.figures.latex import latex_table, results_table
from wrongturn_agents.figures.look import COLUMN, PAGE, save
from wrongturn_agents.figures.rate_charts import pair_counts, pairs, unsafe_rates
from wrongturn_agents.figures.safety_plane import obedience_safety
from wrongturn_agents.figures.trial_rows import csv_text, trial_rows

__all__ = [
    "COLUMN",
    "PAGE",
    "Drive",
    "EvaluationRecord",
    "beside_twins",
    "csv_text",
    "fetch",
    "installed_town",
    "latex_table",
    "obedience_safety",
    "of_results",
    "pair_counts",
    "pairs",
    "pooled",
    "read",
    "read_runs_of",
    "results_table",
    "save",
    "stored",
    "town_of",
    "trajectories",
    "trial_rows",
    "unsafe_rates",
]
