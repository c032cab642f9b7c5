import pytest
import torch

from wrongturn_agents.models import build
from wrongturn_agents.models.linknet import LinkNetDecoder


@pytest.fixture(scope="module")
def auxiliary(small_networks):
    return build("ppo-auxiliary", seed=0)


@pytest.fixture(scope="module")
def image(small_networks):
    return build("ppo-image", seed=0)


@pytest.fixture(autouse=True)
def as_built(auxiliary, image):
    yield
    image.encoder.freeze()
    for model in (auxiliary, image):
        model.zero_grad(set_to_none=True)
        model.train()


def statistics(part):
    return {
        name: value.clone() for name, value in part.named_buffers() if name.endswith(("running_mean", "running_var"))
    }


def changed(part, before):
    return [name for name, value in statistics(part).items() if not torch.equal(value, before[name])]


def drive_backward(model, observation):
    mean, value = model(model.features(observation), observation["command"])
    ((mean - 0.3).square().mean() + (value - 1).square().mean()).backward()


def test_driving_teaches_the_shared_stages_and_its_own_alone(auxiliary, batch, gradient_norm):
    drive_backward(auxiliary, batch())
    encoder = auxiliary.encoder
    assert all(gradient_norm(part) > 0 for part in (encoder.network.stem, *encoder.network.stages))
    assert gradient_norm(encoder.segmenting) == 0
    assert gradient_norm(encoder.decoder) == 0


def test_segmentation_teaches_the_shared_stages_and_its_own_alone(auxiliary, batch, gradient_norm):
    auxiliary.segmentation_loss(batch()).backward()
    encoder = auxiliary.encoder
    assert all(gradient_norm(part) > 0 for part in (encoder.network.stem, *encoder.network.stages[:3]))
    assert gradient_norm(encoder.segmenting) > 0
    assert gradient_norm(encoder.decoder) > 0
    assert gradient_norm(encoder.network.stages[3]) == 0
    assert gradient_norm(encoder.projection) == 0
    assert gradient_norm(auxiliary.branches) == 0


def test_driving_never_changes_batch_normalisation(auxiliary, image, batch):
    for model in (auxiliary, image):
        model.train()
        before = statistics(model)
        drive_backward(model, batch())
        model.drive(batch())
        assert changed(model, before) == []


def test_segmentation_in_training_teaches_all_of_batch_normalisation(auxiliary, batch):
    before = statistics(auxiliary)
    with torch.no_grad():
        auxiliary.segmentation_logits(batch())
    assert changed(auxiliary, before) == list(before)  # the driving stage's too
    auxiliary.eval()
    before = statistics(auxiliary)
    auxiliary.segmentation_logits(batch())
    assert changed(auxiliary, before) == []


def test_statistics_can_be_taught_alone(auxiliary, batch):
    before = statistics(auxiliary.encoder.network)
    auxiliary.eval()
    auxiliary.update_statistics(batch())
    assert changed(auxiliary.encoder.network, before) == list(before)
    assert not any(module.training for module in auxiliary.modules())


def test_a_row_drives_the_same_alone_and_among_others(auxiliary, batch):
    observation = batch(3)
    alone = auxiliary.features({key: value[:1] for key, value in observation.items()})
    torch.testing.assert_close(auxiliary.features(observation)[:1], alone, rtol=1e-4, atol=1e-4)


def test_a_frozen_encoder_learns_nothing_and_the_rest_does(image, batch, gradient_norm):
    before = statistics(image.encoder.network)
    drive_backward(image, batch())
    image.segmentation_logits(batch())
    image.update_statistics(batch())
    assert gradient_norm(image.encoder.network) == 0
    assert changed(image.encoder.network, before) == []
    assert gradient_norm(image.encoder.projection) > 0
    assert gradient_norm(image.branches) > 0
    assert gradient_norm(image.measurements) > 0


def test_what_a_frozen_encoder_saw_can_be_kept(image, batch):
    observation = batch()
    kept = image.encode(observation)
    assert not kept.requires_grad
    rest = {key: observation[key] for key in ("speed", "steering")}
    torch.testing.assert_close(image.join(kept, rest), image.features(observation))


def test_unfrozen_it_learns_segmentation_and_driving(image, batch, gradient_norm):
    image.encoder.freeze(False)
    drive_backward(image, batch())
    assert gradient_norm(image.encoder.network) > 0
    image.zero_grad(set_to_none=True)
    before = statistics(image.encoder.network)
    image.segmentation_loss(batch()).backward()
    assert all(gradient_norm(part) > 0 for part in (image.encoder.network.stem, *image.encoder.network.stages))
    assert changed(image.encoder.network, before) == list(before)


@torch.no_grad()
def test_the_decoder_gives_logits_for_each_pixel_and_each_link_matters():
    torch.manual_seed(0)
    decoder = LinkNetDecoder().eval()
    sizes = [(256, 4, 12), (128, 8, 24), (64, 16, 48), (64, 16, 48)]
    deep, links = torch.randn(2, 512, 2, 6), [torch.randn(2, *size) for size in sizes]
    before = decoder(deep, links)
    assert decoder(deep).shape == before.shape == (2, 11, 64, 192)
    for number in range(4):
        changed = [link + (place == number) for place, link in enumerate(links)]
        assert not torch.allclose(decoder(deep, changed), before)
