"""What the cameras of the adapters see, for ``docs/adapters.md``: ``python -m lab.adapter_views`` draws it."""

import importlib.util
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from wrongturn_networks import load_suite
from wrongturn_protocol import Rig
from wrongturn_sim import Episode

ADAPTERS: Final = Path("docs/examples/adapters")
PICTURE: Final = Path("docs/pictures/adapters.webp")
SHOWN: Final = {
    "tcp": ("Tcp", "TCP"), "transfuser": ("TransFuser", "Latent TransFuser"), "navsim": ("Navsim", "NAVSIM"),
    "simlingo": ("SimLingo", "SimLingo"), "openpilot": ("Openpilot", "openpilot"), "carton": ("Carton", "the paper"),
}  # fmt: skip
WIDE: Final = 1024
"""Width of the picture, pixels. No camera is enlarged, except the paper's to twice its size."""


def rig_of(file: str, name: str) -> Rig:
    """Return the rig of an adapter's class."""
    spec = importlib.util.spec_from_file_location(file, ADAPTERS / f"{file}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    rig: Rig = getattr(module, name).rig
    return rig


def seen(rig: Rig) -> NDArray[np.uint8]:
    """Return the newest picture of each camera at the start of a trial, side by side."""
    episode = Episode(load_suite("smoke@3").open_draw.trials[2], rig)
    observation: Any = episode.reset()
    episode.abort()
    pictures = [observation[one.name] for one in rig.cameras]
    return np.concatenate([one if one.ndim == 3 else one[-1] for one in pictures], axis=1)


def main() -> None:
    """Draw a row for each adapter."""
    rows = []
    for file, (name, title) in SHOWN.items():
        row = Image.fromarray(seen(rig_of(file, name)))
        scale = min(WIDE / row.width, 2.0 if row.width < 300 else 1.0)
        row = row.resize((round(row.width * scale), round(row.height * scale)))
        ImageDraw.Draw(row).text((6, 4), title, fill="white", font_size=18, stroke_width=2, stroke_fill="black")
        rows.append(row)
    sheet = Image.new("RGB", (WIDE, sum(row.height + 6 for row in rows) - 6), "white")
    top = 0
    for row in rows:
        sheet.paste(row, (0, top))
        top += row.height + 6
    sheet.save(PICTURE, quality=60, method=6)


if __name__ == "__main__":
    main()
