"""The record of an episode: everything that the judge looks at, and nothing that differs from run to run."""

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Self

from pydantic import ValidationError

from wrongturn_protocol import Trial
from wrongturn_sim.errors import TrajectoryError

RoadUser = tuple[float, float, float, float, float, float]
"""x, y (m, centre), yaw (rad), length, width (m), speed (m/s) of another road user."""


class Row(NamedTuple):
    """One instant: the state at ``t`` and what led to it since the row before.

    The first row is the start, at t = 0, with no action yet; then comes one for each sub-step of 0.05 s.
    """

    t: float
    """Seconds since the start."""
    x: float
    y: float
    yaw: float
    """Body's centre in the town's frame: metres, metres, radians counter-clockwise from east."""
    v: float
    """m/s."""
    steering: float
    """Applied, -1 full left to 1 full right."""
    command: int
    """Delivered to the agent for the sub-step that ends here (the first row: for the one that begins here)."""
    route_command: int
    """What the route would have said, at the same time."""
    steer: float
    throttle: float
    brake: float
    """The action of the sub-step that ends here, rounded to float32."""
    road_users: tuple[RoadUser, ...] = ()
    """Others near the car at ``t``."""


COLUMNS: Final = tuple(name for name in Row._fields if name != "road_users")
"""The columns of numbers, in the order of the JSON."""


@dataclass
class Trajectory:
    """An episode's rows, with the trial that they belong to."""

    trial: Trial
    town_sha256: str
    """Of the town that it was driven in: the geometry, by reference."""
    rows: list[Row] = field(default_factory=list)

    def append(self, row: Row) -> None:
        """Add the next instant."""
        self.rows.append(row)

    def to_json(self) -> bytes:
        """Canonical JSON: the same episode gives the same bytes.

        A flat object: the trial (its id under ``trial``), ``town_sha256``, and a list of numbers for each of
        :data:`COLUMNS`; ``road_users`` is there where any row has some.
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
        """The trajectory that :meth:`to_json` wrote.

        Raises:
            TrajectoryError: it is no JSON of a trajectory; the message names the field.
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
        """Of the canonical JSON, hexadecimal."""
        return hashlib.sha256(self.to_json()).hexdigest()
