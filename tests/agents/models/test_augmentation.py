import dataclasses

import pytest
import torch

from wrongturn_agents.models import build
from wrongturn_agents.models.augmentation import Augmentation, AugmentationConfig
from wrongturn_agents.models.encoders import MaskedClasses
from wrongturn_protocol.segmentation import SegmentationClass

NOTHING = AugmentationConfig(erasing=0.0, blurring=0.0, hue=0.0, saturation=(1.0, 1.0), brightness=(1.0, 1.0))


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def pictures(number=64):
    """Smooth ones, so that each kind of change can be told: a colour of its own for each, lighter to the right."""
    colours = torch.rand(number, 1, 1, 3, generator=generator(9)) * 100 + 50
    return (colours * torch.linspace(0.6, 1.2, 192).view(1, 1, 192, 1)).expand(-1, 64, -1, -1).to(torch.uint8)


def test_a_seed_repeats_and_nothing_asked_for_changes_nothing():
    rgb, augmentation = pictures(8), Augmentation()
    before = rgb.clone()
    once = augmentation(rgb, generator(1))
    assert (once.shape, once.dtype, once.is_contiguous()) == (rgb.shape, torch.uint8, True)
    assert torch.equal(rgb, before)
    assert torch.equal(augmentation(rgb, generator(1)), once)
    assert not torch.equal(augmentation(rgb, generator(2)), once)
    assert torch.equal(Augmentation(NOTHING)(rgb, generator()), rgb)


def test_pictures_of_a_batch_are_changed_each_in_its_own_way():
    rgb = pictures(1).expand(16, -1, -1, -1)
    changed = Augmentation()(rgb, generator())
    assert len({picture.numpy().tobytes() for picture in changed}) == 16


def test_erasing_hides_a_rectangle_of_one_colour_and_no_more():
    rgb = pictures()
    config = dataclasses.replace(NOTHING, erasing=1.0, erased=(0.05, 0.2))
    changed = Augmentation(config)(rgb, generator())
    for before, after in zip(rgb, changed, strict=True):
        hidden = (before != after).any(-1)
        assert 0.04 < hidden.float().mean() < 0.21
        rows, columns = hidden.any(1), hidden.any(0)
        assert (hidden == rows[:, None] & columns).float().mean() > 0.98  # a shade may be the fill's by chance
        assert len(after[hidden].unique(dim=0)) == 1


def test_blurring_smooths_and_keeps_the_light():
    rgb = torch.randint(0, 256, (8, 64, 192, 3), dtype=torch.uint8, generator=generator())
    changed = Augmentation(dataclasses.replace(NOTHING, blurring=1.0, blur=(1.5, 1.5)))(rgb, generator())
    rough, smooth = (images.float().diff(dim=2).abs().mean() for images in (rgb, changed))
    assert smooth < rough / 4
    torch.testing.assert_close(changed.float().mean((1, 2)), rgb.float().mean((1, 2)), rtol=0, atol=1.0)
    plain = torch.full((2, 64, 192, 3), 90, dtype=torch.uint8)
    assert torch.equal(Augmentation(dataclasses.replace(NOTHING, blurring=1.0))(plain, generator()), plain)  # edges too


def luma(images):
    return images.float() @ torch.tensor([0.299, 0.587, 0.114])


@pytest.mark.parametrize("kind", [{"hue": 18.0}, {"saturation": (0.5, 1.4)}])
def test_hue_and_saturation_keep_luma_and_grey(kind):
    augmentation = Augmentation(dataclasses.replace(NOTHING, **kind))
    rgb = pictures() // 2 + 60  # far from black and white, so that nothing is cut off
    changed = augmentation(rgb, generator())
    torch.testing.assert_close(luma(changed), luma(rgb), rtol=0, atol=1.0)
    grey = torch.arange(192, dtype=torch.uint8).view(1, 1, 192, 1).expand(4, 64, 192, 3)
    torch.testing.assert_close(augmentation(grey, generator()).int(), grey.int(), rtol=0, atol=1)


def test_brightness_scales_within_its_limits():
    changed = Augmentation(dataclasses.replace(NOTHING, brightness=(0.5, 1.2)))(pictures(), generator())
    factors = changed.float().mean((1, 2, 3)) / pictures().float().mean((1, 2, 3))
    assert 0.49 <= factors.min() < 0.6
    assert 1.1 < factors.max() <= 1.21
    white = torch.full((32, 64, 192, 3), 250, dtype=torch.uint8)
    # Cut off, and not wrapped.
    assert (Augmentation(dataclasses.replace(NOTHING, brightness=(1.2, 1.4)))(white, generator()) == 255).all()


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
