"""How long each training run took, how fast it went and where it ended."""

import math
from statistics import median

from wrongturn_agents.reporting.curves import Curve, plain
from wrongturn_agents.reporting.report_table import ReportTable


def training_table(curves: tuple[Curve, ...]) -> ReportTable:
    """A row for each run."""
    rows: list[tuple[str, ...]] = []
    named = ""
    for curve in curves:
        who = f"`{curve.agent}`" + (f", {curve.variant.replace('-', ' ')}" if curve.variant else "")
        speeds = curve.points("steps_per_second")[1]
        rows.append(
            (
                "" if who == named else who,
                str(curve.seed),
                f"{curve.last('step') / 1e6:.2f} M",
                _shown(curve.last("minutes"), "{:.1f}"),
                f"{median(speeds):,.0f}" if speeds else "–",
                _shown(curve.last("reward_mean"), "{:.1f}"),
                _shown(curve.last("success_heldout"), "{:.2f}"),
            ),
        )
        named = who
    head = ("agent", "seed", "steps", "minutes", "steps/s, median", "reward at the end", "held-out success at the end")
    return ReportTable("Training runs", head, tuple(rows))


def _shown(value: float, form: str) -> str:
    return "–" if math.isnan(value) else form.format(value)


def time_table(curves: tuple[Curve, ...]) -> ReportTable:
    """Where the time of an algorithm's runs went, in percent of all; of the algorithms as they are."""
    rows = []
    parts: list[str] = []
    spent = {agent: [run.seconds() for run in runs] for agent, runs in plain(curves).items()}
    for part in (part for runs in spent.values() for seconds in runs for part in seconds):
        if part not in parts:
            parts.append(part)
    for agent, runs in spent.items():
        whole = sum(sum(seconds.values()) for seconds in runs)
        if whole > 0:
            shares = (f"{100 * sum(seconds.get(part, 0.0) for seconds in runs) / whole:.0f}" for part in parts)
            rows.append((f"`{agent}`", *shares))
    return ReportTable("Where the time of training goes, in %", ("agent", *parts), tuple(rows), words=1)
