"""Train one of the paper's agents: ``train("ppo-segmentation", directory=..., seed=1)``, or ``wrongturn train``."""

import argparse
import copy
import dataclasses
import json
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat

from wrongturn_agents.models import ActorCritic, build
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.candidates import Candidate, Candidates
from wrongturn_agents.training.checkpoint import load_checkpoint, read, versions, write
from wrongturn_agents.training.config import ImageConfig, PPOConfig, SegmentationConfig, config_of
from wrongturn_agents.training.display import Display
from wrongturn_agents.training.environments import environments, rendered_on
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.held_out import Evaluation, held_out_journeys, shortest
from wrongturn_agents.training.ppo import WrongturnPPO
from wrongturn_agents.training.pretrain import pretrain
from wrongturn_agents.training.progress_file import ProgressFile
from wrongturn_agents.training.run_callback import Row, RunCallback
from wrongturn_agents.training.seen_env import SeenVecEnv
from wrongturn_agents.training.stopwatch import Stopwatch
from wrongturn_protocol import Trial

_SEEDS = 2**32
_WARMING = 40
"""Batches from which batch normalisation learns its first statistics."""


def train(
    algorithm: str,
    *,
    directory: Path | str,
    seed: int = 1,
    steps: int | None = None,
    minutes: float | None = None,
    device: str = "auto",
    resume: bool = False,
    threads: int | None = None,
    options: Iterable[str] = (),
    on_row: Callable[[Row], None] = lambda _: None,
    on_pretraining: Callable[[int, float], None] = lambda *_: None,
) -> Path:
    """Train an agent in Town01, in the training weathers, with correct commands.

    The directory then holds ``best.pt`` (by the held-out journeys), ``last.pt``, ``state.pt`` (to resume from),
    ``progress.csv``, ``config.json`` and ``tensorboard/``. A run that is resumed goes on with its weights, optimiser,
    random numbers of torch, schedule and steps; its cars begin new drives, of seeds drawn from the run's and the steps.

    Args:
        algorithm: ``ppo-segmentation``, ``ppo-image`` or ``ppo-auxiliary``.
        directory: of the run; made where it is missing.
        seed: of weights, drives and actions.
        steps: environment steps; the configuration's where neither these nor minutes are given.
        minutes: of wall clock, with everything; the learning rate falls by whichever of the two is further on.
        device: ``cpu``, ``cuda`` or ``auto``.
        resume: go on with the run in the directory.
        threads: share the simulation and torch's work on the CPU; all of the processor's by default.
        options: ``name=value`` of the configuration's fields.
        on_row: told of each row of ``progress.csv``.
        on_pretraining: told of frames and loss.

    Returns:
        Where the best is.

    Raises:
        TrainingError: an argument cannot be.
    """
    folder = Path(directory)
    config = config_of(algorithm).with_options(options)
    if not 0 <= seed < _SEEDS:
        raise TrainingError(f"seed: is {seed}; give a whole number from 0 to {_SEEDS - 1}")
    if resume:
        config, seed, steps, minutes = _found(folder, config, steps, minutes, tuple(options))
    elif (folder / "config.json").exists():
        raise TrainingError(f"directory {folder}: holds a run already; resume it, or name another")
    state = read(folder / "state.pt") if resume else None
    limit = config.steps if steps is None and minutes is None else steps
    budget = Budget(limit, minutes, used=state["seconds"] if state else 0.0)
    place = _device(device)
    cores = threads or len(os.sched_getaffinity(0))
    if place.type == "cpu":
        torch.set_num_threads(cores)
    else:
        torch.backends.cudnn.benchmark = True  # few shapes, again and again
        torch.set_float32_matmul_precision("high")
    folder.mkdir(parents=True, exist_ok=True)
    _write_config(folder, config, seed, limit, minutes, place)

    agent = _agent(config, seed).to(place)
    if isinstance(config, ImageConfig) and config.pretrained and not resume:
        _encoder(agent, config, folder, place, seed, budget, on_pretraining, threads=cores)
    stopwatch = Stopwatch(place)
    envs = environments(config, agent, stopwatch, threads=cores)
    begun_at = state["steps"] if state else 0
    model = WrongturnPPO(
        config,
        envs,
        model=lambda: agent,
        budget=budget,
        stopwatch=stopwatch,
        seed=_stream(seed, begun_at),
        device=place,
    )
    model.set_logger(Logger(str(folder), [TensorBoardOutputFormat(str(folder / "tensorboard"))]))
    if state:
        _restore(model, state)
    elif config.statistics:
        _warm(model, envs)
    journeys = held_out_journeys(config.journeys)

    brief = shortest(journeys, config.brief_journeys)

    def evaluate(models: Sequence[ActorCritic], last: bool) -> list[Evaluation] | None:
        return Evaluation.each(
            models,
            journeys if last else brief,
            track=config.track,
            device=place,
            threads=cores,
            patience=config.patience,
            strict=config.strict_evaluation,
            stop=budget.out_of_time,
        )

    budget.begun = state["begun"] if state else budget.used
    callback = RunCallback(
        folder,
        seed=seed,
        evaluate=evaluate,
        candidates=_candidates(agent, folder / "best.pt" if state else None),
        brief=len(brief),
        longer=_longest(journeys) / _longest(brief),
        rows=ProgressFile(folder / "progress.csv", resumed_at=begun_at if state else None),
        on_row=on_row,
        evaluated_at=state["evaluated_at"] if state else 0,
    )
    try:
        model.learn(budget.steps - begun_at, callback=callback, log_interval=None, reset_num_timesteps=state is None)
    finally:
        envs.close()
    return folder / "best.pt"


def _stream(seed: int, steps: int) -> int:
    """The first of the environments' seeds, which count up from it: far from those of other runs."""
    return int(np.random.SeedSequence([seed, steps]).generate_state(1)[0]) >> 1


def _device(name: str) -> torch.device:
    if name not in {"auto", "cpu", "cuda"}:
        raise TrainingError(f"device: is {name!r}; give auto, cpu or cuda")
    if name == "cuda" and not torch.cuda.is_available():
        raise TrainingError("device: torch finds no CUDA device here; give cpu, or install torch for CUDA")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def _agent(config: PPOConfig, seed: int) -> ActorCritic:
    more: dict[str, Any] = {"activation": config.activation}
    if isinstance(config, SegmentationConfig):
        more["masked_classes"] = config.masked_classes
    if isinstance(config, ImageConfig):
        more["frozen"] = config.frozen
    agent = build(config.algorithm, seed=seed, **more)
    with torch.no_grad():
        agent.branches.policy.bias[..., 1] = config.accelerate
    return agent


def _encoder(
    agent: ActorCritic,
    config: ImageConfig,
    folder: Path,
    device: torch.device,
    seed: int,
    budget: Budget,
    on_progress: Callable[[int, float], None],
    *,
    threads: int,
) -> None:
    """Pretrain the encoder, or take another run's."""
    if config.encoder:
        # What follows the encoder is each run's own.
        agent.encoder.load_state_dict(agent.encoder.state_dict() | read(Path(config.encoder))["state_dict"])
        return
    torch.manual_seed(seed)
    options = {"threads": threads, **rendered_on(device)}
    found = pretrain(agent, config, device=device, seed=seed, budget=budget, on_progress=on_progress, **options)
    content = {name: tensor.detach().cpu() for name, tensor in agent.encoder.state_dict().items()}
    content = {name: tensor for name, tensor in content.items() if name.startswith(("network.", "decoder."))}
    write(folder / "encoder.pt", {"state_dict": content, **dataclasses.asdict(found)})
    (folder / "pretraining.json").write_text(json.dumps(dataclasses.asdict(found), indent=1) + "\n", "utf-8")


def _warm(model: WrongturnPPO, envs: SeenVecEnv) -> None:
    """Let batch normalisation see what is driven through by chance, before it drives."""
    observation = envs.reset()
    for _ in range(_WARMING):
        with model.policy.precision(observation):
            model.policy.model.update_statistics(observation)
        actions, _, _ = model.policy(observation)
        observation = envs.step(actions.detach().cpu().numpy())[0]


def _restore(model: WrongturnPPO, state: dict[str, Any]) -> None:
    model.policy.load_state_dict(state["policy"])
    model.policy.optimizer.load_state_dict(state["optimizer"])
    model.num_timesteps = state["steps"]
    model._n_updates = state["updates"]
    model.caution = state["caution"]
    model._current_progress_remaining = 1.0 - model.budget.fraction(state["steps"])
    torch.set_rng_state(state["torch"])
    if state["cuda"] and model.device.type == "cuda":
        torch.cuda.set_rng_state_all(state["cuda"])


def _candidates(agent: ActorCritic, best: Path | None) -> Candidates:
    """Those of a run, with the best that it had when it was interrupted."""
    found = Candidates(agent)
    if best is not None and best.is_file():
        told = load_checkpoint(best)
        kept = copy.deepcopy(agent).eval().requires_grad_(False)
        kept.load_state_dict(told["state_dict"])
        evaluation = Evaluation(**told["evaluation"]) if told["evaluation"] else None
        found.best = Candidate(kept, told["steps"], evaluation=evaluation)
    return found


def _longest(journeys: Sequence[Trial]) -> float:
    return max((one.journey.time_limit for one in journeys if one.journey), default=1.0)


def _write_config(
    folder: Path, config: PPOConfig, seed: int, steps: int | None, minutes: float | None, device: torch.device
) -> None:
    content = {
        "algorithm": config.algorithm,
        "variant": config.variant,
        "seed": seed,
        "steps": steps,
        "minutes": minutes,
        "config": config.as_dict(),
        "device": torch.cuda.get_device_name() if device.type == "cuda" else "cpu",
        "versions": versions(),
    }
    (folder / "config.json").write_text(json.dumps(content, indent=1) + "\n", "utf-8")


def _found(
    folder: Path, config: PPOConfig, steps: int | None, minutes: float | None, options: tuple[str, ...]
) -> tuple[PPOConfig, int, int | None, float | None]:
    """What the run in a folder was begun with; steps and minutes may be given anew, to go on for longer."""
    path = folder / "config.json"
    if not path.is_file():
        raise TrainingError(f"directory {folder}: holds no run to resume; name the directory of one")
    content = json.loads(path.read_text("utf-8"))
    if content["algorithm"] != config.algorithm or options:
        raise TrainingError(f"resume: the run is {content['algorithm']} with its own options; give no others")
    if steps is None and minutes is None:
        steps, minutes = content["steps"], content["minutes"]
    return config_of(config.algorithm, content["config"]), content["seed"], steps, minutes


def _main() -> None:
    """As ``wrongturn train``, where there is this package and no program."""
    parser = argparse.ArgumentParser(prog="python -m wrongturn_agents.training.train")
    parser.add_argument("algorithm")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--directory", type=Path, required=True)
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--threads", type=int)
    parser.add_argument("--option", action="append", dest="options", default=[])
    arguments = vars(parser.parse_args())
    with Display(arguments["algorithm"]) as display:
        best = train(**arguments, on_row=display.row, on_pretraining=display.pretraining)
    print(f"The best is {best}.")


if __name__ == "__main__":
    _main()
