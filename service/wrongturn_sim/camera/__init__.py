"""Pictures of what a car's camera sees, in RGB and as classes.

The first picture takes longer: numba compiles the kernels, or reads them from its cache.
"""

from wrongturn_sim.camera.pinhole import Camera
from wrongturn_sim.camera.renderer import Renderer, render_batch
from wrongturn_sim.camera.weathers import LOOKS, WeatherLook, look_of
from wrongturn_sim.camera.world import World
from wrongturn_sim.errors import CameraError, UnknownWeatherError

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
