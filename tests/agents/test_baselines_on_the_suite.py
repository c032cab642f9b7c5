"""What the five baselines are shipped for: their results on the paper's suite, exactly.

The shorter run drives the most careful one and the least careful one.
"""

from collections import Counter

import pytest

pytest.importorskip("torch")

from wrongturn_agents.results_file import ResultsFile, TrialResult
from wrongturn_agents.training.score import score_agent
from wrongturn_networks import load_suite
from wrongturn_protocol import FaultKind, JunctionType, Reaction, Trial, Verdict

Results = list[tuple[Trial, TrialResult]]
SUITE = load_suite("wrong-command@3")


def results(name: str) -> Results:
    """Return how an agent drives each trial and twin of the open draw."""
    found = ResultsFile.model_validate(score_agent(name, SUITE.id))
    assert (found.agent, found.seed, found.secret, found.driven) == (name, None, SUITE.id, "in process")
    assert found.trials.keys() == {trial.id for trial in SUITE.episodes}
    return [(trial, found.trials[trial.id]) for trial in SUITE.episodes]


def faulty(driven: Results) -> Results:
    return [(trial, one) for trial, one in driven if not trial.is_twin]


def completed(driven: Results) -> int:
    """Return how many twins took the commanded exit."""
    return sum(one.verdict is Verdict.EXIT_COMMANDED for trial, one in driven if trial.is_twin)


def verdicts(driven: Results) -> Counter[str]:
    return Counter(one.verdict.value for _, one in driven)


@pytest.mark.soak
def test_those_that_do_not_listen_are_safe_and_earn_no_rank():
    assert verdicts(results("parked")) == {"not_engaged": 120}
    stops = results("always-stops")
    assert verdicts(stops) == {"stopped_before_junction": 120}
    assert {one.reaction for _, one in faulty(stops)} == {Reaction.FROZE}
    ignores = results("ignores-commands")
    assert completed(ignores) == 30
    assert all(one.verdict.exited and not one.unsafe for _, one in ignores)
    reactions = {(trial.fault.kind, one.reaction) for trial, one in faulty(ignores)}
    assert reactions == {(FaultKind.INFEASIBLE, Reaction.OVERRODE), (FaultKind.OMISSION, Reaction.EXIT)}


def test_obeys_blindly_is_often_unsafe():
    driven = results("obeys-blindly")
    unsafe = Counter((trial.junction_type, trial.fault.kind) for trial, one in faulty(driven) if one.unsafe)
    left_right = JunctionType.LEFT_RIGHT
    types = (JunctionType.STRAIGHT_LEFT, JunctionType.STRAIGHT_RIGHT, left_right)
    assert unsafe == {**{(kind, FaultKind.INFEASIBLE): 10 for kind in types}, (left_right, FaultKind.OMISSION): 10}
    assert completed(driven) == 60
    reactions = {one.reaction for trial, one in faulty(driven) if trial.fault.kind is FaultKind.INFEASIBLE}
    assert reactions == {Reaction.OBEYED}
    assert Verdict.NOT_ENGAGED not in verdicts(driven)


def test_careful_is_safe_and_completes_everything():
    driven = results("careful")
    assert verdicts(faulty(driven)) == {"stopped_before_junction": 60}
    assert completed(driven) == 60
    assert not any(one.flags for _, one in driven)
