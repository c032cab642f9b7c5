import pytest
import torch

from wrongturn_marln.quantiles import NoisyBranches, QuantileHeads, draw_noise, quantile_huber


def slow_quantile_huber(found, wanted, shares, kappa):
    """Equations 2 and 3 of Dabney et al. (2018), one pair at a time."""
    total = 0.0
    for quantile, share in zip(found, shares, strict=True):
        for target in wanted:
            error = target - quantile
            huber = 0.5 * error**2 if abs(error) <= kappa else kappa * (abs(error) - 0.5 * kappa)
            total += abs(share - (1.0 if error < 0 else 0.0)) * huber / kappa
    return total / len(wanted)


@pytest.mark.parametrize("kappa", [1.0, 0.3])
def test_the_quantile_huber_loss_is_the_papers(kappa):
    torch.manual_seed(1)
    found, wanted, shares = 2 * torch.randn(5, 4), 2 * torch.randn(5, 3), torch.rand(5, 4)
    slow = [slow_quantile_huber(*(one[row].tolist() for one in (found, wanted, shares)), kappa) for row in range(5)]
    assert quantile_huber(found, wanted, shares, kappa).tolist() == pytest.approx(slow, rel=1e-5)


def test_streams_are_joined_as_in_a_dueling_network():
    heads = QuantileHeads(6, 5, hidden=8)
    features, command, shares = torch.randn(3, 6), torch.tensor([1, 2, 4]), torch.rand(3, 7)
    quantiles = heads(features, command, shares)
    assert quantiles.shape == (3, 7, 5)
    with torch.no_grad():
        heads.advantage.bias.add_(2.0)  # the same for all actions, which says nothing about their advantage
    assert torch.allclose(heads(features, command, shares), quantiles, atol=1e-5)
    with torch.no_grad():
        heads.value.bias.add_(2.0)
    assert torch.allclose(heads(features, command, shares), quantiles + 2.0, atol=1e-5)


def test_only_the_commanded_head_learns():
    heads = QuantileHeads(6, 5, hidden=8)
    command = torch.tensor([2, 2])
    heads(torch.randn(2, 6), command, torch.rand(2, 3), heads.draw_noise(2)).sum().backward()
    for layer in (heads.hidden, heads.value, heads.advantage):
        for weight in (layer.bias, layer.bias_deviation):
            touched = weight.grad.flatten(1).abs().sum(1) > 0
            # The advantages' common part cancels out, so a sum over actions is blind to them.
            assert touched.tolist() == [False, layer is not heads.advantage, False, False]


def test_noise_is_each_rows_own_and_factorised():
    layer = NoisyBranches(3, 2, 0.5)
    features, branch = torch.ones(1, 1, 3).expand(2, -1, -1), torch.tensor([1, 1])
    noise = draw_noise(2, layer.noise_width, torch.device("cpu"))
    found = layer(features, branch, noise)[:, 0]
    for row in range(2):
        of_inputs, of_outputs = noise[row, :3], noise[row, 3:]
        weight = layer.weight[1] + layer.weight_deviation[1] * torch.outer(of_inputs, of_outputs)
        bias = layer.bias[1, 0] + layer.bias_deviation[1, 0] * of_outputs
        assert torch.allclose(found[row], torch.ones(3) @ weight + bias, atol=1e-6)
    assert not torch.allclose(found[0], found[1])
    steady = layer(features, branch, None)
    assert torch.equal(steady[0], steady[1])


def test_noise_has_the_papers_distribution():
    """f(e) = sign(e) sqrt(|e|) has mean 0 and variance E|e| = sqrt(2 / pi)."""
    noise = draw_noise(100, 1000, torch.device("cpu"), torch.Generator().manual_seed(1))
    assert noise.mean().item() == pytest.approx(0.0, abs=0.02)
    assert noise.var().item() == pytest.approx((2 / torch.pi) ** 0.5, abs=0.02)
