"""The look of each weather: sun, sky, haze, wetness and rain."""

import functools
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol import Weather
from wrongturn_sim.errors import CameraError, UnknownWeatherError

Colour = tuple[float, float, float]

NOON: Final = (math.radians(58.0), math.radians(-118.0))
"""Elevation and bearing of the sun, radians; the bearing counts counter-clockwise from east."""
SUNSET: Final = (math.radians(13.0), math.radians(158.0))
"""The same at sunset."""
SUNS: Final = (NOON, SUNSET)
"""All suns. The ground's raster holds the shadows of each."""


@dataclass(frozen=True)
class WeatherLook:
    """Light and air of a weather. Colours are red, green and blue, each as a share of full white."""

    sun: tuple[float, float]
    """Where the sun is: one of ``SUNS``."""
    sunlight: Colour
    """Light of the sun on a surface that faces it."""
    skylight: Colour
    """Light that comes from everywhere, also in the shade."""
    zenith: Colour
    """The sky straight above."""
    horizon: Colour
    """The sky at the horizon."""
    haze: Colour
    """Colour that distant things fade to."""
    view: float
    """Distance at which a thing has half its contrast, metres."""
    wetness: float = 0.0
    """How strongly the ground mirrors, 0 to 1."""
    clouds: float = 0.3
    """Cover of the sky, 0 to 1."""
    cloud: Colour = (1.0, 1.0, 1.0)
    """Colour of the clouds."""
    rain: float = 0.0
    """Number of drops for each column of a picture with 64 rows."""
    streak: float = 5.0
    """Length of a drop's streak, pixels."""
    glow: float = 0.0
    """How strongly the sky glows around the sun, 0 to 1."""
    lamps: float = 0.0
    """Share of windows that are lit."""

    def mixed(self, other: "WeatherLook", share: float) -> "WeatherLook":
        """Return a look between this and another: ``share``, 0 to 1, is the other's part. The sun is this look's.

        Raises CameraError.
        """
        if not 0.0 <= share <= 1.0:
            raise CameraError(f"share: is {share!r}; give 0 to 1")
        mix: dict[str, Any] = {}
        for name in (field.name for field in fields(self) if field.name != "sun"):
            value = (1.0 - share) * np.array(getattr(self, name)) + share * np.array(getattr(other, name))
            mix[name] = tuple(value.tolist()) if value.ndim else float(value)
        return replace(self, **mix)


def _looks() -> Mapping[Weather, WeatherLook]:
    tables = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
    looks = {}
    for name, table in tables.items():
        sun = {"noon": NOON, "sunset": SUNSET}[table.pop("sun")]
        fields: dict[str, Any] = {key: tuple(one) if isinstance(one, list) else one for key, one in table.items()}
        looks[Weather(name)] = WeatherLook(sun, **fields)
    return MappingProxyType(looks)


LOOKS: Final = _looks()

# Positions in the array that `look_of` returns and the kernels read. Plain integers, so that numba freezes them.
SUN, SUNLIGHT, SKYLIGHT, ZENITH, HORIZON, HAZE_COLOUR = range(0, 18, 3)
"""Each is the position of the first of three numbers. SUN is the unit vector to the sun. SUNLIGHT and SKYLIGHT are red,
green and blue as shares of full white. The others are colours, 0 to 255."""
HAZE_RATE, WETNESS, CLOUDS = range(18, 21)
"""The first is 1 / view; the others are fields of :class:`WeatherLook`, as are RAIN to LAMPS."""
CLOUD = 21
"""Likewise the colour of the clouds, 0 to 255."""
RAIN, STREAK, GLOW, LAMPS = range(24, 28)
SHADOW_BIT = 28
"""The bit of the ground's codes that this weather's sun sets in the shade, as a value: 64 or 128."""
GROUND_COLOURS = 32
"""From here on: red, green and blue of each of the 256 codes of the ground, 0 to 255."""
SIZE: Final = GROUND_COLOURS + 3 * 256

_TONES = np.arange(16) / 15.0


def ground_albedo() -> NDArray[np.float64]:
    """Return the colours of vegetation, road, marking and sidewalk in each tone: (4, 16, 3), 0 to 255."""
    albedo = np.empty((4, 16, 3))
    albedo[0] = np.array([50.0, 78.0, 28.0]) + _TONES[:, None] * np.array([98.0, 78.0, 44.0])
    albedo[1] = np.array([46.0, 47.0, 50.0]) + _TONES[:, None] * np.array([84.0, 83.0, 80.0])
    white = np.array([176.0, 176.0, 172.0]) + (_TONES[:8, None] * 2) * np.array([60.0, 60.0, 58.0])
    yellow = np.array([170.0, 146.0, 66.0]) + (_TONES[:8, None] * 2) * np.array([62.0, 52.0, 18.0])
    albedo[2] = np.concatenate([white, yellow])
    albedo[3] = np.array([82.0, 78.0, 72.0]) + _TONES[:, None] * np.array([112.0, 108.0, 102.0])
    return albedo


def _ground(look: WeatherLook) -> NDArray[np.float64]:
    """Return the colour of each code of the ground's raster under this light: (256, 3), 0 to 255."""
    albedo = ground_albedo()
    wet = 1.0 - look.wetness * np.array([0.10, 0.42, 0.22, 0.34])
    shadow = 6 + SUNS.index(look.sun)
    colours = np.empty((256, 3))
    for code in range(256):
        direct = 0.0 if code >> shadow & 1 else math.sin(look.sun[0]) ** 0.5
        light = np.array(look.skylight) + direct * np.array(look.sunlight)
        kind = code >> 4 & 3
        colours[code] = albedo[kind, code & 15] * wet[kind] * light
    return colours


@functools.lru_cache(maxsize=32)
def pack(look: WeatherLook) -> NDArray[np.float64]:
    """Return a look as the renderer takes it: (SIZE,), read-only."""
    elevation, bearing = look.sun
    packed = np.zeros(SIZE)
    flat = math.cos(elevation)
    packed[SUN : SUN + 3] = flat * math.cos(bearing), flat * math.sin(bearing), math.sin(elevation)
    packed[SUNLIGHT : SUNLIGHT + 3], packed[SKYLIGHT : SKYLIGHT + 3] = look.sunlight, look.skylight
    colours = {ZENITH: look.zenith, HORIZON: look.horizon, HAZE_COLOUR: look.haze, CLOUD: look.cloud}
    for first, colour in colours.items():
        packed[first : first + 3] = [255 * part for part in colour]
    packed[HAZE_RATE] = 1.0 / look.view
    packed[WETNESS], packed[CLOUDS], packed[RAIN] = look.wetness, look.clouds, look.rain
    packed[STREAK], packed[GLOW], packed[LAMPS] = look.streak, look.glow, look.lamps
    packed[SHADOW_BIT] = 1 << (6 + SUNS.index(look.sun))
    packed[GROUND_COLOURS:] = _ground(look).ravel()
    packed.flags.writeable = False
    return packed


def look_of(weather: Weather | str) -> NDArray[np.float64]:
    """Return a weather as the renderer takes it: (SIZE,), read-only. Raises UnknownWeatherError, which lists all."""
    try:
        return pack(LOOKS[Weather(weather)])
    except ValueError:
        raise UnknownWeatherError(f"weather: {weather!r} is unknown; give one of {', '.join(Weather)}") from None
