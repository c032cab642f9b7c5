"""How long each training run took, how fast it went and where it ended."""

import math
from statistics import median

from wrongturn_agents.reporting.curves import Curve
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
                f"{median(speeds):,.0f}" if speeds else "–",  # noqa: RUF001
                _shown(curve.last("reward_mean"), "{:.1f}"),
                _shown(curve.last("success_heldout"), "{:.2f}"),
            ),
        )
        named = who
    head = ("agent", "seed", "steps", "minutes", "steps/s, median", "reward at the end", "held-out success at the end")
    return ReportTable("Training runs", head, tuple(rows))


def _shown(value: float, form: str) -> str:
    return "–" if math.isnan(value) else form.format(value)  # noqa: RUF001
