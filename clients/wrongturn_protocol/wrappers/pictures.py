"""Other pictures: grey, of another size, stacked over time, one plane for each class, or nothing but a picture.

Those that keep the ``Dict`` go before :class:`OnlyPicture`. After it, Gymnasium's own wrappers for pictures work too.
"""

from collections import deque
from typing import Any, Final, SupportsFloat, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import TransformObservation
from numpy.typing import NDArray

from wrongturn_protocol.installing import install
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.segmentation import SegmentationClass
from wrongturn_protocol.trial_options import whole_number

Picture = NDArray[np.uint8]
_KEYS: Final = ("rgb", "segmentation")
_LUMA: Final = np.array([299, 587, 114], np.uint32)
"""Weights of red, green and blue in thousandths (ITU-R BT.601)."""


class OnlyPicture(TransformObservation[Any, Any, Any], RecordConstructorArgs):
    """Show one picture and nothing else, for networks and code that take a ``Box``, such as ``CnnPolicy``.

    The agent does not see the command then, so it cannot know where to turn.

    Raises:
        ValueError: Observations have no such picture.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], key: str = "rgb") -> None:
        RecordConstructorArgs.__init__(self, key=key)
        TransformObservation.__init__(self, env, lambda seen: seen[key], _picture(env, self, key))


class GrayPicture(TransformObservation[Any, Any, Any], RecordConstructorArgs):
    """Make ``rgb`` grey: (rows, columns, 3) becomes (rows, columns, 1).

    Raises:
        ValueError: Observations have no ``rgb`` of three channels.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        rgb = _picture(env, self, "rgb")
        if rgb.shape[2:] != (3,):
            raise ValueError(f"GrayPicture: rgb has shape {rgb.shape}; put it before StackPictures, once")
        TransformObservation.__init__(self, env, _gray, _with(env, rgb=_space(*rgb.shape[:2], 1)))


class ResizePictures(TransformObservation[Any, Any, Any], RecordConstructorArgs):
    """Give the pictures another size. Classes of ``segmentation`` are picked, not mixed.

    In process, ``camera=Camera(...)`` draws pictures of any size, which is sharper and quicker.

    Args:
        shape: Rows and columns, such as ``(84, 84)``.

    Raises:
        ValueError: Observations have no pictures, or the shape is not two whole numbers.
        DependencyNotInstalled: OpenCV is missing; install ``opencv-python-headless``.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], shape: tuple[int, int]) -> None:
        RecordConstructorArgs.__init__(self, shape=shape)
        try:
            rows, columns = shape
        except (TypeError, ValueError):
            raise ValueError(f"shape: {shape!r} is not rows and columns; give two, such as (84, 84)") from None
        self._rows, self._columns = whole_number("shape[0]", rows), whole_number("shape[1]", columns)
        try:
            import cv2  # noqa: PLC0415 - the light client does without it
        except ImportError:
            advice = install("opencv-python-headless")
            raise DependencyNotInstalled(f"ResizePictures needs OpenCV; install it: {advice}") from None
        self._cv2 = cv2
        pictures = _pictures(env, self)
        resized = {key: _like(space, (self._rows, self._columns, *space.shape[2:])) for key, space in pictures.items()}
        TransformObservation.__init__(self, env, self._resized, _with(env, **resized))

    def _resized(self, seen: Observation) -> Observation:
        return {**seen, **{key: self._one(key, seen[key]) for key in _KEYS if key in seen}}

    def _one(self, key: str, picture: Picture) -> Picture:
        how = self._cv2.INTER_AREA if key == "rgb" else self._cv2.INTER_NEAREST
        # OpenCV drops a single channel.
        made = self._cv2.resize(picture, (self._columns, self._rows), interpolation=how)
        return cast(Picture, made.reshape(self._rows, self._columns, *picture.shape[2:]))


class SegmentationPlanes(TransformObservation[Any, Any, Any], RecordConstructorArgs):
    """Give each class of ``segmentation`` a plane of its own: (rows, columns, 11), 255 where the class is, else 0.

    Networks learn more easily from planes than from the numbers of classes, which have no order.

    Raises:
        ValueError: Observations have no ``segmentation`` of classes.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        RecordConstructorArgs.__init__(self)
        classes = _picture(env, self, "segmentation")
        if len(classes.shape) != 2:
            raise ValueError(
                f"SegmentationPlanes: segmentation has shape {classes.shape}; put it before StackPictures, once"
            )
        TransformObservation.__init__(
            self, env, _planes, _with(env, segmentation=_space(*classes.shape, len(SegmentationClass)))
        )


class StackPictures(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Stack the last pictures along their channels, oldest first, so that a network sees what moves.

    Four pictures of (64, 192, 3) become (64, 192, 12). The first picture of an episode is repeated. Other keys stay
    as they are; Gymnasium's ``FrameStackObservation`` stacks every key, along a new first axis.

    Raises:
        ValueError: Observations have no pictures, or the number is not a whole number, 1 or more.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], number: int = 4) -> None:
        RecordConstructorArgs.__init__(self, number=number)
        gymnasium.Wrapper.__init__(self, env)
        self.number: Final = whole_number("number", number)
        pictures = _pictures(env, self)
        stacked = {
            key: _like(space, (*space.shape[:2], self.number * _channels(space.shape)))
            for key, space in pictures.items()
        }
        self.observation_space = _with(env, **stacked)
        self._last: dict[str, deque[Picture]] = {key: deque(maxlen=self.number) for key in pictures}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode with its first picture, repeated."""
        seen, info = self.env.reset(seed=seed, options=options)
        for key, last in self._last.items():
            last.extend([seen[key]] * self.number)
        return self._stacked(seen), info

    def step(self, action: Any) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Drive on, and put the new picture last."""
        seen, reward, terminated, truncated, info = self.env.step(action)
        for key, last in self._last.items():
            last.append(seen[key])
        return self._stacked(seen), reward, terminated, truncated, info

    def _stacked(self, seen: Observation) -> Observation:
        return {**seen, **{key: np.dstack(list(last)) for key, last in self._last.items()}}


def _gray(seen: Observation) -> Observation:
    return {**seen, "rgb": (seen["rgb"] @ _LUMA // 1000).astype(np.uint8)[..., None]}


def _planes(seen: Observation) -> Observation:
    classes = np.arange(len(SegmentationClass), dtype=np.uint8)
    return {**seen, "segmentation": np.where(seen["segmentation"][..., None] == classes, 255, 0).astype(np.uint8)}


def _pictures(env: gymnasium.Env[Any, Any], wrapper: object) -> dict[str, spaces.Box]:
    space = env.observation_space
    keys = space.spaces if isinstance(space, spaces.Dict) else {}
    found: dict[str, spaces.Box] = {key: cast(spaces.Box, keys[key]) for key in _KEYS if key in keys}
    if not found:
        raise ValueError(
            f"{type(wrapper).__name__}: observations have no pictures; make the environment with track='camera' or "
            "'segmentation', and put OnlyPicture last"
        )
    return found


def _picture(env: gymnasium.Env[Any, Any], wrapper: object, key: str) -> spaces.Box:
    pictures = _pictures(env, wrapper)
    if key not in pictures:
        raise ValueError(f"{type(wrapper).__name__}: there is no picture {key!r}; give one of {', '.join(pictures)}")
    return pictures[key]


def _with(env: gymnasium.Env[Any, Any], **changed: spaces.Box) -> spaces.Dict:
    assert isinstance(env.observation_space, spaces.Dict)
    return spaces.Dict({**env.observation_space.spaces, **changed})


def _space(*shape: int) -> spaces.Box:
    return spaces.Box(0, 255, shape, np.uint8)


def _like(space: spaces.Box, shape: tuple[int, ...]) -> spaces.Box:
    return spaces.Box(int(space.low.min()), int(space.high.max()), shape, np.uint8)


def _channels(shape: tuple[int, ...]) -> int:
    return shape[2] if len(shape) == 3 else 1
