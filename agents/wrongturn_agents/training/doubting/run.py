"""``wrongturn train doubting``: learn what pictures tell, and keep it in a run's directory."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import torch

from wrongturn_agents.models.doubt import Doubt
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.checkpoint import read, versions, write
from wrongturn_agents.training.devices import check_threads, device_of
from wrongturn_agents.training.doubting.config import ALGORITHMS, DoubtingConfig
from wrongturn_agents.training.doubting.frames import towns_of, training_towns
from wrongturn_agents.training.doubting.learning import examine, learn
from wrongturn_agents.training.errors import TrainingError
from wrongturn_judge.home import home

BEST: Final = "best.pt"
HELD_OUT: Final = range(1000, 1004)
"""Seeds of the generated towns on whose pictures a run is examined. None of them is learned from."""
_FIELDS: Final = {"algorithm": str, "seed": int, "pictures": int, "config": dict, "state_dict": dict, "told": dict}


def train(
    algorithm: str,
    *,
    directory: Path,
    seed: int | None = None,
    pictures: int | None = None,
    minutes: float | None = None,
    device: str = "auto",
    threads: int = 1,
    options: Sequence[str] = (),
    towns: Path | None = None,
    on_progress: Callable[[int, float, float], None] = lambda *_: None,
) -> Path:
    """Train what doubts a command, and return the checkpoint's path.

    Args:
        algorithm: ``doubting`` or ``doubting-segmentation``.
        directory: the run's directory; it has no checkpoint yet.
        seed: seed of weights and pictures; 1 by default.
        pictures: pictures to learn from; by default those of the settings, or no limit with ``minutes``.
        minutes: wall clock for learning.
        device: ``cpu``, ``cuda`` or ``auto``.
        threads: threads that render and compute on the CPU.
        options: settings as ``name=value``; see :class:`DoubtingConfig`.
        towns: folder of the generated towns, where missing ones are built; by default one under ``WRONGTURN_HOME``.
        on_progress: called now and then with the number of pictures and the losses of exits and distance.

    Raises:
        TrainingError: an argument is wrong, the directory has a run, or SUMO's netconvert is missing.
    """
    if algorithm not in ALGORITHMS:
        raise TrainingError(f"algorithm: {algorithm!r} is none of {', '.join(ALGORITHMS)}")
    check_threads(threads)
    place = device_of(device)
    config = DoubtingConfig().with_options(options)
    if pictures is not None:
        config = dataclasses.replace(config, pictures=pictures)
    budget = Budget(config.pictures if pictures is not None or minutes is None else None, minutes)
    file = directory / BEST
    if file.exists():
        raise TrainingError(f"directory {directory}: has a run already; name another")
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise TrainingError(f"directory {directory}: cannot be made ({error.strerror}); name another") from error
    if place.type == "cpu":
        torch.set_num_threads(threads)
    folder = towns or home() / "towns"
    learned_from = training_towns(folder, config.generated)
    chosen = 1 if seed is None else seed
    model, seen = learn(
        learned_from,
        config,
        key=ALGORITHMS[algorithm],
        seed=chosen,
        budget=budget,
        device=place,
        threads=threads,
        on_progress=on_progress,
    )
    told = {
        "training town": dataclasses.asdict(examine(model, learned_from[:1], threads=threads)),
        "towns never seen": dataclasses.asdict(examine(model, towns_of(folder, HELD_OUT), threads=threads)),
    }
    write(
        file,
        {
            "algorithm": algorithm,
            "seed": chosen,
            "pictures": seen,
            "config": dataclasses.asdict(config),
            "state_dict": {name: tensor.detach().cpu().contiguous() for name, tensor in model.state_dict().items()},
            "told": told,
            "versions": versions(),
        },
    )
    return file


def is_doubting(path: Path | str) -> bool:
    """Return whether a file is the checkpoint of a doubting agent; False for a file that cannot be read."""
    try:
        found = read(Path(path))
    except TrainingError:
        return False
    return isinstance(found, dict) and found.get("algorithm") in ALGORITHMS


def load_doubt(path: Path | str) -> tuple[Doubt, dict[str, Any]]:
    """Return the network of a checkpoint, ready to tell, and the checkpoint.

    Raises:
        TrainingError: the file is missing, damaged, or no checkpoint of a doubting agent.
    """
    found = read(Path(path), "checkpoint", "the best.pt of 'wrongturn train doubting'")
    if not isinstance(found, dict) or any(not isinstance(found.get(name), kind) for name, kind in _FIELDS.items()):
        raise TrainingError(f"checkpoint {path}: is none of a doubting agent; name the best.pt of one")
    if found["algorithm"] not in ALGORITHMS:
        raise TrainingError(f"checkpoint {path}: is of {found['algorithm']}; name one of {', '.join(ALGORITHMS)}")
    model = Doubt(ALGORITHMS[found["algorithm"]])
    try:
        model.load_state_dict(found["state_dict"])
    except (RuntimeError, TypeError, AttributeError) as error:
        raise TrainingError(f"checkpoint {path}: its weights are not as this version has them; train anew") from error
    if not all(tensor.isfinite().all() for tensor in model.state_dict().values()):
        raise TrainingError(f"checkpoint {path}: its weights are not finite; train anew")
    return model.eval(), found
