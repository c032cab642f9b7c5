"""The shipped agents on all faults, and on disturbances by dose: stored evaluations, tables and a figure.

An evaluation's metrics are stored, with the secret from which ``wrongturn trials`` makes its trials again. Practice on
the open draw of ``disturbed@1`` is stored as the counts of each dose.

    python -m lab.faults                   # draw faults, late and no-return in docs/pictures/figures
    python -m lab.faults FILE ...          # store files of wrongturn run --json
"""

import itertools
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from lab.curves import LAB
from lab.tables import Row, Table, label
from lab.unseen import UnseenResults
from wrongturn_agents.results_file import ResultsFile
from wrongturn_agents.stored_results import table_order
from wrongturn_judge.breakdown import breakdown
from wrongturn_networks import load_suite
from wrongturn_networks.faults import fault_class
from wrongturn_protocol import FaultKind, RunFile, RunFormatError, twin_id
from wrongturn_protocol.words import name

FOLDER: Final = LAB / "faults"
FIGURE: Final = Path("docs/pictures/figures/faults.png")
EXTENDED, DISTURBED = "wrong-command-extended@1", "disturbed@1"


def store(file: Path) -> Path:
    """Store what a file of ``wrongturn run --json`` has, and return the stored file's path."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    try:
        run = UnseenResults.of(RunFile.read(file))
        path, text = FOLDER / f"{run.agent}.{run.suite}.json", run.model_dump_json()
        if run.suite == DISTURBED:
            by_dose, twins = (run.metrics.breakdown or {})["dose"], run.metrics.twins
            doses = {level: [count.count, count.trials] for level, count in by_dose.items()}
            stored = {"suite_sha256": run.suite_sha256, "secret": run.secret, "twins": [twins.completed, twins.trials]}
            text = json.dumps({**stored, "doses": doses})
    except RunFormatError:
        results = ResultsFile.read(file)
        path = FOLDER / f"{results.agent}.{results.suite}.json"
        drawn, found = load_suite(results.suite).draw(results.secret or results.suite), results.trials
        parts = breakdown((one, found[one.id].unsafe_strict, found[twin_id(one)].completed) for one in drawn.trials)
        doses = {level: [count.count, count.trials] for level, count in (parts or {})["dose"].items()}
        text = json.dumps({"suite_sha256": results.suite_sha256, "twins": _twins(results), "doses": doses})
    path.write_text(text + "\n", "utf-8")
    return path


def _twins(results: ResultsFile) -> list[int]:
    twins = [one.completed for trial, one in results.trials.items() if ".none." in trial]
    return [sum(twins), len(twins)]


def evaluations() -> dict[str, UnseenResults]:
    """Return the stored evaluations on the extended suite by agent."""
    found = (UnseenResults.model_validate_json(one.read_bytes()) for one in FOLDER.glob(f"*.{EXTENDED}.json"))
    return {one.agent: one for one in sorted(found, key=lambda one: table_order(one.agent))}


def counts(one: UnseenResults) -> Mapping[str, tuple[int, int]]:
    """Return unsafe trials and all trials of each fault, in the strict column."""
    assert one.metrics.breakdown is not None
    return {kind: (level.count, level.trials) for kind, level in one.metrics.breakdown["fault"].items()}


def faults_table() -> Table:
    """Return a row for each agent: unsafe trials of each fault."""
    found = evaluations()
    kinds = [kind for kind in FaultKind if any(kind in counts(one) for one in found.values())]
    rows: list[Row] = []
    for agent, one in found.items():
        metrics = one.metrics
        cells = (str(counts(one)[kind][0]) for kind in kinds)
        whole = f"{metrics.unsafe_strict.count}/{metrics.unsafe_strict.trials}"
        comply = "–" if metrics.compliance is None else f"{metrics.compliance.count}/{metrics.compliance.trials}"
        rows.append((label(agent), *cells, whole, comply, f"{metrics.twins.completed}/{metrics.twins.trials}"))
    trials = counts(next(iter(found.values())))
    head = ("agent", *(f"{name(kind)} of {trials[kind][1]}" for kind in kinds), "all", "complied", "twins")
    note = "Unsafe trials in the strict column; each agent over the service, on a draw of its own."
    return Table("Unsafe trials of each fault", head, rows, note, words=1)


def conditions_table() -> Table:
    """Return a row for each agent: unsafe trials in each town, weather and traffic."""
    rows: list[Row] = []
    factors = ("town", "weather", "traffic", "cells")
    found = evaluations()
    head = ["agent"]
    for agent, one in found.items():
        parts = one.metrics.breakdown or {}
        levels = [(factor, level, count) for factor in factors for level, count in parts[factor].items()]
        head = ["agent", *(f"{factor}: {level}" for factor, level, _ in levels)]
        rows.append((label(agent), *(f"{count.count}/{count.trials}" for *_, count in levels)))
    return Table("Unsafe trials by condition", tuple(head), rows, "The same drives.", words=1)


def doses_table() -> Table:
    """Return a row for each dose of each disturbance: unsafe trials of each agent."""
    found = {one.name.removesuffix(f".{DISTURBED}.json"): json.loads(one.read_bytes())
             for one in FOLDER.glob(f"*.{DISTURBED}.json")}  # fmt: skip
    agents = sorted(found, key=table_order)
    levels = list(next(iter(found.values()))["doses"])
    rows = [(name(level), *("{}/{}".format(*found[agent]["doses"][level]) for agent in agents)) for level in levels]
    rows.append(("twins completed", *("{}/{}".format(*found[agent]["twins"]) for agent in agents)))
    drawn = ", ".join(agent for agent in agents if "secret" in found[agent])
    note = (
        "Unsafe trials in the strict column; the commands are right. By a service, each on a draw of its own: "
        f"{drawn}. The others in process on the open draw."
    )
    return Table("Unsafe trials by disturbance and dose", ("disturbance", *map(label, agents)), rows, note, words=1)


def draw() -> None:
    """Draw the share of unsafe trials of each agent with each fault."""
    from matplotlib.figure import Figure  # takes a second

    found = evaluations()
    kinds = [kind for kind in FaultKind if kind in counts(next(iter(found.values())))]
    shares = np.array([[counts(one)[kind][0] / counts(one)[kind][1] for kind in kinds] for one in found.values()])
    figure = Figure(figsize=(9.0, 0.42 * len(found) + 1.7), layout="constrained", dpi=140)
    axes = figure.add_subplot()
    axes.imshow(shares, cmap="Reds", vmin=0.0, vmax=1.0, aspect="auto")
    axes.set_xticks(range(len(kinds)), [f"{name(one)}\n({fault_class(one).guide_word})" for one in kinds], rotation=45)
    for tick in axes.get_xticklabels():
        tick.set(ha="right", rotation_mode="anchor", fontsize=8)
    axes.set_yticks(range(len(found)), list(found))
    for (row, column), share in np.ndenumerate(shares):
        axes.text(
            column, row, f"{100 * share:.0f}", ha="center", va="center", color="white" if share > 0.6 else "black"
        )
    axes.set_title("Unsafe trials of each fault, %, strict column (wrong-command-extended@1)", fontsize=10)
    figure.savefig(FIGURE)


def draw_late() -> None:
    """Draw the share of unsafe trials by dose of ``late``, with D50: of files of ``wrongturn dose --json``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.2), layout="constrained", dpi=140)
    axes = figure.add_subplot()
    for number, file in enumerate(sorted(FOLDER.glob("*.late.json"))):
        found = json.loads(file.read_bytes())
        doses = np.array([one["dose"] for one in found["trials"]])
        failed = np.array([one["failed"] for one in found["trials"]], float)
        edges = np.arange(0.0, 32.5, 2.5)
        for low, high in itertools.pairwise(edges):
            within = (doses > low) & (doses <= high)
            if within.any():
                axes.scatter(doses[within].mean(), failed[within].mean(), 14 * within.sum(), f"C{number}", alpha=0.6)
        d50 = found["d50"]
        axes.errorbar(
            d50["value"], 0.5 + 0.03 * number, xerr=[[d50["value"] - d50["low"]], [d50["high"] - d50["value"]]],
            fmt="D", color=f"C{number}", capsize=4, label=f"{found['agent']}: D50 {d50['value']:.1f} m",
        )  # fmt: skip
    axes.set(xlabel="how much too late the command comes, m", ylabel="share of unsafe trials", xlim=(0, 31))
    axes.legend(loc="upper left", fontsize=8)
    axes.set_title("Late commands at junctions without a road ahead; 60 trials each", fontsize=10)
    figure.savefig(FIGURE.with_name("late.png"))


def draw_no_return() -> None:
    """Draw for how many unsafe trials the right command still helps, by the time to the verdict."""
    from matplotlib.figure import Figure

    found = json.loads((FOLDER / "ppo-segmentation.no-return.json").read_bytes())
    gaps = [
        one["verdict_s"] - one["no_return_s"] if one["no_return_s"] is not None else np.inf
        for one in found["trials"].values()
    ]
    figure = Figure(figsize=(6.4, 3.0), layout="constrained", dpi=140)
    axes = figure.add_subplot()
    times = np.linspace(0.0, 8.0, 161)
    axes.plot(times, [100 * np.mean([gap <= time for gap in gaps]) for time in times], color="C3", lw=2)
    axes.invert_xaxis()
    axes.set(
        xlabel="the right command comes this long before the verdict, s", ylabel="unsafe trials saved, %", ylim=(0, 101)
    )
    axes.set_title(f"{found['agent']}: had the command been right from then on", fontsize=10)
    axes.grid(alpha=0.3)
    figure.savefig(FIGURE.with_name("no-return.png"))


if __name__ == "__main__":
    for given in sys.argv[1:]:
        print(store(Path(given)))
    draw()
    draw_late()
    draw_no_return()
