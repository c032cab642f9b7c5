"""Pictures of what a car's camera sees, in RGB and as classes.

The first picture takes longer: numba compiles the kernels, or reads them from its cache.
"""

from wrongturn_sim.camera.pinhole import Camera as Camera
from wrongturn_sim.camera.renderer import Renderer as Renderer
from wrongturn_sim.camera.renderer import render_batch as render_batch
from wrongturn_sim.camera.weathers import LOOKS as LOOKS
from wrongturn_sim.camera.weathers import WeatherLook as WeatherLook
from wrongturn_sim.camera.weathers import look_of as look_of
from wrongturn_sim.camera.world import World as World
from wrongturn_sim.errors import CameraError as CameraError
from wrongturn_sim.errors import UnknownWeatherError as UnknownWeatherError
