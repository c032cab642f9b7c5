"""A stored episode, seen again without driving it."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from wrongturn_judge.trajectory import Row, Trajectory
from wrongturn_networks import town_of
from wrongturn_protocol import Outcome, View
from wrongturn_sim.camera import Camera, Renderer, World
from wrongturn_sim.camera.renderer import Image
from wrongturn_sim.ego import SUB_STEPS
from wrongturn_sim.view.plot import plot_episode
from wrongturn_sim.view.views import VIEW_SIZE, Moment, Views, draw_picture, view_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE: Final = 720
"""Side of the view from above, pixels."""
PICTURE_SIZE: Final = 1000
"""Side of the picture of a whole episode, pixels."""


class Replay:
    """A finished episode, decision by decision.

    Decision 0 is the reset. Decision ``n`` is what the agent got in reply to its ``n``-th step. Films show the
    ``label``, such as the agent's name. Raises UnknownTownError if the town is not installed here, and TrajectoryError
    if the trajectory has no rows.
    """

    def __init__(self, trajectory: Trajectory, outcome: Outcome | None = None, label: str = "") -> None:
        trajectory.check_rows()
        self.label = label
        self.trajectory = trajectory
        self.outcome = outcome
        self.town = town_of(trajectory.trial)

    @classmethod
    def from_json(cls, trajectory: bytes | str, outcome: Outcome | None = None, label: str = "") -> Self:
        """Return the replay of a trajectory's canonical JSON. Raises TrajectoryError."""
        return cls(Trajectory.from_json(trajectory), outcome, label)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a picture cannot show as it was; empty if nothing is wrong."""
        notes = []
        if self.trajectory.looks_guessed:
            notes.append("heights and colours of other road users are guesses: the trajectory is of an older version")
        if self.trajectory.town_sha256 != self.town.sha256:
            notes.append(f"{self.town.name} here is another version than the one driven in; places may be off")
        return tuple(notes)

    def __len__(self) -> int:
        """Return the number of decisions, with the reset."""
        return 1 - (1 - len(self.trajectory.rows)) // SUB_STEPS

    def row(self, decision: int) -> Row:
        """Return the car's state at a decision. Raises IndexError."""
        return self.trajectory.rows[self._index(decision)]

    def _index(self, decision: int) -> int:
        if not 0 <= decision < len(self):
            raise IndexError(f"decision: {decision} is not one of 0 to {len(self) - 1}")
        # The last step ends early if its first sub-step brings the verdict.
        return min(decision * SUB_STEPS, len(self.trajectory.rows) - 1)

    def camera(self, decision: int, camera: Camera | None = None) -> tuple[Image, Image]:
        """Return what the camera saw at a decision: rgb (height, width, 3) and segmentation (height, width), uint8.

        With the benchmark's camera, which is the default, these are the bytes that the agent got.
        """
        return self._seen(decision, self._renderer(camera))

    def top(self, decision: int, size: int = SIZE) -> Image:
        """Return the view from above at a decision, RGB uint8 (1.12 size, size, 3). Raises ViewError."""
        return self._views(size).draw(View.TOP, self._moment(decision, None))

    def both(self, decision: int, size: int = SIZE) -> Image:
        """Return the view from above beside the camera's, RGB uint8 (size, 1.8 size, 3). Raises ViewError."""
        return self._views(size).draw(View.BOTH, self._moment(decision, self._renderer(None)))

    def last_view(self, command: int | None = None, route_command: int | None = None) -> Image:
        """Return the last picture that :meth:`Episode.view` gave, RGB uint8 (480, 864, 3).

        The trajectory does not hold the commands after the last row; by default they are those before it.
        """
        views = Views(self.town, self.trajectory.trial, self.trajectory.rows, VIEW_SIZE, still=False)
        moment = self._moment(len(self) - 1, self._renderer(None))
        if command is not None and route_command is not None:
            moment = replace(moment, command=command, route_command=route_command)
        return views.draw(View.BOTH, moment)

    def picture(self, size: int = PICTURE_SIZE) -> Image:
        """Return the whole episode from above, RGB uint8 (size, size, 3).

        It shows the car's way and footprints, coloured by speed, the commands where they began, and the verdict. Raises
        ViewError if the size is too small or too large.
        """
        return draw_picture(self.town, self.trajectory, self.outcome, size)

    def frames(self, view: View | str, size: int = SIZE, *, first: int = 0, every: int = 1) -> Iterator[Image]:
        """Yield a picture for each decision, or for some of them; the last one is always among them.

        ``size`` is the side of the view from above, or the camera's width, pixels. The view from above shows the way
        from the decision ``first`` on; ``every=2`` shows every second decision, and so on.

        Raises IndexError for a first decision that there is not, ViewError for an unknown view or a wrong size.
        """
        view, last = view_of(view), len(self) - 1
        views, renderer = self._views(size, self._index(first)), None if view is View.TOP else self._renderer(None)
        shown = (*range(first, last, every), last)
        return (views.draw(view, self._moment(decision, renderer)) for decision in shown)

    def video(
        self, file: str | Path, view: View | str = View.BOTH, size: int = SIZE, twin: "Replay | None" = None
    ) -> int:
        """Write an ``.mp4`` or ``.webp`` of ten frames a second, one for each decision, and return their number.

        The ``twin``, if any, drives on the right.

        Raises FilmError if the file's name ends otherwise or it cannot be written, ViewError as :meth:`frames`.
        """
        from wrongturn_sim.view.film import check_film, write_film  # noqa: PLC0415 - PyAV takes a quarter of a second

        check_film(Path(file))
        frames = self.frames(view, size)
        return write_film(Path(file), frames if twin is None else _beside(frames, twin.frames(view, size)))

    def plot(self) -> "Figure":
        """Return a matplotlib figure: the way from above, coloured by speed, beside speed and commands over time.

        Raises DependencyMissingError if matplotlib is missing.
        """
        return plot_episode(self.town, self.trajectory, self.outcome)

    def _views(self, size: int, first: int = 0) -> Views:
        rows = self.trajectory.rows
        return Views(self.town, self.trajectory.trial, rows, size, still=True, first=first, label=self.label)

    def _moment(self, decision: int, renderer: Renderer | None) -> Moment:
        index, rows = self._index(decision), self.trajectory.rows
        told = rows[min(index + 1, len(rows) - 1)]
        return Moment(
            index,
            told.command,
            told.route_command,
            None if renderer is None else self._seen(decision, renderer)[0],
            self.outcome if index == len(rows) - 1 else None,
        )

    def _renderer(self, camera: Camera | None) -> Renderer:
        trial = self.trajectory.trial
        return Renderer(World.of(self.town), camera, trial.weather, trial.seed)

    def _seen(self, decision: int, renderer: Renderer) -> tuple[Image, Image]:
        row = self.row(decision)
        return renderer.render(row.x, row.y, row.yaw, decision, self.trajectory.others(self._index(decision)))


def _beside(left: Iterator[Image], right: Iterator[Image]) -> Iterator[Image]:
    """Yield the frames of two films side by side. The shorter one stays at its end."""
    pair: tuple[Image, Image] | None = None
    for one, other in zip_longest(left, right):
        pair = (pair[0] if one is None and pair else one, pair[1] if other is None and pair else other)
        yield np.concatenate(pair, axis=1)
