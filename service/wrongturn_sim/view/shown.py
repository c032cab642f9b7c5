"""Drawings for the client: the films and pictures of ``wrongturn replay``, and figures."""

from pathlib import Path
from typing import TYPE_CHECKING

import cv2

from wrongturn_protocol import Outcome, View, words
from wrongturn_sim.errors import ViewError
from wrongturn_sim.replay import PICTURE_SIZE, SIZE, Replay
from wrongturn_sim.view.film import check_film
from wrongturn_sim.view.views import VIEW_SIZE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def show(
    trajectory: bytes,
    outcome: Outcome | None,
    *,
    view: View = View.BOTH,
    video: Path | None = None,
    picture: Path | None = None,
    size: int | None = None,
    agent: str = "",
    twin: tuple[bytes, Outcome | None] | None = None,
) -> tuple[str, ...]:
    """Draw an episode, given by its trajectory's canonical JSON, into files; return lines that say what was made.

    ``view`` is what the film (``.mp4`` or ``.webp``) shows. ``size`` is the side of the view from above in pixels, 720
    for films and 1000 for pictures (``.png``) by default. Films show the ``agent``'s name, and the ``twin``, if any,
    on the right; they have views of 480 pixels by default then.

    Raises what Replay raises, and ViewError if a file cannot be written, its name ends wrongly or the size is wrong.
    """
    if video is not None:
        check_film(video)
    if picture is not None and picture.suffix != ".png":
        raise ViewError(f"picture: {picture.name!r} is not a picture; give a name that ends in .png")
    replay = Replay.from_json(trajectory, outcome, agent)
    beside = None if twin is None else Replay.from_json(*twin, f"{agent}, twin without the fault")
    said = list(replay.notes)
    name = replay.trajectory.trial.id
    ending = "" if outcome is None else f", {words.name(outcome.verdict)}"
    if picture is not None:
        _write(picture, replay, size or PICTURE_SIZE)
        said.append(f"{picture}: {name}{ending}, from above")
    if video is not None:
        frames = replay.video(video, view, size or (SIZE if beside is None else VIEW_SIZE), beside)
        said.append(f"{video}: {name}{ending}, {frames} frames, {frames / 10:.1f} s")
    return tuple(said)


def plot(trajectory: bytes, outcome: Outcome | None) -> "Figure":
    """Return the figure of :meth:`Replay.plot`, from a trajectory's canonical JSON; raises what Replay raises."""
    return Replay.from_json(trajectory, outcome).plot()


def _write(file: Path, replay: Replay, size: int) -> None:
    packed = cv2.imencode(".png", replay.picture(size)[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    try:
        file.write_bytes(packed.tobytes())
    except OSError as error:
        raise ViewError(
            f"picture: {file} cannot be written ({error.strerror}); name a file in a folder that you may write to"
        ) from error
