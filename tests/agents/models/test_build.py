import sys

import pytest
import torch
from small_networks import small_networks

from wrongturn_agents.models import ALGORITHMS, build
from wrongturn_agents.models.augmentation import AugmentationConfig


def parameters(part):
    return sum(parameter.numel() for parameter in part.parameters())


def test_the_segmentation_agent_has_about_three_million_parameters():
    assert parameters(build("ppo-segmentation")) == pytest.approx(3.0e6, rel=0.06)


def test_resnet_34_has_its_21_million_parameters():
    encoder = build("ppo-auxiliary").encoder
    assert parameters(encoder.network) == 21_284_672  # torchvision's, less the classes of ImageNet
    assert parameters(encoder.segmenting) == parameters(encoder.network.stages[3])


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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"algorithm": "ppo"}, "algorithm: 'ppo' is none of ppo-segmentation, ppo-image, ppo-auxiliary"),
        ({"algorithm": "ppo-image", "masked_classes": 0.1}, "masked_classes: ppo-image is given no segmentation"),
        ({"algorithm": "ppo-auxiliary", "frozen": True}, "frozen: ppo-auxiliary has no pretrained encoder"),
        ({"algorithm": "ppo-segmentation", "augmentation": AugmentationConfig()}, "augmentation: ppo-segmentation"),
    ],
)
def test_what_an_algorithm_does_not_have_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        build(**arguments)


def test_without_transformers_it_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(ModuleNotFoundError, match=r"transformers; install it with: .*'wrongturn-agents\[training\]'"):
        build("ppo-image")
    build("ppo-segmentation")  # needs none of it
