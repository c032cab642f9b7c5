"""Finished episodes as pictures, drawn from their trajectories. Nothing is driven again."""

import asyncio
from collections.abc import Callable, Hashable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

import structlog

from wrongturn_judge import Row, Trajectory, TrajectoryError
from wrongturn_networks import draw_trial, load_town
from wrongturn_protocol import Command, FaultKind, Outcome, ProblemType, View
from wrongturn_protocol.pixmap import to_pixmap
from wrongturn_service import catalogue
from wrongturn_service.cache import Cache
from wrongturn_service.episodes.draws import Draws
from wrongturn_service.errors import ConflictError, NotFoundError
from wrongturn_service.storage.store import Store

if TYPE_CHECKING:
    from wrongturn_sim.camera.renderer import Image
    from wrongturn_sim.replay import Replay

SHEET: Final = 20
"""Decisions of a sheet of the camera's pictures: 2 s."""
QUALITY: Final = 90
"""Of WebP. A sheet has 100 KB and takes a fifth of the time of a lossless one, which has 210 KB."""
PICTURE: Final = 800
"""Side of a picture from above, pixels. It has about 90 KB, that of a long journey 250 KB."""
_FILM: Final = 480
"""Side of a film's view from above, pixels. A film is 864 pixels wide, and has about 40 KB for each second."""
_FRAMES: Final = 900
"""Frames of a film. A longer drive is shown faster."""
_PICTURES: Final = 32 << 20
"""Bytes of pictures that are kept."""
_ROWS: Final = 60_000
"""Rows of trajectories that are kept. They take about 50 MB."""


class Replays:
    """Draws finished episodes, a few at a time, and keeps what was drawn last.

    Whether an episode may be shown is for the caller to check. All calls raise ConflictError for an episode without a
    trajectory, or whose town has changed since, and NotFoundError if its town is not installed.
    """

    def __init__(self, store: Store, draws: Draws) -> None:
        self._store = store
        self._draws = draws
        self._read = Cache(_ROWS, size=lambda trajectory: len(trajectory.rows))
        self._made = Cache(_PICTURES, size=len)
        self._films = Cache(1, at_once=1)
        self._warm = Cache(1)

    async def warm_up(self) -> None:
        """Draw a little, once, so that no reader waits for what is compiled or loaded late.

        Never raises; the first picture reports what is wrong. Every picture waits for it, and begins it if nobody has.
        """
        await self._warm.get("pictures", _drawn_a_little)

    def clear(self) -> None:
        """Drop all that is kept."""
        self._read.clear()
        self._made.clear()
        self._films.clear()

    async def trajectory(self, episode: str) -> Trajectory:
        """Return an episode's trajectory, also one whose town has changed since.

        Raises UnavailableError while the drawn town is built again.
        """
        found = await self._read.get(episode, lambda: self._load(episode))
        self._draws.check_towns([found.trial])
        return found

    async def made(self, kind: Hashable, episode: str, make: Callable[[Trajectory], bytes]) -> bytes:
        """Return the bytes that ``make`` makes of an episode's trajectory, in a thread. They are kept by ``kind``."""

        async def work() -> bytes:
            return await asyncio.to_thread(make, await self.trajectory(episode))

        return await self._made.get((episode, kind), work)

    async def sheet(self, episode: str, number: int) -> bytes:
        """Return what the camera saw at :data:`SHEET` decisions, one below the other, as WebP.

        Sheet 0 begins with the reset. Raises NotFoundError if the episode has no such sheet.
        """
        await self.warm_up()
        return await self.made(("camera", number), episode, lambda trajectory: _sheet(trajectory, number))

    async def last_view(self, episode: str, outcome: Outcome | None) -> bytes:
        """Return the view of an episode's last moment, as a pixmap."""
        await self.warm_up()
        return await self.made("view", episode, lambda trajectory: _view(trajectory, outcome))

    async def picture(self, episode: str, outcome: Outcome | None) -> bytes:
        """Return a whole episode from above, as PNG."""
        await self.warm_up()
        return await self.made("picture", episode, lambda trajectory: drawn(trajectory, outcome))

    async def film(self, episode: str, outcome: Outcome, agent: str) -> bytes:
        """Return an episode as a film with its agent's name, MP4. Only one film is made at once."""
        await self.warm_up()
        made = partial(self.made, "film", episode, lambda trajectory: _film(trajectory, outcome, agent))
        return await self._films.get(episode, made)

    async def _load(self, episode: str) -> Trajectory:
        found = await self._store.trajectory(episode)
        if found is None:
            raise _nothing(episode, "it ended before it began")
        try:
            trajectory = await asyncio.to_thread(Trajectory.from_json, found[0])
        except TrajectoryError as error:
            raise _nothing(episode, str(error)) from error
        if not trajectory.rows:
            raise _nothing(episode, "it has no rows")
        return trajectory


def _nothing(episode: str, why: str) -> ConflictError:
    return ConflictError(ProblemType.EPISODE_NOT_SHOWN, f"episode {episode} has no trajectory to show: {why}")


def check_town(trajectory: Trajectory) -> None:
    """Check that a trajectory's town is installed, and the one that it was driven in.

    Raises NotFoundError, ConflictError.
    """
    town = catalogue.town_driven(trajectory.trial)
    if town.sha256 != trajectory.town_sha256:
        raise ConflictError(
            ProblemType.EPISODE_NOT_SHOWN,
            f"the town {town.name} has changed since this episode was driven, so its pictures would be wrong",
        )


def _replay(trajectory: Trajectory, outcome: Outcome | None = None) -> "Replay":
    # A compiler and OpenCV: the service is ready without them, and loads them in the warm-up.
    from wrongturn_sim.replay import Replay  # noqa: PLC0415

    check_town(trajectory)
    return Replay(trajectory, outcome)


def _view(trajectory: Trajectory, outcome: Outcome | None) -> bytes:
    return to_pixmap(_replay(trajectory, outcome).last_view())


def drawn(trajectory: Trajectory, outcome: Outcome | None) -> bytes:
    """Return a whole drive from above, as PNG."""
    return _encoded(".png", _replay(trajectory, outcome).picture(PICTURE))


def _film(trajectory: Trajectory, outcome: Outcome, agent: str) -> bytes:
    from wrongturn_sim.view.film import write_film  # noqa: PLC0415 - as above

    replay = _replay(trajectory, outcome)
    replay.label = agent
    with TemporaryDirectory() as folder:
        file = Path(folder, "film.mp4")
        write_film(file, replay.frames(View.BOTH, _FILM, every=-(-len(replay) // _FRAMES)))
        return file.read_bytes()


def _sheet(trajectory: Trajectory, number: int) -> bytes:
    import cv2  # noqa: PLC0415 - as above
    import numpy as np  # noqa: PLC0415 - as above

    replay = _replay(trajectory)
    sheets = -(-len(replay) // SHEET)
    if not 0 <= number < sheets:
        raise NotFoundError(
            ProblemType.UNKNOWN_EPISODE, f"sheet {number} is not one of this episode's {sheets}, 0 to {sheets - 1}"
        )
    shown = range(number * SHEET, min((number + 1) * SHEET, len(replay)))
    rgb = np.concatenate([replay.camera(decision)[0] for decision in shown])
    return _encoded(".webp", rgb, cv2.IMWRITE_WEBP_QUALITY, QUALITY)


def _encoded(kind: str, rgb: "Image", *parameters: int) -> bytes:
    import cv2  # noqa: PLC0415 - as above

    done, encoded = cv2.imencode(kind, rgb[:, :, ::-1], parameters)
    assert done
    return encoded.tobytes()


async def _drawn_a_little() -> None:
    try:
        await asyncio.to_thread(_draw_a_little)
    except Exception:
        structlog.get_logger("replays").exception("warm-up failed")


def _draw_a_little() -> None:
    """Draw one moment of a car that stands, in every way."""
    town = load_town("junctions")
    trial = draw_trial(town, next(iter(town.approaches)), FaultKind.NONE, 0)
    car = Row(*(0.0,) * 6, Command.STRAIGHT, Command.STRAIGHT, *(0.0,) * 3)
    moment = Trajectory(trial, town.sha256, [car])
    _sheet(moment, 0)
    drawn(moment, None)
    _view(moment, None)
