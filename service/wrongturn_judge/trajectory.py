"""The record of an episode: everything that the judge reads, and nothing that differs between runs."""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from wrongturn_judge.errors import TrajectoryError
from wrongturn_protocol import Command, Trial

RoadUser = tuple[float, float, float, float, float, float]
"""Another road user: x, y of the centre (m), yaw (rad), length, width (m), speed (m/s)."""


class Row(NamedTuple):
    """The state at time ``t``, and the command and action that led to it.

    The first row is the start, at t = 0, before any action. Each further row is one sub-step of 0.05 s.
    """

    t: float
    """Time since the start, seconds."""
    x: float
    y: float
    yaw: float
    """Pose of the body's centre in the town's frame: metres, metres, radians counter-clockwise from east."""
    v: float
    """Speed, m/s."""
    steering: float
    """Applied steering, -1 full left to 1 full right."""
    command: int
    """Command that the agent got for the sub-step that ends here; in the first row, for the one that begins here."""
    route_command: int
    """The route's command at the same time."""
    steer: float
    throttle: float
    brake: float
    """Action of the sub-step that ends here, rounded to float32."""
    road_users: tuple[RoadUser, ...] = ()
    """Other road users near the car at ``t``."""


class Appearance(NamedTuple):
    """What the camera needs to know of a road user beyond its row."""

    height: float
    """Metres."""
    kind: int
    """0 for a vehicle, 1 for a pedestrian."""
    colour: int
    """Number of its colour."""


GUESSED_PEDESTRIAN: Final = Appearance(1.7, 1, 0)
GUESSED_VEHICLE: Final = Appearance(1.5, 0, 0)
"""What road users of old trajectories look like, which do not say it."""
_PEDESTRIAN_LENGTH: Final = 0.5

COLUMNS: Final = tuple(name for name in Row._fields if name != "road_users")
"""Columns that hold numbers, in the order of the JSON."""


@dataclass
class Trajectory:
    """The rows of an episode, and its trial."""

    trial: Trial
    town_sha256: str
    """Checksum of the town, whose geometry the judge needs."""
    rows: list[Row] = field(default_factory=list)
    road_user_numbers: list[tuple[int, ...]] = field(default_factory=list)
    """For each row, the numbers of its road users, in the same order. Empty without traffic, and in trajectories from
    before it existed. The judge does not read it."""
    appearances: tuple[Appearance, ...] = ()
    """The road users' looks, by their numbers."""

    def to_json(self) -> bytes:
        """Return canonical JSON: the same episode gives the same bytes.

        It is a flat object: the trial (its id under ``trial``), ``town_sha256``, a list of numbers for each of
        :data:`COLUMNS`. If any row has road users, it has ``road_users`` too, and with them ``road_user_numbers`` and
        ``appearances`` (height, kind, colour), if they are known.
        """
        columns: dict[str, Any] = {name: [] for name in COLUMNS}
        if self.rows:
            columns = dict(zip(Row._fields, zip(*self.rows, strict=True), strict=True))
            if not any(columns["road_users"]):
                del columns["road_users"]
            elif self.road_user_numbers:
                columns |= {"road_user_numbers": self.road_user_numbers, "appearances": self.appearances}
        trial = self.trial.model_dump(mode="json")
        head = {"trial": trial.pop("id"), **trial, "town_sha256": self.town_sha256}
        return json.dumps({**head, **columns}, separators=(",", ":"), allow_nan=False).encode("ascii")

    @classmethod
    def from_json(cls, data: bytes | str) -> Self:
        """Return the trajectory that :meth:`to_json` wrote. Raises TrajectoryError, which names the field."""
        try:
            message = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise TrajectoryError(
                f"trajectory: not JSON ({error}); give the bytes of an episode's trajectory"
            ) from None
        if not isinstance(message, dict):
            raise TrajectoryError("trajectory: not an object; give the bytes of an episode's trajectory")
        try:
            lists = [message.pop(name) for name in COLUMNS]
            others = message.pop("road_users", None)
            numbers = [tuple(row) for row in message.pop("road_user_numbers", ())]
            appearances = tuple(
                Appearance(float(height), int(kind), int(colour))
                for height, kind, colour in message.pop("appearances", ())
            )
            town_sha256 = message.pop("town_sha256")
            trial = Trial.model_validate({"id": message.pop("trial"), **message})
            users: Iterable[tuple[RoadUser, ...]] = (
                (tuple(tuple(user) for user in row) for row in others) if others else (() for _ in lists[0])
            )
            rows = [Row(*values) for values in zip(*lists, users, strict=True)]
        except KeyError as error:
            raise TrajectoryError(f"trajectory.{error.args[0]}: missing; give a whole trajectory") from None
        except ValidationError as error:
            raise TrajectoryError(f"trajectory: {error.errors()[0]['loc']}: {error.errors()[0]['msg']}") from None
        except (TypeError, ValueError, AttributeError) as error:
            raise TrajectoryError(f"trajectory: {error}; give columns of equal length") from None
        found = cls(trial, town_sha256, rows, numbers, appearances)
        found._check_numbers()
        return found

    def _check_numbers(self) -> None:
        numbers = self.road_user_numbers
        if not numbers:
            return
        known = range(len(self.appearances))
        if [len(row) for row in numbers] != [len(row.road_users) for row in self.rows] or any(
            number not in known for row in numbers for number in row
        ):
            raise TrajectoryError(
                "trajectory.road_user_numbers: do not fit road_users and appearances; give one for each"
            )

    def others(self, row: int) -> NDArray[np.float64]:
        """Return a row's road users for pictures, float64 (n, 8): x, y, yaw, length, width, height, kind, colour."""
        users = self.rows[row].road_users
        if self.road_user_numbers:
            looks = [self.appearances[number] for number in self.road_user_numbers[row]]
        else:
            looks = [GUESSED_PEDESTRIAN if user[3] <= _PEDESTRIAN_LENGTH else GUESSED_VEHICLE for user in users]
        return np.array([(*user[:5], *look) for user, look in zip(users, looks, strict=True)]).reshape(-1, 8)

    @property
    def looks_guessed(self) -> bool:
        """Whether there are road users whose looks it does not say, because it was driven by an older version."""
        return not self.road_user_numbers and any(row.road_users for row in self.rows)

    def check_rows(self) -> None:
        """Raise TrajectoryError if there are no rows, or a value is not a finite number: pictures need them."""
        if not self.rows:
            raise TrajectoryError("trajectory: has no rows; give one of an episode that began")
        for name in Row._fields:
            values = [getattr(row, name) for row in self.rows]
            if name == "road_users":
                values = [(*user, *[None] * (6 - len(user))) for users in values for user in users]
            try:
                right = bool(np.isfinite(np.array(values, np.float64)).all())
            except (TypeError, ValueError):
                right = False
            if not right:
                raise TrajectoryError(f"trajectory.{name}: not all values are finite numbers; give a whole trajectory")
        for name in ("command", "route_command"):
            unknown = {getattr(row, name) for row in self.rows} - set(Command)
            if unknown:
                raise TrajectoryError(f"trajectory.{name}: {unknown.pop()} is no command; give a whole trajectory")

    @property
    def sha256(self) -> str:
        """SHA-256 of the canonical JSON, hexadecimal."""
        return hashlib.sha256(self.to_json()).hexdigest()
