import pytest
import torch

from wrongturn_agents.models.linknet import LinkNetDecoder


@pytest.fixture(scope="module")
def decoder():
    torch.manual_seed(0)
    return LinkNetDecoder().eval()


def features():
    draw = torch.Generator().manual_seed(0)
    sizes = [(256, 4, 12), (128, 8, 24), (64, 16, 48), (64, 16, 48)]
    return torch.randn(2, 512, 2, 6, generator=draw), [torch.randn(2, *size, generator=draw) for size in sizes]


@torch.no_grad()
def test_it_gives_logits_for_each_pixel_and_each_link_matters(decoder):
    deep, links = features()
    before = decoder(deep, links)
    assert decoder(deep).shape == before.shape == (2, 11, 64, 192)
    for number in range(4):
        changed = [link + (place == number) for place, link in enumerate(links)]
        assert not torch.allclose(decoder(deep, changed), before)
