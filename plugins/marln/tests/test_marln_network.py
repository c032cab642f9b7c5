import pytest
import torch

from wrongturn_marln.affordances import FARTHEST, Affordances
from wrongturn_marln.network import ACTIONS, MEMORY, Marln, disturb


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(1)
    return Marln(hidden=16, widths=(8, 8, 16, 16), depths=(1, 1, 1, 1)).eval()


def observation(rgb):
    count = len(rgb)
    return {
        "rgb": rgb,
        "speed": torch.full((count, 1), 5.0),
        "steering": torch.zeros(count, 1),
        "command": torch.full((count, 1), 4),
    }


def pictures(count, seed=1):
    generator = torch.Generator().manual_seed(seed)
    return torch.randint(0, 256, (count, 64, 192, 3), dtype=torch.uint8, generator=generator)


def test_the_first_picture_stands_for_those_before_it(model):
    shown = pictures(5)
    memory = model.begin(1)
    assert memory.shape == (1, MEMORY)
    seen = []
    encode = model.encode
    model.encode = lambda frames: seen.append(frames.byte()) or encode(frames)
    with torch.inference_mode():
        for k in range(5):
            _, memory = model.drive_on(observation(shown[k : k + 1]), memory)
    del model.encode
    for step, places in enumerate(([0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 2], [0, 1, 2, 3], [1, 2, 3, 4])):
        assert torch.equal(seen[step][0], shown[places])


def test_controls_are_one_of_the_actions(model):
    with torch.inference_mode():
        action, _ = model.drive_on(observation(pictures(6)), model.begin(6))
    for steer, throttle, brake in action.tolist():
        assert (steer, throttle - brake) in [pytest.approx(one, abs=1e-6) for one in ACTIONS]
        assert throttle * brake == 0.0


def test_the_affordances_loss_falls_and_counts_lanes_outside_junctions_only(model):
    torch.manual_seed(2)
    frames = pictures(4).unsqueeze(1).expand(-1, 4, -1, -1, -1)
    segmentation = torch.randint(0, 11, (4, 64, 192), dtype=torch.uint8)
    truth = Affordances(
        inside=torch.tensor([0.0, 1.0, 0.0, 1.0]),
        distance=torch.tensor([10.0, 0.0, FARTHEST, 0.0]),
        lateral=torch.tensor([0.4, 9.0, -0.3, -9.0]),
        angle=torch.tensor([0.1, 3.0, -0.1, -3.0]),
    )
    deep = model.see(frames).detach()
    loss = model.affordances.loss(deep, segmentation, truth)
    other = truth._replace(lateral=torch.tensor([0.4, 0.0, -0.3, 0.0]), angle=torch.tensor([0.1, 0.0, -0.1, 0.0]))
    assert model.affordances.loss(deep, segmentation, other).item() == pytest.approx(loss.item(), rel=1e-6)
    optimizer = torch.optim.Adam(model.affordances.told.parameters(), lr=3e-3)
    for _ in range(100):
        optimizer.zero_grad()
        model.affordances.loss(deep, segmentation, truth).backward()
        optimizer.step()
    told = model.affordances.tell(deep)
    assert ((told.inside > 0) == (truth.inside > 0.5)).all()
    assert told.distance.tolist() == pytest.approx(truth.distance.tolist(), abs=2.0)
    assert told.lateral[[0, 2]].tolist() == pytest.approx([0.4, -0.3], abs=0.1)


def test_a_stack_is_changed_alike(model):
    frames = pictures(3).unsqueeze(1).expand(-1, 4, -1, -1, -1)
    changed = disturb(model.augmentation, frames, torch.Generator().manual_seed(1))
    assert changed.shape == frames.shape
    assert not torch.equal(changed, frames)
    for k in range(1, 4):
        assert torch.equal(changed[:, k], changed[:, 0])
