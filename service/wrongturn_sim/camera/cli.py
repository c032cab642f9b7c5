"""``wrongturn picture``: save what the camera sees."""

from pathlib import Path
from typing import Annotated

import typer


def picture(
    town: Annotated[
        str, typer.Argument(help="Name or folder of the town; 'wrongturn towns' lists them. Example: Town01")
    ],
    approach: Annotated[
        str, typer.Argument(help="Approach in that town; 'wrongturn towns Town01' lists them. Example: J1-N")
    ],
    weather: Annotated[
        str, typer.Option(help="Weather, as CARLA names it. Example: --weather HardRainNoon")
    ] = "ClearNoon",
    distance: Annotated[
        float, typer.Option(help="Metres from the car to the stop line. Example: --distance 12")
    ] = 20.0,
    seed: Annotated[int, typer.Option(help="Seed of the rain. Example: --seed 7")] = 0,
    scale: Annotated[
        int, typer.Option(help="How many times to enlarge the picture. Example: --scale 2", min=1, max=16)
    ] = 4,
    file: Annotated[Path, typer.Option(help="File to write: .png, .jpg or .webp. Example: --file town.png")] = Path(
        "picture.png"
    ),
) -> None:
    """Save what the camera sees before a junction: colours above, classes below.

    Example: wrongturn picture Town01 J1-N --weather WetNoon --distance 12
    """
    import cv2  # noqa: PLC0415
    import numpy as np  # noqa: PLC0415

    from wrongturn_networks.catalogue import find_town  # noqa: PLC0415
    from wrongturn_sim.camera import Renderer, World  # noqa: PLC0415
    from wrongturn_sim.camera.palette import PALETTE, pose_before  # noqa: PLC0415

    try:
        built = find_town(town)
        # NaN fails this check too.
        if not abs(distance) <= 1000:
            raise ValueError(f"distance: is {distance:g}; give metres, -1000 to 1000")
        pose = pose_before(built.approach(approach), distance)
        rgb, segmentation = Renderer(World.of(built), weather=weather, seed=seed).render(*pose)
        image = np.concatenate([rgb, PALETTE[segmentation]]).repeat(scale, axis=0).repeat(scale, axis=1)
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
