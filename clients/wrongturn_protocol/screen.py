"""A window on the desktop for the environments' render mode ``human``."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from wrongturn_protocol.suggestions import did_you_mean
from wrongturn_protocol.trial_options import OptionError

RENDER_MODES: Final = ("human", "rgb_array")
VECTOR_RENDER_MODES: Final = ("rgb_array",)
"""Render modes of the vector environments, which have no window."""
FRAMES_A_SECOND: Final = 10
"""Pictures a second of an environment that is watched: a decision takes 0.1 s."""


def check_render_mode(render_mode: str | None, modes: Sequence[str] = RENDER_MODES) -> None:
    """Raise OptionError unless the mode is None or one of those that an environment has."""
    if render_mode is not None and render_mode not in modes:
        raise OptionError(
            f"render_mode: {render_mode!r} is not known; take {' or '.join(modes)}, or leave it None"
            f"{did_you_mean(render_mode, modes)}"
        )


class Screen:
    """A window that shows pictures, ten a second. It opens with the first one.

    Raises:
        DependencyNotInstalled: pygame is missing.
    """

    def __init__(self) -> None:
        try:
            import pygame  # noqa: PLC0415 - an extra, which only this window needs
        except ImportError as error:
            raise DependencyNotInstalled(
                "render_mode: human needs pygame, which is missing: pip install 'wrongturn-client[human]'"
            ) from error
        self._pygame = pygame
        self._window: Any = None
        self._clock: Any = None

    def show(self, image: NDArray[np.uint8]) -> None:
        """Show a picture, RGB uint8 (height, width, 3), and wait until a tenth of a second after the one before."""
        pygame, size = self._pygame, (image.shape[1], image.shape[0])
        if self._window is None:
            pygame.display.init()  # not pygame.init(), which starts sound too
            pygame.display.set_caption("Wrongturn")
            self._window = pygame.display.set_mode(size)
            self._clock = pygame.time.Clock()
        self._window.blit(pygame.surfarray.make_surface(image.swapaxes(0, 1)), (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(FRAMES_A_SECOND)

    def close(self) -> None:
        """Close the window. Safe to call more than once."""
        if self._window is not None:
            self._pygame.display.quit()
            self._window = None
