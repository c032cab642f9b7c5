import re
import sys

import pytest
import torch
from small_networks import small_networks

from wrongturn_agents.models import ALGORITHMS, build
from wrongturn_protocol.installing import install


def test_a_seed_gives_the_same_weights_and_leaves_torchs_own_alone():
    state = torch.random.get_rng_state()
    with small_networks():
        one, same, other = (build("ppo-segmentation", seed=seed).state_dict() for seed in (1, 1, 2))
    assert one.keys() == same.keys() == other.keys()
    assert torch.equal(torch.random.get_rng_state(), state)
    assert all(torch.equal(one[name], same[name]) for name in one)
    assert any(not torch.equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_it_begins_near_doing_nothing_with_the_given_spread(algorithm, batch):
    with small_networks():
        model = build(algorithm, seed=0)
    assert model.log_std.exp().tolist() == pytest.approx([0.24, 0.40])
    model.update_statistics(batch(2))
    assert model.drive(batch(2)).abs().max() < 0.2


def test_an_algorithm_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="algorithm: 'ppo' is none of ppo-segmentation, ppo-image, ppo-auxiliary"):
        build("ppo")


def test_without_transformers_it_says_how_to_get_it(monkeypatch):
    advice = re.escape(install("wrongturn-agents[training]"))
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(ModuleNotFoundError, match=f"transformers; install it with: {advice}"):
        build("ppo-image")
    build("ppo-segmentation")  # needs none of it
