"""The experiment's drives: which driver drives which trial, in which order, and the file that keeps them."""

import json
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
from drives import Drive, drive
from erratic import astray, hesitant

from wrongturn_agents.agent import Agent
from wrongturn_agents.registry import resolve
from wrongturn_networks import load_suite
from wrongturn_protocol import Trial

SUITE: Final = "wrong-command@2"
SECRET: Final = "blind labelling 2"
"""Secret of the draw, of the erratic drivers and of the order."""
SHARES: Final = {
    "obeys-blindly": 18,
    "careful": 18,
    "ignores-commands": 18,
    "ppo-image": 18,
    "ppo-auxiliary": 18,
    "ppo-segmentation": 18,
    "hesitant": 21,
    "astray": 21,
}
"""Number of episodes of each driver."""
ERRATIC: Final[dict[str, Callable[[str], Agent]]] = {"hesitant": hesitant, "astray": astray}
HERE: Final = Path(__file__).parent
DRIVES: Final = HERE / "drives.npz"
"""All actions. Do not look into it before you have labelled."""


def plan(secret: str = SECRET) -> list[tuple[str, Trial]]:
    """Return driver and trial of each number. No driver drives a trial twice."""
    episodes = load_suite(SUITE).draw(secret).episodes
    numbers = random.Random(secret)
    pairs = [(driver, trial) for driver, count in SHARES.items() for trial in numbers.sample(episodes, count)]
    numbers.shuffle(pairs)
    return pairs


def drive_all(secret: str = SECRET) -> Iterator[Drive]:
    """Drive the whole plan, in its order."""
    agents = {name: resolve(name).make() for name in SHARES if name not in ERRATIC}
    for number, (driver, trial) in enumerate(plan(secret)):
        agent = agents[driver] if driver in agents else ERRATIC[driver](f"{secret} {number}")
        yield drive(driver, agent, trial)


def save(drives: list[Drive], file: Path = DRIVES) -> None:
    """Keep drivers, trials and actions. Trajectories follow from these."""
    told = [{"driver": one.driver, "trial": one.trial.model_dump(mode="json")} for one in drives]
    counts = np.array([len(one.actions) for one in drives])
    actions = np.concatenate([one.actions for one in drives])
    np.savez_compressed(file, told=np.array(json.dumps(told)), counts=counts, actions=actions)


def load(file: Path = DRIVES) -> list[Drive]:
    """Return the drives that a file keeps."""
    with np.load(file) as kept:
        told, counts, actions = json.loads(str(kept["told"])), kept["counts"], kept["actions"]
    parts = np.split(actions, np.cumsum(counts)[:-1])
    return [
        Drive(one["driver"], Trial.model_validate(one["trial"]), part) for one, part in zip(told, parts, strict=True)
    ]
