"""``wrongturn replay``. The drawing belongs to another part, which names it by an entry point."""

from pathlib import Path
from typing import Annotated, Final

import typer

from wrongturn_client.errors import ReplayError
from wrongturn_client.options import Url
from wrongturn_protocol.installing import install
from wrongturn_protocol.vocabulary import View

REPLAYS: Final = "wrongturn.replays"
"""Group of the entry point that draws."""


def replay(
    source: Annotated[
        str,
        typer.Argument(
            metavar="EPISODE|FILE",
            help="Id of an episode of a service, the file of 'run --json', or a file with a trajectory. "
            "Example: run.json",
        ),
    ],
    *,
    view: Annotated[View, typer.Option(help="What the film shows. Example: --view top")] = View.BOTH,
    video: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a film: .mp4 or .webp. Example: --video film.mp4")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write a picture of the whole episode from above, as .png. Example: --picture drive.png",
        ),
    ] = None,
    episode: Annotated[
        str | None,
        typer.Option(
            metavar="ID",
            help="Which episode of a file of 'run --json': its id, or its trial's id. "
            "Example: --episode Town01.J3-S.infeasible.s17",
        ),
    ] = None,
    size: Annotated[
        int | None, typer.Option(help="Width and height of the view from above, 160 to 2160. Example: --size 360")
    ] = None,
    twin: Annotated[
        bool, typer.Option("--twin", help="Show the twin on the right of the film. Example: --twin --video film.mp4")
    ] = False,
    url: Url = None,
) -> None:
    """Make a film or a picture of an episode that was driven; nothing is driven again.

    Example: wrongturn replay run.json --episode Town01.J3-S.infeasible.s17 --video film.mp4

    WRONGTURN_TOKEN: the token of the agent, for a practice episode. Other episodes are public once their evaluation is
    finished.
    """
    from wrongturn_client.plugins import entry_points, load  # noqa: PLC0415
    from wrongturn_client.replayed import replayed_from  # noqa: PLC0415

    if video is None and picture is None:
        raise ReplayError("replay: nothing to make; give --video FILE.mp4, --picture FILE.png, or both")
    if twin and video is None:
        raise ReplayError("--twin: only a film shows the twin; give --video FILE.mp4 too")
    points = list(entry_points(REPLAYS).values())
    if not points:
        raise ReplayError(f"replay: nothing here draws; wrongturn-service does: {install('wrongturn-service')}")
    show = load(points[0])
    found = replayed_from(source, episode, url, twin=twin)
    files = {"video": video, "picture": picture, "size": size}
    for line in show(found.trajectory, found.outcome, view=view, agent=found.agent, twin=found.twin, **files):
        typer.echo(line)
