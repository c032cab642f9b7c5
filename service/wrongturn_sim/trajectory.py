"""The record of an episode: everything that the judge reads, and nothing that differs between runs."""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Self

from pydantic import ValidationError

from wrongturn_protocol import Trial
from wrongturn_sim.errors import TrajectoryError

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


COLUMNS: Final = tuple(name for name in Row._fields if name != "road_users")
"""Columns that hold numbers, in the order of the JSON."""


@dataclass
class Trajectory:
    """The rows of an episode, and its trial."""

    trial: Trial
    town_sha256: str
    """Checksum of the town, whose geometry the judge needs."""
    rows: list[Row] = field(default_factory=list)

    def append(self, row: Row) -> None:
        """Append a row."""
        self.rows.append(row)

    def to_json(self) -> bytes:
        """Return canonical JSON: the same episode gives the same bytes.

        It is a flat object: the trial (its id under ``trial``), ``town_sha256``, a list of numbers for each of
        :data:`COLUMNS`, and ``road_users`` if any row has some.
        """
        columns: dict[str, Any] = {name: [] for name in COLUMNS}
        if self.rows:
            columns = dict(zip(Row._fields, zip(*self.rows, strict=True), strict=True))
            if not any(columns["road_users"]):
                del columns["road_users"]
        trial = self.trial.model_dump(mode="json")
        head = {"trial": trial.pop("id"), **trial, "town_sha256": self.town_sha256}
        return json.dumps({**head, **columns}, separators=(",", ":"), allow_nan=False).encode("ascii")

    @classmethod
    def from_json(cls, data: bytes | str) -> Self:
        """Return the trajectory that :meth:`to_json` wrote.

        Raises:
            TrajectoryError: the data is not a trajectory; the message names the field.
        """
        try:
            message = json.loads(data)
        except ValueError as error:
            raise TrajectoryError(
                f"trajectory: not JSON ({error}); give the bytes of an episode's trajectory"
            ) from None
        if not isinstance(message, dict):
            raise TrajectoryError("trajectory: not an object; give the bytes of an episode's trajectory")
        try:
            lists = [message.pop(name) for name in COLUMNS]
            others = message.pop("road_users", None)
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
        return cls(trial, town_sha256, rows)

    @property
    def sha256(self) -> str:
        """SHA-256 of the canonical JSON, hexadecimal."""
        return hashlib.sha256(self.to_json()).hexdigest()
