"""A store of one drive, so that pictures can be drawn without a database."""

from typing_extensions import override

from wrongturn_judge.trajectory import Row, Trajectory
from wrongturn_networks import draw_trial, load_town
from wrongturn_protocol import Command, FaultKind
from wrongturn_service.storage.store import Store


class StoredDrive(Store):
    """Every episode is that of a car that stands for one decision, near another road user."""

    def __init__(self) -> None:
        pass

    @override
    async def trajectory(self, episode_id: str) -> tuple[bytes, str]:
        town = load_town("Town01")
        trial = draw_trial(town, "J3-S", FaultKind.NONE, 0, weather="WetNoon")
        other = (10.0, 0.0, 0.0, 4.5, 1.8, 0.0)
        rows = [Row(0.05 * i, *(0.0,) * 5, Command.LEFT, Command.LEFT, *(0.0,) * 3, (other,)) for i in range(3)]
        return Trajectory(trial, town.sha256, rows).to_json(), ""
