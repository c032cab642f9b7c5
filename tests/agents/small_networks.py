"""The paper's agents with few channels and one block in each stage: they are as quick as the tests need."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

import pytest

WIDTHS = (8, 8, 16, 16)


@contextmanager
def small_networks() -> Iterator[None]:
    """Build small networks within the block."""
    from wrongturn_agents.models import encoders
    from wrongturn_agents.models.linknet import LinkNetDecoder
    from wrongturn_agents.models.resnet import ResNet

    deep = WIDTHS[-1] * 2 * 6
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(encoders, "NatureCNN", partial(encoders.NatureCNN, widths=(8, 16, 16)))
        patch.setattr(encoders, "ResNet", lambda channels, _: ResNet(channels, (1, 1, 1, 1), WIDTHS))
        patch.setattr(encoders, "LinkNetDecoder", partial(LinkNetDecoder, widths=WIDTHS))
        patch.setattr(encoders, "_DEEP", deep)
        patch.setattr(encoders.PictureEncoder, "width", deep)
        yield
