"""The experiments: which driver drives which trial, in which order, and the files that keep what came of it."""

import json
import random
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from drives import Drive, drive
from erratic import astray, awkward, hesitant

from wrongturn_agents.agent import Agent
from wrongturn_agents.registry import resolve
from wrongturn_networks import load_suite
from wrongturn_protocol import Trial

SUITE: Final = "wrong-command@3"
ERRATIC: Final[dict[str, Callable[[str], Agent]]] = {"hesitant": hesitant, "astray": astray, "awkward": awkward}


@dataclass(frozen=True)
class Experiment:
    """Some drives to label."""

    name: str
    """Name of the folder with its files."""
    secret: str
    """Secret of the draw, of the erratic drivers and of the order."""
    shares: Mapping[str, int]
    """Number of episodes of each driver."""

    @property
    def folder(self) -> Path:
        """Folder of drives, labels and verdicts."""
        return Path(__file__).parent / self.name

    @property
    def drives(self) -> Path:
        """File of all actions. Do not look into it before you have labelled."""
        return self.folder / "drives.npz"

    @property
    def labels(self) -> Path:
        """File of the labels."""
        return self.folder / "labels.json"

    @property
    def verdicts(self) -> Path:
        """File of what the judge said."""
        return self.folder / "verdicts.json"

    def plan(self) -> list[tuple[str, Trial]]:
        """Return driver and trial of each number. No driver drives a trial twice."""
        episodes = load_suite(SUITE).draw(self.secret).episodes
        numbers = random.Random(self.secret)
        pairs = [(driver, trial) for driver, count in self.shares.items() for trial in numbers.sample(episodes, count)]
        numbers.shuffle(pairs)
        return pairs

    def drive_all(self) -> Iterator[Drive]:
        """Drive the whole plan, in its order."""
        agents = {name: resolve(name).make() for name in self.shares if name not in ERRATIC}
        for number, (driver, trial) in enumerate(self.plan()):
            agent = agents[driver] if driver in agents else ERRATIC[driver](f"{self.secret} {number}")
            yield drive(driver, agent, trial)


EIGHT_DRIVERS: Final = Experiment(
    "eight_drivers",
    "blind labelling 2",
    {
        "obeys-blindly": 18,
        "careful": 18,
        "ignores-commands": 18,
        "ppo-image": 18,
        "ppo-auxiliary": 18,
        "ppo-segmentation": 18,
        "hesitant": 21,
        "astray": 21,
    },
)
HARD_CASES: Final = Experiment("hard_cases", "blind labelling 2, hard cases", {"awkward": 40})
EXPERIMENTS: Final = {one.name: one for one in (EIGHT_DRIVERS, HARD_CASES)}


def save(drives: list[Drive], file: Path) -> None:
    """Keep drivers, trials and actions. Trajectories follow from these."""
    told = [{"driver": one.driver, "trial": one.trial.model_dump(mode="json")} for one in drives]
    counts = np.array([len(one.actions) for one in drives])
    actions = np.concatenate([one.actions for one in drives])
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(file, told=np.array(json.dumps(told)), counts=counts, actions=actions)


def load(file: Path) -> list[Drive]:
    """Return the drives that a file keeps."""
    with np.load(file) as kept:
        told, counts, actions = json.loads(str(kept["told"])), kept["counts"], kept["actions"]
    parts = np.split(actions, np.cumsum(counts)[:-1])
    return [
        Drive(one["driver"], Trial.model_validate(one["trial"]), part) for one, part in zip(told, parts, strict=True)
    ]
