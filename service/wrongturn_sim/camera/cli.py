"""``wrongturn picture``: what the camera sees, as a file."""

from pathlib import Path
from typing import Annotated

import typer


def picture(
    town: Annotated[str, typer.Argument(help="Name of a town: see 'wrongturn towns'.")],
    approach: Annotated[str, typer.Argument(help="An approach of it, as J1-S.")],
    weather: Annotated[str, typer.Option(help="One of CARLA's presets that the benchmark has.")] = "ClearNoon",
    distance: Annotated[float, typer.Option(help="Metres before the stop line.")] = 20.0,
    seed: Annotated[int, typer.Option(help="Of the rain.")] = 0,
    scale: Annotated[int, typer.Option(help="Each pixel becomes a square of so many.", min=1, max=16)] = 4,
    file: Annotated[Path, typer.Option(help="Where to; the ending tells the format.")] = Path("picture.png"),
) -> None:
    """Take a picture: what the camera sees before a junction, in colours above, in classes below."""
    import cv2  # noqa: PLC0415
    import numpy as np  # noqa: PLC0415

    from wrongturn_networks import load_town  # noqa: PLC0415
    from wrongturn_sim.camera import Renderer, World  # noqa: PLC0415
    from wrongturn_sim.camera.palette import coloured, larger, pose_before  # noqa: PLC0415

    try:
        built = load_town(town)
        # Not so for NaN either.
        if not abs(distance) <= 1000:
            raise ValueError(f"distance: is {distance:g}; give metres, -1000 to 1000")
        pose = pose_before(built.approach(approach), distance)
        rgb, segmentation = Renderer(World.of(built), weather=weather, seed=seed).render(*pose)
        image = larger(np.concatenate([rgb, coloured(segmentation)]), scale)
        try:
            written, packed = cv2.imencode(file.suffix, image[:, :, ::-1])
        except cv2.error:
            written = False
        if not written:
            raise ValueError(f"file: pictures cannot be written as {file.name!r}; give a name that ends in .png")
        file.write_bytes(packed.tobytes())
    except (ValueError, LookupError, OSError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(1) from None
    typer.echo(f"{file}: {built.name} {approach}, {distance:g} m before the stop line, {weather}")
