"""One picture of a whole episode."""

from wrongturn_judge.trajectory import Trajectory
from wrongturn_networks import Town
from wrongturn_protocol import Outcome
from wrongturn_sim.view import scene
from wrongturn_sim.view.ground import draw_ground
from wrongturn_sim.view.views import checked_size
from wrongturn_sim.view.window import Image


def draw_picture(town: Town, trajectory: Trajectory, outcome: Outcome | None, size: int) -> Image:
    """Return an episode from above, RGB uint8 (size, size, 3).

    It shows the car's way and footprints, coloured by speed, the commands where they began, the other road users at the
    end, and the verdict.

    Raises:
        ViewError: The size is too small or too large.
    """
    rows = trajectory.rows
    window = scene.whole_window(town, rows, trajectory.trial.approach, checked_size(size))
    image, fastest = draw_ground(town, window), scene.fastest_of(rows)
    scene.draw_footprints(image, window, rows, fastest)
    scene.draw_trail(image, window, rows, fastest)
    scene.draw_road_users(image, window, rows[-1].road_users)
    scene.draw_car(image, window, rows[-1])
    scene.draw_commands(image, window, rows)
    if outcome is not None:
        scene.draw_verdict(image, window, rows[-1], outcome)
    scene.draw_scales(image, window, fastest)
    return image
