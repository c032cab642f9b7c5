"""Base class of all disturbances."""

from typing import Any, ClassVar

from wrongturn_networks.faults.fault import SILENCE, CommandFault, Dose, Ending, reaction_to_silence
from wrongturn_protocol import Reaction, Track, Trial
from wrongturn_protocol.observations import Observation


class Disturbance(CommandFault):
    """Leaves the command right, and changes what the agent sees or how the car answers.

    A dose of 0 changes nothing. Pictures for people, such as those of a replay, are made without it.
    """

    onset = "at the start"
    end = "at the end"
    dose: ClassVar[Dose]
    reactions = SILENCE
    tracks: ClassVar[tuple[Track, ...]] = (Track.CAMERA, Track.SEGMENTATION, Track.WORDS)
    """Tracks whose agents can notice it."""
    rate = 10
    """Decisions in a second."""

    @classmethod
    def reaction(cls, trial: Trial, ending: Ending) -> Reaction:  # noqa: ARG003
        """Return whether the car took an exit, or stopped."""
        return reaction_to_silence(ending)

    @property
    def signed(self) -> float:
        """The dose, negative for an odd seed."""
        return -self.amount if self.seed % 2 else self.amount

    def mounted(self, camera: Any) -> Any:
        """Return the ``wrongturn_sim.camera.Camera`` of the agent's pictures in place of this one."""
        return camera

    def steered(self, steer: float) -> float:
        """Return the steering, -1 to 1, that reaches the wheels."""
        return steer

    def developed(self, pictures: Observation, decision: int) -> Observation:  # noqa: ARG002
        """Return what becomes of new pictures of the cameras, colours (h, w, 3) or classes (h, w), by their names."""
        return pictures

    def sensed(self, observation: Observation, decision: int) -> Observation:  # noqa: ARG002
        """Return what the agent is shown at a decision, 0 for the first. Called once for each decision, in order."""
        return observation
