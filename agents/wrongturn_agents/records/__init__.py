"""Driven runs of agents on a suite: read from files, a service or the stored results; as tables and rows."""

from wrongturn_agents.records.evaluation_record import (
    EvaluationRecord,
    fetch,
    of_results,
    pooled,
    read,
    read_runs_of,
    stored,
)
from wrongturn_agents.records.latex import latex_table, results_table
from wrongturn_agents.records.trial_rows import csv_text, trial_rows

__all__ = [
    "EvaluationRecord",
    "csv_text",
    "fetch",
    "latex_table",
    "of_results",
    "pooled",
    "read",
    "read_runs_of",
    "results_table",
    "stored",
    "trial_rows",
]
