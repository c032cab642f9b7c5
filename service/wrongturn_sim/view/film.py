"""Write films: H.264 in MP4, which browsers and presentations play, and animated WebP, which documents embed."""

from collections.abc import Iterable
from contextlib import suppress
from itertools import chain, repeat
from pathlib import Path
from typing import Any, Final, NamedTuple

import av
import av.error

from wrongturn_sim.errors import FilmError
from wrongturn_sim.view.window import Image

FRAMES_A_SECOND: Final = 10
"""A frame for each decision."""
LAST: Final = 1.2
"""Seconds for which a film stays at its end."""
_BT709: Final = 1
"""The number of the colours of HD video. Players guess the colours of a film that does not say."""


class _Format(NamedTuple):
    codec: str
    options: dict[str, str]
    container: dict[str, str]


_FORMATS: Final = {
    # One thread, because several may give other bytes.
    ".mp4": _Format("libx264", {"crf": "20", "threads": "1"}, {"movflags": "+faststart"}),
    ".webp": _Format("libwebp_anim", {"quality": "70", "threads": "1"}, {"loop": "0"}),
}
_SMALL: Final = {".mp4": {"crf": "30"}, ".webp": {"quality": "40"}}
"""Options of smaller files."""


def check_film(file: Path) -> None:
    """Raise FilmError if a film's name does not end in ``.mp4`` or ``.webp``, before any picture is drawn."""
    if file.suffix not in _FORMATS:
        raise FilmError(f"video: {file.name!r} is not a film; give a name that ends in .mp4 or .webp")


def write_film(file: Path, frames: Iterable[Image], *, rate: int = FRAMES_A_SECOND, small: bool = False) -> int:
    """Write a film with ``rate`` frames a second and return their number. The last picture stays for a while.

    The frames are pictures of one size with even sides, RGB uint8 (height, width, 3), one at least. A ``small`` film
    has coarser ones. The same pictures give the same bytes with the same version of PyAV. Raises FilmError if the
    file's name ends otherwise, or it cannot be written.
    """
    check_film(file)
    part = file.with_name(f".part-{file.name}")
    try:
        form = _FORMATS[file.suffix]
        if small:
            form = form._replace(options={**form.options, **_SMALL[file.suffix]})
        count = _encode(part, frames, form, rate)
        part.replace(file)
    except (OSError, av.error.FFmpegError) as error:
        raise FilmError(
            f"video: {file} cannot be written ({error.strerror}); name a file in a folder that you may write to"
        ) from error
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)
    return count


def _encode(file: Path, frames: Iterable[Image], form: _Format, rate: int) -> int:
    coming = iter(frames)
    first = last = next(coming)
    count = 0
    with av.open(str(file), "w", options=form.container) as container:
        stream: Any = container.add_stream(form.codec, rate=rate)
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.options = form.options
        context = stream.codec_context
        context.colorspace = context.color_primaries = context.color_trc = context.color_range = _BT709

        def put(picture: Image) -> None:
            nonlocal count
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709")
            frame.pts = count
            container.mux(stream.encode(frame))
            count += 1

        for last in chain([first], coming):
            put(last)
        for again in repeat(last, round(LAST * rate)):
            put(again)
        container.mux(stream.encode(None))
    return count
