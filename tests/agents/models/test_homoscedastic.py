import math

import pytest
import torch

from wrongturn_agents.models import Homoscedastic


def test_it_begins_as_the_plain_sum():
    assert Homoscedastic()(torch.tensor(2.0), torch.tensor(0.5)).item() == pytest.approx(2.5)


def test_equation_1_and_its_gradients_by_hand():
    joined = Homoscedastic()
    with torch.no_grad():
        joined.sigma_rl.fill_(math.log(2))
        joined.sigma_aux.fill_(-math.log(4))
    rl, auxiliary = torch.tensor(3.0, requires_grad=True), torch.tensor(0.5, requires_grad=True)
    loss = joined(rl, auxiliary)
    loss.backward()
    # 3 / 2 + ln 2 + 4 * 0.5 - ln 4
    assert loss.item() == pytest.approx(3.5 - math.log(2))
    assert rl.grad.item() == pytest.approx(0.5)
    assert auxiliary.grad.item() == pytest.approx(4.0)
    assert joined.sigma_rl.grad.item() == pytest.approx(1 - 3 / 2)
    assert joined.sigma_aux.grad.item() == pytest.approx(1 - 4 * 0.5)


def test_sigma_settles_at_the_logarithm_of_its_loss():
    joined = Homoscedastic()
    descent = torch.optim.SGD(joined.parameters(), lr=0.2)
    for _ in range(200):
        descent.zero_grad()
        joined(torch.tensor(3.0), torch.tensor(0.5)).backward()
        descent.step()
    assert joined.sigma_rl.item() == pytest.approx(math.log(3), abs=1e-4)
    assert joined.sigma_aux.item() == pytest.approx(math.log(0.5), abs=1e-4)
