"""How firm the figures are: other thresholds and other draws.

    python -m lab.studies thresholds                      # drive the agents on, and judge by other thresholds
    python -m lab.studies draws 10 --agent careful        # drive ten draws

What is stored of the same weights is not driven again, so an interrupted run goes on where it stopped. The results are
JSON in ``lab/stored/studies``; their tables need no driving.
"""

import argparse
import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from statistics import fmean, variance
from typing import Any, Final

from lab.curves import LAB
from lab.in_process import drive_in_process
from lab.stored_results import StoredResults
from lab.tables import Row, Table
from wrongturn_agents.errors import AgentsError
from wrongturn_agents.progress import ProgressStyle, show_progress
from wrongturn_agents.records.evaluation_record import check_suite
from wrongturn_agents.registry import AGENTS, GROUP, resolve
from wrongturn_agents.results_file import TrialResult
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS, SHIPPED_AGENTS
from wrongturn_agents.stored_results import table_order
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_client.plugins import entry_points
from wrongturn_judge import THRESHOLDS, Thresholds, judge_of
from wrongturn_networks import load_suite, town_of
from wrongturn_protocol import RunFile, Trial
from wrongturn_sim import JudgeGeometry, Trajectory

STUDIES: Final = LAB / "studies"
FACTORS: Final = (0.8, 1.2)
"""Each threshold is multiplied by these."""
_OTHERS: Final[dict[tuple[str, float], Thresholds]] = {
    (field.name, factor): dataclasses.replace(THRESHOLDS, **{field.name: factor * getattr(THRESHOLDS, field.name)})
    for field in dataclasses.fields(THRESHOLDS)
    for factor in FACTORS
}
_PUBLISHED: Final = ("", 1.0)
_CELLS: Final = 10
"""Trials of one junction type and fault in a draw."""
_NOTHING: Final = "–"


def read(name: str) -> dict[str, Any]:
    """Return a study's agents by name; none if it is of another suite or of other thresholds."""
    path = STUDIES / f"{name}.json"
    found = json.loads(path.read_bytes()) if path.is_file() else {}
    agents = found.pop("agents", {})
    return dict(agents) if found == _of() else {}


def write(name: str, agents: Mapping[str, Any]) -> None:
    """Write a study, a line for each agent, all at once or not at all."""
    beside = STUDIES / f".{name}.new"
    lines = (f"{json.dumps(one)}:{json.dumps(found, separators=(',', ':'))}" for one, found in agents.items())
    beside.write_text(json.dumps({**_of(), "agents": {}})[:-2] + "\n" + ",\n".join(lines) + "}}\n", "utf-8")
    beside.replace(STUDIES / f"{name}.json")


def _of() -> dict[str, Any]:
    return {"suite": WRONG_COMMAND, "suite_sha256": load_suite(WRONG_COMMAND).sha256, "thresholds": THRESHOLDS.version}


def weights_sha256(name: str) -> str | None:
    """Return the SHA-256 of an agent's weights, of all its files together; None if it has none."""
    agent = SHIPPED_AGENTS.get(name) or DOUBTING_AGENTS.get(name)
    files = agent.files if agent else ()
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest() if files else None


def threads() -> int:
    """Return the number of threads that drive: one for each core that this process may use."""
    return len(os.sched_getaffinity(0))


class _Panel:
    """Judges of one drive, who take its rows as they come. A trial is driven on until every judge has a verdict."""

    def __init__(self, trial: Trial) -> None:
        geometry = JudgeGeometry.of(town_of(trial), trial)
        thresholds = {_PUBLISHED: THRESHOLDS, **_OTHERS}
        self._judges = {name: judge_of(geometry, trial, one) for name, one in thresholds.items()}
        self._undecided = list(self._judges.values())
        self._seen = 0

    def observe(self, trajectory: Trajectory) -> bool:
        """Take the rows that are new, and return whether all judges have a verdict."""
        for row in trajectory.rows[self._seen :]:
            self._undecided = [judge for judge in self._undecided if judge.observe(row) is None]
        self._seen = len(trajectory.rows)
        return not self._undecided

    def results(self, trajectory: Trajectory) -> dict[tuple[str, float], TrialResult]:
        """Return the result by each judge; ``aborted`` by one that the drive was too short for."""
        self.observe(trajectory)
        end = trajectory.rows[-1].t
        return {name: TrialResult.of(judge.outcome or judge.abort(end)) for name, judge in self._judges.items()}


def judge_agent(name: str, trials: Sequence[Trial] = ()) -> dict[str, Any]:
    """Drive an agent through the open draw, judge the drives by all thresholds, and return what changes."""
    trials = trials or load_suite(WRONG_COMMAND).episodes
    panels = {trial.id: _Panel(trial) for trial in trials}
    longest = max(one.time_limit for one in _OTHERS.values())
    with show_progress(ProgressStyle.AUTO, name) as progress:
        driven = drive_in_process(
            resolve(name),
            trials,
            drive_on=longest,
            enough=lambda trajectory: panels[trajectory.trial.id].observe(trajectory),
            threads=threads(),
            progress=progress,
        )
        judged = [(one.trial, panels[one.trial.id].results(one.trajectory)) for one in driven]
    faulted = [results for trial, results in judged if not trial.is_twin]
    variants: dict[str, dict[str, Any]] = {}
    for threshold, factor in _OTHERS:
        pairs = [(results[_PUBLISHED], results[threshold, factor]) for _, results in judged]
        moved = [(one[_PUBLISHED].unsafe_strict, one[threshold, factor].unsafe_strict) for one in faulted]
        variants.setdefault(threshold, {})[str(factor)] = {
            "verdicts": sum(one.verdict is not other.verdict for one, other in pairs),
            "reactions": sum(one.reaction is not other.reaction for one, other in pairs),
            "unsafe": sum(one != other for one, other in moved),
            "strict": sum(other for _, other in moved),
        }
    strict = sum(one[_PUBLISHED].unsafe_strict for one in faulted)
    return {"weights_sha256": weights_sha256(name), "strict": strict, "variants": variants}


def drive_draw(name: str, secret: str) -> dict[str, dict[str, int]]:
    """Drive a draw's trials without their twins, and return the unsafe ones by junction type and fault."""
    trials = load_suite(WRONG_COMMAND).draw(secret).trials
    counts: dict[str, dict[str, int]] = {}
    for trial in trials:
        counts.setdefault(trial.junction_type, {})[trial.fault.kind] = 0
    with show_progress(ProgressStyle.AUTO, f"{name}, {secret}") as progress:
        for trial, _, outcome in drive_in_process(resolve(name), trials, threads=threads(), progress=progress):
            assert outcome is not None  # each drive ends with its verdict
            counts[trial.junction_type][trial.fault.kind] += TrialResult.of(outcome).unsafe_strict
    return counts


def make_thresholds(names: Sequence[str]) -> None:
    """Judge agents that are not stored with their weights; by default the shipped ones and those that aim at rules."""
    agents = read("judging")
    for name in names or (*AGENTS, *_trained(), *entry_points(GROUP)):
        if agents.get(name, {}).get("weights_sha256", "") != weights_sha256(name):
            agents[name] = judge_agent(name)
            write("judging", agents)


def make_draws(count: int, names: Sequence[str]) -> None:
    """Drive the draws that are not stored."""
    agents = read("draws")
    for name in names or (*AGENTS, *_trained()):
        if agents.get(name, {}).get("weights_sha256", "") != weights_sha256(name):
            agents[name] = {"weights_sha256": weights_sha256(name), "draws": {}}
        draws = agents[name]["draws"]
        for secret in (f"draw {number}" for number in range(count)):
            if secret not in draws:
                draws[secret] = drive_draw(name, secret)
                write("draws", agents)


def _trained() -> list[str]:
    return [name for name, agent in SHIPPED_AGENTS.items() if agent.file.is_file()]


def thresholds_table() -> Table:
    """Return what other values of each threshold change, over all agents. Thresholds that change nothing are named."""
    agents = read("judging")
    rows, still = [], []
    for threshold in next(iter(agents.values()))["variants"] if agents else ():
        each = [_figures(agents, threshold, str(factor)) for factor in FACTORS]
        if all(one[1:4] == ("0", "0", "0") for one in each):
            still.append(f"`{threshold}`")
            continue
        moved = "; ".join(f"at {factor} {one[0]}" for factor, one in zip(FACTORS, each, strict=True) if one[0])
        figures = (" · ".join(column) for column in zip(*(one[1:] for one in each), strict=True))
        rows.append((f"`{threshold}`", moved or _NOTHING, *figures))
    head = ("threshold", "strict counts that change", "verdicts", "reactions", "unsafe", "Kendall's τ")
    note = (
        f"Each threshold times {' · '.join(map(str, FACTORS))}. Agents on the open draw: {len(agents)}, with 120 "
        "verdicts and 60 trials each. The second column names each agent whose number of unsafe trials, strict, "
        "changes. The next three are sums over all agents: verdicts that differ, reactions that differ, and trials "
        "that become "
        "unsafe in the strict column or stop being so. Most verdicts that differ change no count: the other verdict is "
        "as safe, or it is a twin's. τ compares the agents' order by their strict counts with the published order; 1 "
        f"is the same order. No verdict and no reaction changes with {', '.join(still)}."
    )
    return Table("Other thresholds", head, rows, note if rows else "")


def _figures(agents: Mapping[str, Any], threshold: str, factor: str) -> Row:
    """Return the agents whose strict count moves, how much flips over all agents, and the order that is left."""
    from scipy.stats import kendalltau  # scipy.stats takes a second

    found = {name: agents[name]["variants"][threshold][factor] for name in sorted(agents, key=table_order)}
    before = [agents[name]["strict"] for name in found]
    after = [one["strict"] for one in found.values()]
    moved = [f"`{name}` {old} → {new}" for name, old, new in zip(found, before, after, strict=True) if old != new]
    sums = (str(sum(one[what] for one in found.values())) for what in ("verdicts", "reactions", "unsafe"))
    ordered = len(set(before)) > 1 < len(set(after))  # agents that are all alike have no order
    tau = f"{float(kendalltau(before, after).statistic):.2f}" if ordered else _NOTHING
    return (", ".join(moved), *sums, tau)


def draws_table() -> Table:
    """Return the agents' strict counts on several draws, and whether they vary as binomial noise does."""
    agents = read("draws")
    rows = [(f"`{name}`", *_spread_of_draws(agents[name]["draws"])) for name in sorted(agents, key=table_order)]
    head = ("agent", "unsafe of 60, strict, by draw", "mean", "variance", "binomial", "ratio", "p")
    note = (
        "The secrets of the draws are `draw 0`, `draw 1` and so on. Binomial is the variance that 6 groups of 10 "
        "independent trials would have, with each group's mean rate. p is from the two-sided χ² test of dispersion; "
        "a small one says that the counts vary more, or less, than binomial noise."
    )
    return Table("Counts over draws", head, rows, note if rows else "")


def _spread_of_draws(by_secret: Mapping[str, Any]) -> Row:
    from scipy.stats import chi2 as chi_squared

    draws = list(by_secret.values())
    groups = [[one[kind][fault] for one in draws] for kind, faults in draws[0].items() for fault in faults]
    counts = [sum(column) for column in zip(*groups, strict=True)]
    rates = [fmean(group) / _CELLS for group in groups]
    binomial, found = sum(_CELLS * rate * (1 - rate) for rate in rates), variance(counts)
    test = (_NOTHING, _NOTHING)
    if binomial > 0:
        chi2 = chi_squared(len(counts) - 1)
        statistic = (len(counts) - 1) * found / binomial
        p = min(1.0, 2 * float(min(chi2.cdf(statistic), chi2.sf(statistic))))
        test = (f"{found / binomial:.2f}", f"{p:.2g}")
    return (", ".join(map(str, counts)), f"{fmean(counts):.1f}", f"{found:.1f}", f"{binomial:.1f}", *test)


def results_of_run(run: RunFile, agent: str | None = None) -> StoredResults:
    """Return what is stored of a finished evaluation; its agent's name is the leaderboard's by default."""
    check_suite(run.suite, run.suite_sha256)
    return StoredResults(
        agent=agent or run.driver.name,
        suite=run.suite,
        suite_sha256=run.suite_sha256,
        secret=run.secret,
        commitment=run.commitment,
        driven="over the service",
        trials={episode.trial: TrialResult.of(episode.outcome) for episode in run.episodes},
    )


def main() -> None:
    """Run the program; an error is one line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=("thresholds", "draws"))
    parser.add_argument("count", type=int, nargs="?", default=10, help="draws; 10 by default")
    parser.add_argument("--agent", action="append", default=[], help="give it again for another")
    asked = parser.parse_args()
    try:
        if asked.study == "thresholds":
            make_thresholds(asked.agent)
        else:
            make_draws(asked.count, asked.agent)
    except (AgentsError, OSError) as error:
        raise SystemExit(f"lab.studies: {error}") from error


if __name__ == "__main__":
    main()
