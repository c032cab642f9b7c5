"""Controls of what an agent answers with: controls, changes of the steering, or a trajectory."""

from collections.abc import Callable
from typing import Any

from wrongturn_protocol.actions import three_numbers
from wrongturn_protocol.episodes import Action, ActionError
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.rigs import Rig, RigAction, Sight
from wrongturn_protocol.tracking import Tracker


def driver_of(sight: Sight) -> Callable[[Any, Observation], Action]:
    """Return what makes controls of an agent's answers in one episode. It remembers mean errors and the steering.

    Its arguments are the answer and the observation that it answers. An Action is taken for controls of any agent. It
    raises ActionError.
    """
    action, rate = (sight.action, sight.rate) if isinstance(sight, Rig) else (RigAction(), 10)
    if action.kind == "waypoints":
        tracker = Tracker(action.times, side=action.side, behind=action.behind, gains=action.gains, decision_s=1 / rate)

        def follow(answer: Any, observation: Observation) -> Action:
            if isinstance(answer, Action):
                return answer
            try:
                return tracker.controls(answer, float(observation["speed"][0]))
            except ValueError as error:
                raise ActionError(str(error)) from error

        return follow
    steering: float | None = None

    def control(answer: Any, observation: Observation) -> Action:
        nonlocal steering
        if isinstance(answer, Action):  # checked again, because model_construct and model_copy check nothing
            return Action(answer.steer, answer.throttle, answer.brake)
        steer, throttle, brake = three_numbers(answer, ActionError)
        if action.kind == "increments":
            if not -2.0 <= steer <= 2.0:
                raise ActionError(f"action.steer: its change is {steer}; give -2 to 2")
            # What was asked for last, because the wheels may still be on their way; after a resumption what they show.
            before = float(observation["steering"][0]) if steering is None else steering
            steer = steering = min(max(before + steer, -1.0), 1.0)
        return Action(steer, throttle, brake)

    return control
