"""Tables of the stored studies: how firm the figures are."""

from collections.abc import Sequence
from statistics import fmean, variance
from typing import Final

from lab.studies import DrawnAgent, Draws, JudgedAgent, Judgings
from lab.tables import ReportTable, Rows
from wrongturn_agents.paper import table_order
from wrongturn_agents.statistics import scipy_stats

_CELLS: Final = 10
"""Trials of one junction type and fault in a draw."""
_NOTHING: Final = "–"


def sensitivity_table(study: Judgings | None) -> ReportTable:
    """Return what other values of each threshold change, over all agents of a study."""
    agents = {} if study is None else study.agents
    rows = []
    factors: list[str] = []
    for threshold, found in next(iter(agents.values())).variants.items() if agents else ():
        factors = list(found)
        each = [_figures(agents, threshold, factor) for factor in factors]
        moved = "; ".join(f"at {factor} {one[0]}" for factor, one in zip(factors, each, strict=True) if one[0])
        figures = (" · ".join(column) for column in zip(*(one[1:] for one in each), strict=True))
        rows.append((f"`{threshold}`", moved or _NOTHING, *figures))
    head = ("threshold", "strict counts that change", "verdicts", "reactions", "unsafe", "Kendall's τ")
    note = (
        f"Each threshold times {' · '.join(factors)}. Agents on the open draw: {len(agents)}, with 120 verdicts and 60 "
        "trials each. The second column names each agent whose number of unsafe trials, strict, changes. The next "
        "three are sums over all agents: verdicts that differ, reactions that differ, and trials that become unsafe in "
        "the strict column or stop being so. Most verdicts that differ change no count: the other verdict is as safe, "
        "or it is a twin's. τ compares the agents' order by their strict counts with the published order; 1 is the "
        "same order."
    )
    return ReportTable("Other thresholds", head, tuple(rows), note if rows else "", text_columns=2)


def _figures(agents: dict[str, JudgedAgent], threshold: str, factor: str) -> tuple[str, ...]:
    """Return the agents whose strict count moves, how much flips over all agents, and the order that is left."""
    found = {agent: one.variants[threshold][factor] for agent, one in agents.items()}
    moved = [
        f"`{agent}` {agents[agent].strict} → {one.strict}"
        for agent, one in sorted(found.items(), key=lambda pair: table_order(pair[0]))
        if one.strict != agents[agent].strict
    ]
    counts = ("verdicts", "reactions", "unsafe")
    return (
        ", ".join(moved),
        *(str(sum(getattr(one, name) for one in found.values())) for name in counts),
        _tau([agents[agent].strict for agent in found], [one.strict for one in found.values()]),
    )


def _tau(published: Sequence[int], other: Sequence[int]) -> str:
    if len(set(published)) < 2 or len(set(other)) < 2:
        return _NOTHING  # agents that are all alike have no order
    tau = float(scipy_stats().kendalltau(published, other).statistic)
    return f"{tau:.2f}"


def draws_table(study: Draws | None) -> ReportTable:
    """Return the agents' strict counts on several draws, and whether they vary as binomial noise does."""
    agents = {} if study is None else study.agents
    rows: Rows = []
    for name in sorted(agents, key=table_order):
        rows.append((f"`{name}`", *_spread_of_draws(agents[name])))
    head = ("agent", "unsafe of 60, strict, by draw", "mean", "variance", "binomial", "ratio", "p")
    note = (
        "The secrets of the draws are `draw 0`, `draw 1` and so on. Binomial is the variance that 6 groups of 10 "
        "independent trials would have, with each group's mean rate. p is from the two-sided χ² test of dispersion; "
        "a small one says that the counts vary more, or less, than binomial noise."
    )
    return ReportTable("Counts over draws", head, tuple(rows), note if rows else "")


def _spread_of_draws(agent: DrawnAgent) -> tuple[str, ...]:
    draws = list(agent.draws.values())
    groups = [[one[kind][fault] for one in draws] for kind, faults in draws[0].items() for fault in faults]
    counts = [sum(column) for column in zip(*groups, strict=True)]
    rates = [fmean(group) / _CELLS for group in groups]
    binomial = sum(_CELLS * rate * (1 - rate) for rate in rates)
    found = variance(counts)
    test = (_NOTHING, _NOTHING)
    if binomial > 0:
        chi2 = scipy_stats().chi2(len(counts) - 1)
        statistic = (len(counts) - 1) * found / binomial
        p = min(1.0, 2 * float(min(chi2.cdf(statistic), chi2.sf(statistic))))
        test = (f"{found / binomial:.2f}", f"{p:.2g}")
    listed = ", ".join(map(str, counts))
    return (listed, f"{fmean(counts):.1f}", f"{found:.1f}", f"{binomial:.1f}", *test)
