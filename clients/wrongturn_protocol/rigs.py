"""Rigs: what an agent declares of its cameras, its navigation inputs, its rate and its kind of action.

Tracks are rigs with names. An agent with another rig still has a track, the class in which it is ranked.
"""

import re
from enum import StrEnum
from itertools import pairwise
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, TypeAdapter, ValidationError, model_validator
from pydantic_core import to_json

from wrongturn_protocol.episodes import Message, is_none
from wrongturn_protocol.vocabulary import Track

CAMERAS: Final = 6
"""Most cameras of a rig."""
PIXELS: Final = 1_000_000
"""Most pixels that a rig is shown at a decision, those of all cameras and their histories together."""
_TAKEN: Final = frozenset({
    *("speed", "steering", "command", "next_command", "distance", "target_points", "sentence", "state_in", "pose"),
    *("lane", "stop_line", "exits", "exits_mask", "road_users", "road_users_count"),
})  # fmt: skip


class RigError(ValueError):
    """A rig cannot be used. The text names the field and the remedy."""


class NavigationInput(StrEnum):
    """What a planner tells a model. One fault changes all of them in the same way."""

    COMMAND = "command"
    NEXT_COMMAND = "next_command"
    """The command after the present one: before a window that of the next junction, within it LANE_FOLLOW."""
    DISTANCE = "distance"
    """Metres to the stop line at which the next direction is to be taken."""
    TARGET_POINTS = "target_points"
    """The next two points of the commanded way; ``docs/rigs.md`` has the construction."""
    SENTENCE = "sentence"


Pixels = Annotated[int, Field(ge=1, le=2048)]
Metres = Annotated[float, Field(ge=-20, le=20, allow_inf_nan=False)]
Seconds = Annotated[float, Field(ge=0.001, le=60, allow_inf_nan=False)]
Degrees = Annotated[float, Field(ge=-180, le=180, allow_inf_nan=False)]
Gain = Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]


class RigCamera(Message):
    """A pinhole camera on the car. Places are metres from the body's middle, angles degrees."""

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")] = "rgb"
    """Key of the observation."""
    width: Pixels
    height: Pixels
    fov: Annotated[float, Field(ge=1, le=170, allow_inf_nan=False)] = 90.0
    """Horizontal field of view, degrees."""
    horizon: Annotated[float, Field(ge=-4096, le=4096, allow_inf_nan=False)] | None = None
    """Row of the optical axis. None: the middle."""
    forward: Metres = 0.7
    left: Metres = 0.0
    up: Annotated[float, Field(ge=0.05, le=20, allow_inf_nan=False)] = 1.6
    """Metres above the ground."""
    pitch: Annotated[float, Field(ge=-80, le=80, allow_inf_nan=False)] = 0.0
    """A positive pitch looks down."""
    yaw: Degrees = 0.0
    """A positive yaw looks to the left."""
    kind: Literal["rgb", "segmentation"] = "rgb"
    """What the pixels hold: three colours, or the class of what is there."""
    rate: Annotated[int, Field(ge=1, le=20)] | None = None
    """New pictures in a second; between them the last one stays. None: one at each decision."""
    history: Annotated[int, Field(ge=1, le=8)] = 1
    """Pictures that are shown. Of more than one, the array has a first axis, the oldest first."""
    stride: Annotated[int, Field(ge=1, le=20)] = 1
    """Decisions from one picture of the history to the next."""
    jpeg: Annotated[int, Field(ge=1, le=100)] | None = Field(default=None, exclude_if=is_none)
    """Quality of the JPEG that the picture is sent as. In process the picture has the same losses."""

    @model_validator(mode="after")
    def _only_colours_are_compressed(self) -> Self:
        if self.jpeg is not None and self.kind != "rgb":
            raise ValueError("jpeg: classes of pixels cannot bear losses; leave it out of a camera of segmentation")
        return self

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of its array in an observation."""
        picture = (self.height, self.width, 3) if self.kind == "rgb" else (self.height, self.width)
        return picture if self.history == 1 else (self.history, *picture)


class TrackerGains(Message):
    """Settings of the controllers, by default those of the shipped agent ``lbc``.

    As in the authors' program, there are no derivative parts.
    """

    steer: tuple[Gain, Gain] = (0.9, 0.1)
    """Proportional and integral gain of the steering."""
    speed: tuple[Gain, Gain] = (0.8, 0.2)
    """Proportional and integral gain of the speed: acceleration in m/s² for an error of 1 m/s."""
    aim_s: Seconds = 1.0
    """The car steers for the place where the trajectory is after so many seconds."""
    lasting_s: Annotated[float, Field(ge=0.05, le=60, allow_inf_nan=False)] = 2.0
    """Time over which errors are averaged for the integral parts, seconds."""
    standing: Gain = 0.4
    """At a mean speed below this the car should stand, m/s: it brakes fully."""


class RigAction(Message):
    """What an agent answers with."""

    kind: Literal["controls", "increments", "waypoints"] = "controls"
    """Steer, throttle, brake; the same with the change of the steering since the last decision; or a trajectory."""
    times: Annotated[tuple[Seconds, ...], Field(max_length=64)] = ()
    """Of waypoints: seconds from now, growing."""
    side: Literal["left", "right"] = "left"
    """Of waypoints: to which side the second coordinate grows."""
    behind: Metres = 0.0
    """Of waypoints: how far their origin lies behind the body's middle, metres; of the rear axle 1.45."""
    gains: TrackerGains | None = Field(default=None, exclude_if=is_none)
    """Of waypoints: settings of the controllers that follow them. None: those of Learning by Cheating."""

    @model_validator(mode="after")
    def _times_are_those_of_waypoints(self) -> Self:
        if self.kind == "waypoints":
            if not self.times or any(later <= earlier for earlier, later in pairwise(self.times)):
                raise ValueError("times: give growing seconds above 0, one for each waypoint")
        elif self.times or self.side != "left" or self.behind or self.gains:
            raise ValueError(
                f"times: {self.kind} have none, nor side, behind or gains; leave them out, or let kind be waypoints"
            )
        return self


class Rig(Message):
    """What an agent sees, is told, and answers with."""

    cameras: Annotated[tuple[RigCamera, ...], Field(max_length=CAMERAS)] = ()
    navigation: tuple[NavigationInput, ...] = (NavigationInput.COMMAND,)
    sentences: tuple[Literal["plain", "distance", "ordinal", "ambiguous"], ...] = ("plain", "distance", "ordinal")
    """Kinds of sentences, of which each trial draws one."""
    rate: Literal[10, 20] = 10
    """Decisions in a second."""
    action: RigAction = RigAction()

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        names = [camera.name for camera in self.cameras]
        for number, camera in enumerate(self.cameras):
            here = f"cameras.{number}"
            if camera.name in _TAKEN or camera.name in names[:number]:
                raise ValueError(f"{here}.name: {camera.name} is the name of another input; give it one of its own")
            if camera.rate is not None and self.rate % camera.rate:
                raise ValueError(
                    f"{here}.rate: {camera.rate} does not divide the rig's rate of {self.rate} per second; "
                    f"give {', '.join(str(one) for one in range(1, 21) if self.rate % one == 0)}"
                )
        if len(set(self.navigation)) < len(self.navigation):
            raise ValueError("navigation: names an input twice; give each once")
        if not 0 < len(set(self.sentences)) == len(self.sentences):
            raise ValueError("sentences: are none, or one twice; give each kind once, or leave them out")
        if self.pixels > PIXELS:
            raise ValueError(
                f"cameras: show {self.pixels} pixels at a decision, histories included; at most {PIXELS} are drawn: "
                "take smaller pictures, or fewer"
            )
        return self

    @property
    def pixels(self) -> int:
        """Pixels that are shown at a decision."""
        return sum(camera.width * camera.height * camera.history for camera in self.cameras)

    @property
    def picture_bytes(self) -> int:
        """Bytes that its pictures come to at a decision, at most: three for a pixel of colours, half as JPEGs."""
        sizes = (
            (one.width * one.height * one.history * (3 if one.kind == "rgb" else 1), one.jpeg) for one in self.cameras
        )
        return sum(size if jpeg is None else size // 2 for size, jpeg in sizes)

    @property
    def text(self) -> str:
        """The rig as JSON."""
        return self.model_dump_json(exclude_defaults=True)

    @property
    def in_words(self) -> str:
        """The rig in a line, for pages and logs."""
        shown = [
            f"{camera.name} {camera.width} x {camera.height}{f' x {camera.history}' if camera.history > 1 else ''}"
            for camera in self.cameras
        ]
        told = [str(one).replace("_", " ") for one in self.navigation]
        return f"{', '.join((*shown, *told))}; {self.rate} decisions per second; answers with {self.action.kind}"


Sight = Track | Rig
"""What an agent is shown: a track's observations, or those of a rig."""
_RIG: Final = TypeAdapter(Rig)


def rig_of(given: Any) -> Rig | None:
    """Return a rig that is given as one, as its JSON or as plain values; None for None.

    Raises:
        RigError: It is none. The text names the first field that is wrong.
    """
    try:
        if given is None or isinstance(given, Rig):
            return given
        # Strict as the service is: no text or truth for a number.
        return _RIG.validate_json(
            given if isinstance(given, str | bytes) else to_json(given, fallback=repr), strict=True
        )
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        message = re.sub("^Value error, ", "", first["msg"])
        raise RigError(f"rig{''.join(f'.{part}' for part in first['loc'])}: {message}") from error


def sight_of(track: Track, rig: Rig | None) -> Sight:
    """Return what an agent of a track is shown.

    Raises:
        RigError: The track does not allow the rig.
    """
    if rig is None:
        return track
    if track not in {Track.CAMERA, Track.SEGMENTATION, Track.WORDS}:
        raise RigError(f"rig: the {track} track has none; leave it out, or take the track camera")
    classes = [camera.name for camera in rig.cameras if camera.kind == "segmentation"]
    if classes and track is not Track.SEGMENTATION:
        raise RigError(f"rig.cameras: {classes[0]} shows classes; let its kind be rgb, or take the track segmentation")
    if (track is Track.WORDS) != (NavigationInput.SENTENCE in rig.navigation):
        remedy = "let navigation be sentence" if track is Track.WORDS else "take that track, or leave sentence out"
        raise RigError(f"rig.navigation: the track words has sentences, and no other track has; {remedy}")
    if track is Track.WORDS and len(rig.navigation) > 1:
        raise RigError("rig.navigation: the track words has the sentence alone; leave the other inputs out")
    return rig


def track_of(rig: Rig) -> Track:
    """Return the track of an agent that says nothing but its rig."""
    if NavigationInput.SENTENCE in rig.navigation:
        return Track.WORDS
    return Track.SEGMENTATION if any(one.kind == "segmentation" for one in rig.cameras) else Track.CAMERA


def sight_from(text: str) -> Sight:
    """Return what :func:`text_of` wrote."""
    return _RIG.validate_json(text) if text.startswith("{") else Track(text)


def text_of(sight: Sight) -> str:
    """Return a track's name, or a rig's JSON."""
    return sight.text if isinstance(sight, Rig) else sight.value
