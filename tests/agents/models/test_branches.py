import pytest
import torch

from wrongturn_agents.models.branches import COMMANDS, Branches
from wrongturn_protocol import Command


@pytest.fixture
def branches():
    torch.manual_seed(0)
    made = Branches(8, hidden=16)
    torch.nn.init.normal_(made.policy.weight)  # first means lie near 0; here they must tell branches apart
    return made


@pytest.mark.parametrize("command", COMMANDS)
def test_only_the_commanded_branch_learns(branches, command):
    mean, value = branches(torch.randn(5, 8), torch.full((5, 1), int(command)))
    (mean.square().sum() + value.square().sum()).backward()
    for name, parameter in branches.named_parameters():
        arrived = [bool(branch.abs().sum() > 0) for branch in parameter.grad]
        assert arrived == [other is command for other in COMMANDS], name


def test_a_mixed_batch_is_each_commands_own(branches):
    features = torch.randn(4, 8)
    mixed, values = branches(features, torch.tensor([[int(command)] for command in COMMANDS]))
    for i, command in enumerate(COMMANDS):
        mean, value = branches(features[i : i + 1], torch.tensor([[int(command)]]))
        torch.testing.assert_close(mixed[i : i + 1], mean)
        torch.testing.assert_close(values[i : i + 1], value)
    same = [branches.act(features[:1], torch.tensor([[int(command)]])) for command in COMMANDS]
    assert all(not torch.allclose(one, other) for i, one in enumerate(same) for other in same[:i])


@pytest.mark.parametrize("other", [int(Command.VOID), 0, 5])
def test_void_and_what_is_no_command_follow_the_lane(branches, other):
    features = torch.randn(3, 8)
    follow = branches(features, torch.full((3, 1), int(Command.LANE_FOLLOW)))
    for got, wanted in zip(branches(features, torch.full((3, 1), other)), follow, strict=True):
        torch.testing.assert_close(got, wanted, rtol=0, atol=0)


@pytest.mark.parametrize("activation", ["tanh", "elu"])
@pytest.mark.parametrize("command", COMMANDS)
def test_no_branch_is_ever_without_a_slope(activation, command):
    """Not even where steps too large have taken all of its units to where a ReLU is silent."""
    torch.manual_seed(0)
    features = torch.rand(64, 576)  # as what ends with ReLUs gives them
    dead = Branches(576, activation="relu")
    branches = Branches(576, activation=activation)
    for made in (dead, branches):
        with torch.no_grad():
            made.common.bias -= 6.0
            made.policy_hidden.bias -= 6.0
            made.value_hidden.bias -= 6.0
            torch.nn.init.normal_(made.policy.weight, std=0.1)
        mean, value = made(features, torch.full((64, 1), int(command)))
        (mean.square().sum() + value.square().sum()).backward()
    branch = COMMANDS.index(command)
    assert not dead.common.weight.grad[branch].any()
    assert not dead.policy_hidden.weight.grad[branch].any()
    for name, parameter in branches.named_parameters():
        assert parameter.grad[branch].abs().max() > 1e-7, name
