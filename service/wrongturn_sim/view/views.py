"""The views of one moment of an episode: from above, through the camera, and both with the figures beside them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np

from wrongturn_judge.trajectory import Row, Trajectory
from wrongturn_networks import Town
from wrongturn_protocol import Outcome, Safety, Trial, View
from wrongturn_sim.ego import SUB_STEP
from wrongturn_sim.errors import ViewError
from wrongturn_sim.view import colours, scene
from wrongturn_sim.view.window import Image, Line, Window, panel, width_of, write

VIEW_SIZE: Final = 480
"""Side of the view from above while an episode is driven, pixels."""
LEAST_SIZE: Final = 160
MOST_SIZE: Final = 2160
_REMEMBERED: Final = round(60.0 / SUB_STEP)
"""Rows of the trail in a moving picture."""
_STRIP: Final = 0.12
"""Height of the text below a picture, as a share of its width."""
_BESIDE: Final = 0.8
"""Width of the column beside the view from above, as a share of the view's side."""
_CAMERA: Final = 0.6
"""Greatest height of the camera's picture in that column, as a share of the view's side."""


def checked_size(size: int) -> int:
    """Return a picture's side in pixels, a multiple of 20, so that all sides are even. Raises ViewError."""
    if not LEAST_SIZE <= size <= MOST_SIZE:
        raise ViewError(f"size: is {size}; give pixels, {LEAST_SIZE} to {MOST_SIZE}")
    return size // 20 * 20


def view_of(name: View | str) -> View:
    """Return a view by its name; raise ViewError if there is none."""
    if name not in set(View):
        raise ViewError(f"view: {name!r} is not known; take {', '.join(View)}")
    return View(name)


@dataclass(frozen=True)
class Moment:
    """One moment of an episode."""

    index: int
    """Its row of the trajectory."""
    command: int
    """Command that the agent gets now."""
    route_command: int
    camera: Image | None = None
    """What the camera sees, RGB. Only the view ``top`` needs none."""
    outcome: Outcome | None = None
    """The outcome, if this is the moment of the verdict."""


class Views:
    """Draws the moments of one episode.

    The rows of the trajectory may grow; ``first`` is the number of the first one whose place is shown. ``size`` is the
    side of the view from above, pixels. A ``still`` window shows the whole way, unless that is long; else it follows
    the car. The car drives up to the junction. ``label`` is written in the upper left corner. Raises ViewError if the
    size is too small or too large.
    """

    def __init__(
        self, town: Town, trial: Trial, rows: list[Row], size: int, *, still: bool, first: int = 0, label: str = ""
    ) -> None:
        self._town = town
        self._trial = trial
        self._rows = rows
        self._size = checked_size(size)
        self._first = first
        self._label = label
        self._up = scene.up_of(town, trial)
        # A journey has left its first junction behind when it is seen from later on.
        approach = trial.approach if trial.journey is None or first == 0 else None
        window = scene.whole_window(town, rows[first:], approach, self._size, self._up) if still else None
        self._window = window if window is not None and window.extent <= scene.MOST else None

    @cached_property
    def _still(self) -> Image:
        """The ground of a window that stands still."""
        assert self._window is not None
        return scene.draw_ground(self._town, self._window)

    def draw(self, view: View, moment: Moment) -> Image:
        """Return one picture, RGB uint8. Its sides are even.

        The shape for a size is, ``top``: (1.12 size, size, 3); ``camera``: (0.45 size, size, 3); ``both``:
        (size, 1.8 size, 3). A camera with another aspect than the benchmark's changes that of ``camera``.
        """
        image = self._drawn(view, moment)
        if self._label:
            letter = self._size / 40
            high, wide = round(3 * letter), min(width_of(self._label, letter) + round(2 * letter), image.shape[1])
            image[:high, :wide] = panel([(self._label, colours.TEXT)], wide, high, letter)
        return image

    def _drawn(self, view: View, moment: Moment) -> Image:
        if view is View.TOP:
            return np.concatenate([self.map(moment), self._strip(moment)])
        assert moment.camera is not None
        if view is View.CAMERA:
            height = round(self._size * moment.camera.shape[0] / moment.camera.shape[1] / 2) * 2
            return np.concatenate([resized(moment.camera, self._size, height), self._strip(moment)])
        return np.concatenate([self.map(moment), self._column(moment, moment.camera)], axis=1)

    def map(self, moment: Moment) -> Image:
        """Return the view from above, (size, size, 3)."""
        row = self._rows[moment.index]
        if self._window is None:
            window = Window(row.x, row.y, scene.FOLLOWING, self._size, self._up)
            image = scene.draw_ground(self._town, window)
        else:
            window, image = self._window, self._still.copy()
        fastest = scene.fastest_of(self._rows)
        scene.draw_trail(
            image, window, self._rows[max(self._first, moment.index - _REMEMBERED) : moment.index + 1], fastest
        )
        scene.draw_road_users(image, window, row.road_users)
        scene.draw_car(image, window, row)
        if moment.outcome is not None:
            scene.draw_verdict(image, window, row, moment.outcome)
        scene.draw_scales(image, window, fastest)
        return image

    def _strip(self, moment: Moment) -> Image:
        height = round(_STRIP * self._size / 2) * 2
        return panel(self._lines(moment)[:2], self._size, height, self._size / 42)

    def _lines(self, moment: Moment) -> list[Line]:
        row = self._rows[moment.index]
        wrong = moment.command != moment.route_command
        said = f"command: {scene.name_of(moment.command)}"
        if wrong:
            said += f"   (route: {scene.name_of(moment.route_command)})"
        lines: list[Line] = [
            (f"{row.t:.1f} s   {row.v:.1f} m/s", colours.TEXT),
            (said, colours.OF_SAFETY[Safety.UNSAFE] if wrong else colours.TEXT),
            (f"steer {row.steer:+.2f}   throttle {row.throttle:.2f}   brake {row.brake:.2f}", colours.FAINT),
            (self._trial.id, colours.FAINT),
        ]
        if moment.outcome is not None:
            text, colour = scene.verdict_of(moment.outcome)
            lines[0] = (f"{lines[0][0]}   {text}", colour)
        return lines

    def _column(self, moment: Moment, camera: Image) -> Image:
        """Return the camera's picture above the figures and the course of the speed."""
        width, letter = round(_BESIDE * self._size), self._size / 46
        scale = min(width / camera.shape[1], _CAMERA * self._size / camera.shape[0])
        seen = resized(camera, round(scale * camera.shape[1]), round(scale * camera.shape[0]))
        beside = width - seen.shape[1]
        seen = np.pad(seen, ((0, 0), (beside // 2, beside - beside // 2), (0, 0)), constant_values=colours.PANEL[0])
        figures = panel(self._lines(moment), width, round(9.5 * letter), letter)
        rest = self._size - len(seen) - len(figures)
        return np.concatenate([seen, figures, self._speeds(moment.index, width, rest, letter)])

    def _speeds(self, index: int, width: int, height: int, letter: float) -> Image:
        """Return the speed over time, with a mark at the moment."""
        image = np.full((height, width, 3), colours.PANEL, np.uint8)
        left, right, up, low = letter, width - letter, 2.5 * letter, height - 2.5 * letter
        fastest, last = scene.fastest_of(self._rows), max(self._rows[-1].t, SUB_STEP)
        times = np.array([row.t for row in self._rows])
        speeds = np.array([row.v for row in self._rows])
        points = np.stack([left + times / last * (right - left), low - speeds / fastest * (low - up)], axis=1)
        cv2.rectangle(image, (round(left), round(up)), (round(right), round(low)), colours.LINE, 1)
        cv2.polylines(image, [np.round(points * 16).astype(np.int32)], False, colours.TEXT, 2, cv2.LINE_AA, 4)
        x, y = np.round(points[index]).astype(int).tolist()
        cv2.line(image, (x, round(up)), (x, round(low)), colours.FAINT, 1)
        colour = colours.of_speed(self._rows[index].v, fastest)
        cv2.circle(image, (x, y), max(3, round(letter / 3)), colour, -1, cv2.LINE_AA)
        write(image, f"speed, 0 to {fastest:.0f} m/s", (left, up - 0.7 * letter), 0.75 * letter, colours.FAINT)
        write(image, f"0 to {last:.1f} s", (left, low + 1.4 * letter), 0.75 * letter, colours.FAINT)
        return image


def draw_picture(town: Town, trajectory: Trajectory, outcome: Outcome | None, size: int) -> Image:
    """Return a whole episode from above, RGB uint8 (size, size, 3).

    It shows the car's way and footprints, coloured by speed, the commands where they began, the other road users at the
    end, and the verdict. Raises ViewError if the size is too small or too large.
    """
    rows = trajectory.rows
    trial = trajectory.trial
    window = scene.whole_window(town, rows, trial.approach, checked_size(size), scene.up_of(town, trial))
    image, fastest = scene.draw_ground(town, window), scene.fastest_of(rows)
    scene.draw_footprints(image, window, rows, fastest)
    scene.draw_trail(image, window, rows, fastest)
    scene.draw_road_users(image, window, rows[-1].road_users)
    scene.draw_car(image, window, rows[-1])
    scene.draw_commands(image, window, rows)
    if outcome is not None:
        scene.draw_verdict(image, window, rows[-1], outcome)
    scene.draw_scales(image, window, fastest)
    return image


def resized(image: Image, width: int, height: int) -> Image:
    """Return a picture in another size; when it grows, its pixels stay sharp."""
    way = cv2.INTER_NEAREST if width >= image.shape[1] else cv2.INTER_AREA
    return np.asarray(cv2.resize(image, (width, height), interpolation=way), np.uint8)
