"""The agents' architectures with few channels, for trainings of seconds."""

from functools import partial

import pytest

from wrongturn_agents.models import encoders
from wrongturn_agents.models.linknet import LinkNetDecoder
from wrongturn_agents.models.nature_cnn import NatureCNN
from wrongturn_agents.models.resnet import ResNet34

WIDTHS = (8, 8, 16, 16)


@pytest.fixture
def small_networks(monkeypatch):
    """Build all agents with few channels and one block in each stage."""
    deep = WIDTHS[-1] * 2 * 6
    monkeypatch.setattr(encoders, "NatureCNN", partial(NatureCNN, widths=(8, 16, 16)))
    monkeypatch.setattr(encoders, "ResNet34", partial(ResNet34, widths=WIDTHS, depths=(1, 1, 1, 1)))
    monkeypatch.setattr(encoders, "LinkNetDecoder", partial(LinkNetDecoder, widths=WIDTHS))
    monkeypatch.setattr(encoders, "_DEEP", deep)
    monkeypatch.setattr(encoders.PictureEncoder, "width", deep)
