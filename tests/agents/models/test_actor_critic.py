import math

import pytest
import torch

from wrongturn_agents.models import ALGORITHMS, Homoscedastic, build
from wrongturn_agents.models.actor_critic import controls


@pytest.fixture(scope="module", params=ALGORITHMS)
def model(request, small_networks):
    return build(request.param, seed=0).eval()


@pytest.fixture(scope="module")
def segmentation(small_networks):
    return build("ppo-segmentation", seed=0).eval()


def test_shapes_and_ranges(model, batch):
    observation = batch(3)
    features = model.features(observation)
    assert features.shape == (3, model.features_width)
    mean, value = model(features, observation["command"])
    torch.testing.assert_close(model.act(features, observation["command"]), mean)
    torch.testing.assert_close(model.value(features, observation["command"]), value)
    driven = model.drive(observation)
    assert driven.shape == (3, 3)
    torch.testing.assert_close(driven, controls(mean))


def test_accelerating_is_throttle_or_brake_and_all_is_clipped():
    wanted = [[-1.0, 0.5, 0.0], [0.25, 0.0, 0.75], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    action = torch.tensor([[-3.0, 0.5], [0.25, -0.75], [1.5, 1.5], [0.0, -9.0]])
    assert controls(action).tolist() == wanted


@pytest.mark.parametrize("key", ["speed", "steering", "command", "segmentation"])
def test_all_that_is_shown_matters(segmentation, batch, key):
    observation = batch(2, command=1)
    changed = {**observation, key: torch.full_like(observation[key], 2)}
    before, after = (
        segmentation.act(segmentation.features(shown), shown["command"]) for shown in (observation, changed)
    )
    assert (before != after).all()


def test_under_autocast_the_encoder_alone_takes_part(model, batch):
    observation = batch(2)
    exact = model(model.features(observation), observation["command"])
    with torch.autocast("cpu", torch.bfloat16):
        assert model.encode(observation).dtype == torch.bfloat16
        features = model.features(observation)
        assert features.dtype == torch.float32
        rough = model(features, observation["command"])
    for one, other in zip(rough, exact, strict=True):
        assert one.dtype == torch.float32
        torch.testing.assert_close(one, other, rtol=0.1, atol=0.1)


def test_an_observation_of_the_wrong_track_is_refused(model, batch):
    observation = batch(1)
    key = "segmentation" if model.algorithm == "ppo-segmentation" else "rgb"
    image = observation.pop(key)
    with pytest.raises(ValueError, match=f"{key}: not among the observation's .*use a track"):
        model.features(observation)
    with pytest.raises(ValueError, match=f"{key}: shape .*must be .B, 64, 192"):
        model.features({**observation, key: image[:, :32]})


def test_the_whole_agent_is_one_graph(model, batch):
    """Nothing in it sends the compiler back to Python, and it computes the same."""
    if model.algorithm == "ppo-image":
        pytest.skip("it drives by the same graph as ppo-auxiliary, which takes seconds")
    torch._dynamo.reset()
    whole = torch.compile(model.drive, backend="eager", fullgraph=True)
    torch.testing.assert_close(whole(batch(2)), model.drive(batch(2)))


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
