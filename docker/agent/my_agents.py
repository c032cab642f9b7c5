"""An agent of your own, for the profile ``agent`` of compose: see docs/submitting.md."""

from wrongturn_client import Action


class Slow:
    """Creeps straight ahead, whatever the command is."""

    track = "privileged"

    def reset(self, observation_space):
        """Forget the last episode."""

    def act(self, observation):
        """Return the next action."""
        too_fast = observation["speed"][0] > 3
        return Action(steer=0.0, throttle=0.0 if too_fast else 0.4, brake=0.0)
