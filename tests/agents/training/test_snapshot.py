import torch
from torch import nn

from wrongturn_agents.training.methods.ppo.snapshot import Snapshot


def step(module, optimizer, which=0):
    optimizer.zero_grad(set_to_none=True)
    module[which](torch.randn(4, 3)).square().sum().backward()
    optimizer.step()


def state(module, optimizer):
    kept = {name: tensor.clone() for name, tensor in module.state_dict().items()}
    moments = [
        value.clone() for values in optimizer.state.values() for value in values.values() if torch.is_tensor(value)
    ]
    return kept, moments


def equal(one, other):
    return (
        all(torch.equal(one[0][name], tensor) for name, tensor in other[0].items())
        and len(one[1]) == len(other[1])
        and all(torch.equal(first, second) for first, second in zip(one[1], other[1], strict=True))
    )


def test_weights_statistics_and_moments_come_back():
    torch.manual_seed(0)
    module = nn.ModuleList([nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4), nn.Linear(4, 1)), nn.Linear(3, 1)])
    optimizer = torch.optim.Adam(module.parameters(), lr=0.1)
    snapshot = Snapshot(module, optimizer)
    for part in (0, 0, 1):  # the second part's moments begin after a snapshot that lacks them
        before = state(module, optimizer)
        snapshot.take()
        step(module, optimizer, part)
        step(module, optimizer, part)
        after = state(module, optimizer)
        assert not equal(before, after)
        snapshot.restore()
        assert equal(before, state(module, optimizer))
        step(module, optimizer, part)
