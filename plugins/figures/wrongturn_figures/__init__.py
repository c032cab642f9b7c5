"""Figures for a paper, each a matplotlib ``Figure``: in a notebook, or by ``wrongturn results --figures``.

Example:
    >>> import wrongturn_figures as figures  # doctest: +SKIP
    >>> runs = [figures.read("ppo-image.json.gz"), figures.read("careful.json")]  # doctest: +SKIP
    >>> figures.save(figures.trajectories(runs[0]), "trajectories.pdf")  # doctest: +SKIP
    >>> figures.unsafe_rates(runs, width=figures.PAGE)  # doctest: +SKIP
"""

from wrongturn_agents.records import (
    EvaluationRecord,
    csv_text,
    fetch,
    latex_table,
    pooled,
    read,
    read_runs_of,
    results_table,
    stored,
    trial_rows,
)
from wrongturn_figures.junction_maps import beside_twins, installed_town, town_of, trajectories
from wrongturn_figures.look import COLUMN, PAGE, save
from wrongturn_figures.rate_charts import pair_counts, pairs, unsafe_rates
from wrongturn_figures.safety_plane import obedience_safety

__all__ = [
    "COLUMN",
    "PAGE",
    "EvaluationRecord",
    "beside_twins",
    "csv_text",
    "fetch",
    "installed_town",
    "latex_table",
    "obedience_safety",
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
