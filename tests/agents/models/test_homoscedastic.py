import math

import pytest
import torch

from wrongturn_agents.models import Homoscedastic


def test_equation_1_and_its_gradients_by_hand():
    joined = Homoscedastic()
    assert joined(torch.tensor(2.0), torch.tensor(0.5)).item() == pytest.approx(2.5), "it begins as the plain sum"
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
