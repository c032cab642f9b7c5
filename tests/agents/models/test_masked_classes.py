import torch

from wrongturn_agents.models import build
from wrongturn_agents.models.encoders import MaskedClasses
from wrongturn_protocol.segmentation import SegmentationClass

SKY, VOID = int(SegmentationClass.SKY), int(SegmentationClass.VOID)


def masked(segmentation, probability, seed=0):
    return MaskedClasses(probability)(segmentation, torch.Generator().manual_seed(seed))


def every_class(number):
    rows = torch.arange(64 * 192).view(64, 192) % 11
    return rows.to(torch.uint8).repeat(number, 1, 1)


def test_whole_classes_go_to_void_and_the_others_stay():
    before = every_class(200)
    after = masked(before, 0.3)
    hidden = torch.zeros(200, 11, dtype=torch.bool)
    for kind in range(11):
        of_it = after[:, before[0] == kind]
        assert ((of_it == kind).all(1) | (of_it == VOID).all(1)).all(), kind
        hidden[:, kind] = (of_it != kind).all(1)
    assert not hidden[:, [SKY, VOID]].any()
    assert 0.25 < hidden[:, 1:10].float().mean() < 0.35
    assert len({tuple(row.tolist()) for row in hidden}) > 50  # each picture its own
    assert torch.equal(masked(before, 0.3), after)
    assert set(masked(every_class(2), 1.0).unique().tolist()) == {VOID, SKY}


def test_without_it_nothing_is_hidden_and_driving_never_hides(batch):
    observation = batch(2)
    plain = build("ppo-segmentation", seed=0)
    assert torch.equal(plain.disturb(observation)["segmentation"], observation["segmentation"])
    model = build("ppo-segmentation", seed=0, masked_classes=1.0)
    torch.testing.assert_close(model.drive(observation), plain.drive(observation))
    assert not torch.allclose(model.features(model.disturb(observation)), plain.features(observation))
