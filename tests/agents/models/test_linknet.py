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
def test_it_gives_logits_for_each_pixel_with_links_and_without(decoder):
    deep, links = features()
    assert decoder(deep).shape == decoder(deep, links).shape == (2, 11, 64, 192)
    assert not torch.allclose(decoder(deep), decoder(deep, links))


@torch.no_grad()
@pytest.mark.parametrize("number", range(4))
def test_each_link_matters(decoder, number):
    deep, links = features()
    before = decoder(deep, links)
    links[number] = links[number] + 1
    assert not torch.allclose(decoder(deep, links), before)


def test_it_learns_a_picture_of_two_halves(decoder):
    deep, _ = features()
    halves = torch.zeros(2, 64, 192, dtype=torch.long)
    halves[:, :, 96:] = 1
    decoder.train()
    descent = torch.optim.Adam(decoder.parameters(), lr=1e-2)
    losses = []
    for _ in range(12):
        descent.zero_grad()
        loss = torch.nn.functional.cross_entropy(decoder(deep), halves)
        loss.backward()
        descent.step()
        losses.append(loss.item())
    decoder.eval()
    assert losses[-1] < losses[0] / 2
