"""A suite of the paper's shape, made by hand, and outcomes for it."""

import itertools
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from wrongturn_judge import RankingInput, compute
from wrongturn_protocol import (
    PAPER_TYPES,
    AgentDetail,
    AgentKind,
    Entry,
    Fault,
    FaultKind,
    JunctionType,
    Outcome,
    Start,
    Track,
    Trial,
    Verdict,
    trial_id,
    twin_id,
)

sys.path.insert(0, str(Path(__file__).parent))  # the helpers beside these tests are imported by their plain names


@dataclass(frozen=True)
class HandMadeSuite:
    """The little that metrics and ranking read of a suite."""

    id: str
    trials: tuple[Trial, ...]


def make_trial(junction_type: JunctionType, fault: FaultKind, number: int, seed: int) -> Trial:
    """Three approaches a junction, one of each type: type ``k`` enters junction J<number> by its arm ``k``."""
    approach = f"J{number + 1}-{'NSW'[list(JunctionType).index(junction_type) % 3]}"
    return Trial(
        id=trial_id("Town01", approach, Fault(kind=fault), seed),
        town="Town01",
        approach=approach,
        junction_type=junction_type,
        route=min(junction_type.exits),
        start=Start(distance=25.0, speed=6.0, lateral=0.0, yaw=0.0),
        fault=Fault(kind=fault),
        seed=seed,
    )


def make_suite(per_cell: int = 10, types: tuple[JunctionType, ...] = PAPER_TYPES, first_seed: int = 0) -> HandMadeSuite:
    cells = itertools.product(types, (FaultKind.INFEASIBLE, FaultKind.OMISSION), range(per_cell))
    trials = tuple(
        make_trial(kind, fault, number, seed) for seed, (kind, fault, number) in enumerate(cells, first_seed)
    )
    return HandMadeSuite(id="wrong-command@3", trials=trials)


def outcome(verdict: Verdict, **rest: object) -> Outcome:
    return Outcome.model_validate({"verdict": verdict, "time": 5.0, "max_deceleration": 1.0, **rest})


Outcomes = dict[str, Outcome]


def outcomes_of(
    suite: HandMadeSuite, trials: Mapping[int, Verdict] | None = None, twins: Mapping[int, Verdict] | None = None
) -> Outcomes:
    """Perfect drives but for the verdicts given by the trial's place in the suite."""
    result: Outcomes = {}
    for place, trial in enumerate(suite.trials):
        result[trial.id] = outcome((trials or {}).get(place, Verdict.EXIT_OTHER))
        result[twin_id(trial)] = outcome((twins or {}).get(place, Verdict.EXIT_COMMANDED))
    return result


def row(
    suite: HandMadeSuite, name: str, outcomes: Outcomes, track: Track = Track.CAMERA, owner: str = ""
) -> RankingInput:
    return RankingInput(
        agent=AgentDetail(id=f"agent-{name}", name=name, track=track, kind=AgentKind.SUBMITTED, owner=owner),
        evaluation=f"evaluation-{name}",
        entry=Entry.REMOTE,
        metrics=compute(suite, outcomes),
    )


@pytest.fixture(scope="session")
def kit() -> SimpleNamespace:
    """The makers above: modules collected by importlib cannot import one another."""
    return SimpleNamespace(make_suite=make_suite, outcome=outcome, outcomes_of=outcomes_of, row=row)


@pytest.fixture(scope="session")
def suite() -> HandMadeSuite:
    return make_suite()
