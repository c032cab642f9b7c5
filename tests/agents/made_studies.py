"""Makes studies of thresholds, versions and draws, as ``wrongturn results`` stores them."""

from wrongturn_agents.reporting.studies import DrawnAgent, Draws, JudgedAgent, Judgings, Move, Variant
from wrongturn_networks import load_suite
from wrongturn_protocol import PAPER_TYPES, FaultKind, Verdict

SUITE = "wrong-command@2"
HEAD = {"suite": SUITE, "suite_sha256": load_suite(SUITE).sha256, "thresholds": 2}


def judged(strict: int, *, larger: int, moves: tuple[Move, ...] = ()) -> JudgedAgent:
    """Return an agent with some unsafe trials, and as many as ``larger`` at 1.2 times ``wait_time``."""
    same = Variant(verdicts=0, reactions=0, unsafe=0, strict=strict)
    moved = Variant(verdicts=9, reactions=4, unsafe=abs(larger - strict), strict=larger)
    return JudgedAgent(
        weights_sha256=None,
        strict=strict,
        variants={"wait_time": {"0.8": same, "1.2": moved}},
        moves={SUITE: moves},
    )


def move(before: Verdict, after: Verdict, episodes: int, *, strict: tuple[bool, bool] = (False, False)) -> Move:
    """Return episodes that two versions of the judge end as given."""
    return Move(before=before, after=after, strict_before=strict[0], strict_after=strict[1], episodes=episodes)


def judgings(**agents: JudgedAgent) -> Judgings:
    """Return a study of thresholds and versions."""
    return Judgings(**HEAD, agents=agents)


def drawn(*counts: int) -> DrawnAgent:
    """Return an agent on as many draws as counts, each in the cells from the first on, ten at most in each."""
    return DrawnAgent(
        weights_sha256=None,
        draws={f"draw {number}": _draw(count) for number, count in enumerate(counts)},
    )


def draws(**agents: DrawnAgent) -> Draws:
    """Return a study of draws."""
    return Draws(**HEAD, agents=agents)


def _draw(count: int) -> dict:
    strict: dict = {}
    for kind in PAPER_TYPES:
        for fault in (FaultKind.INFEASIBLE, FaultKind.OMISSION):
            strict.setdefault(kind, {})[fault] = min(count, 10)
            count -= min(count, 10)
    return strict
