"""What a car's camera sees: pictures of a town in RGB and as classes.

Numba's kernels are compiled, or read from their cache, with the first picture.
"""

from wrongturn_sim.camera.errors import CameraError, UnknownWeatherError
from wrongturn_sim.camera.pinhole import Camera
from wrongturn_sim.camera.renderer import Renderer, render_batch
from wrongturn_sim.camera.weathers import LOOKS, WeatherLook, look_of
from wrongturn_sim.camera.world import World

__all__ = [
    "LOOKS",
    "Camera",
    "CameraError",
    "Renderer",
    "UnknownWeatherError",
    "WeatherLook",
    "World",
    "look_of",
    "render_batch",
]
