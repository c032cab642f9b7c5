"""A stored episode, seen again without driving it."""

from typing import TYPE_CHECKING, Self

from wrongturn_networks import load_town
from wrongturn_protocol import Outcome
from wrongturn_sim.ego import SUB_STEPS
from wrongturn_sim.trajectory import Row, Trajectory

if TYPE_CHECKING:
    from wrongturn_sim.camera import Camera
    from wrongturn_sim.camera.renderer import Image


class Replay:
    """A finished episode, decision by decision.

    Decision 0 is the reset. Decision ``n`` is what the agent got in reply to its ``n``-th step.

    Args:
        trajectory: The episode's trajectory.
        outcome: The episode's outcome, if it is known.

    Raises:
        UnknownTownError: The town is not installed here.
    """

    def __init__(self, trajectory: Trajectory, outcome: Outcome | None = None) -> None:
        self.trajectory = trajectory
        self.outcome = outcome
        self.town = load_town(trajectory.trial.town)

    @classmethod
    def from_json(cls, trajectory: bytes | str, outcome: Outcome | None = None) -> Self:
        """Return the replay of a trajectory's canonical JSON. Raises TrajectoryError."""
        return cls(Trajectory.from_json(trajectory), outcome)

    def __len__(self) -> int:
        """Return the number of decisions, with the reset."""
        return 1 - (1 - len(self.trajectory.rows)) // SUB_STEPS

    def row(self, decision: int) -> Row:
        """Return the car's state at a decision. Raises IndexError."""
        if not 0 <= decision < len(self):
            raise IndexError(f"decision: {decision} is not one of 0 to {len(self) - 1}")
        # The last step ends early if its first sub-step brings the verdict.
        return self.trajectory.rows[min(decision * SUB_STEPS, len(self.trajectory.rows) - 1)]

    def camera(self, decision: int, camera: "Camera | None" = None) -> "tuple[Image, Image]":
        """Return what the camera saw at a decision: rgb (height, width, 3) and segmentation (height, width), uint8.

        With the benchmark's camera, which is the default, these are the bytes that the agent got.
        """
        from wrongturn_sim.camera import Renderer, World  # noqa: PLC0415 - slow, and only pictures need it

        row, trial = self.row(decision), self.trajectory.trial
        renderer = Renderer(World.of(self.town), camera, trial.weather, trial.seed)
        return renderer.render(row.x, row.y, row.yaw, decision)
