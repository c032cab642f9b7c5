import pytest
import torch
from torch import nn

from wrongturn_agents.training.held_out import Candidates, Evaluation


@pytest.fixture
def model():
    return nn.Sequential(nn.Linear(1, 1, bias=False))


def now(model, value):
    with torch.no_grad():
        model[0].weight.fill_(value)


def weight(candidate):
    return candidate.model[0].weight.item()


def told(success):
    return Evaluation(4, success, 0.0, 0.0)


def test_who_drove_best_is_remembered_as_it_was(model):
    candidates = Candidates(model)
    for value, reward in ((1.0, 10.0), (2.0, 30.0), (3.0, 20.0)):
        now(model, value)
        candidates.drove(reward, int(value))
    now(model, -9.0)  # a collapse
    chosen = candidates.to_judge(4, again=False)
    assert [weight(one) for one in chosen] == [-9.0, 2.0]
    assert [one.steps for one in chosen] == [4, 2]


def test_the_best_stays_what_it_was(model):
    candidates = Candidates(model)
    now(model, 1.0)
    candidates.judged(candidates.to_judge(1, again=False)[0], told(0.5))
    assert len(candidates.to_judge(1, again=True)) == 1  # one that is two of them drives once
    now(model, 2.0)
    candidates.drove(7.0, 2)
    now(model, 3.0)
    chosen = candidates.to_judge(3, again=True)
    assert [weight(one) for one in chosen] == [3.0, 2.0, 1.0]
    candidates.judged(chosen[1], told(0.75))
    candidates.promising = None
    for value in (4.0, 5.0, 6.0):  # the memory of those forgotten is used again
        now(model, value)
        candidates.drove(value, int(value))
    now(model, 7.0)
    assert (weight(candidates.best), candidates.best.steps, candidates.best.evaluation) == (2.0, 2, told(0.75))
    assert [weight(one) for one in candidates.to_judge(7, again=True)] == [7.0, 6.0, 2.0]
