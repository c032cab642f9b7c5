"""Train one of the paper's agents: ``train("ppo-segmentation", directory=..., seed=1)``, or ``wrongturn train``."""

import copy
import dataclasses
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat

from wrongturn_agents.models import ActorCritic, build
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.candidates import Candidate, Candidates
from wrongturn_agents.training.checkpoint import load_checkpoint, read, write
from wrongturn_agents.training.config import ImageConfig, PPOConfig, SegmentationConfig, config_of
from wrongturn_agents.training.devices import check_threads, device_of, prepare
from wrongturn_agents.training.drives_config import DrivesConfig
from wrongturn_agents.training.environments import environments
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.held_out import Evaluation, held_out_journeys, longest, shortest, with_traffic
from wrongturn_agents.training.marln.config import MarlnConfig
from wrongturn_agents.training.marln.run import STATE_KEYS, load_encoder
from wrongturn_agents.training.marln.run import run as run_marln
from wrongturn_agents.training.memory import memory_named
from wrongturn_agents.training.ppo import WrongturnPPO
from wrongturn_agents.training.pretrain import pretrain
from wrongturn_agents.training.progress_file import ProgressFile
from wrongturn_agents.training.run_callback import Row, RunCallback
from wrongturn_agents.training.run_directory import (
    ENCODER,
    STATE,
    Begun,
    OtherRunError,
    check_resumed,
    held,
    pretraining_seconds,
    read_state,
)
from wrongturn_agents.training.seen_env import SeenVecEnv
from wrongturn_agents.training.stopwatch import Stopwatch

_SEEDS = 2**32
_STATE = {
    *("steps", "updates", "seconds", "begun", "policy", "optimizer", "torch", "cuda", "caution", "evaluated_at"),
}
_WARMING = 40
"""Batches from which batch normalisation learns its first statistics."""


def train(
    algorithm: str,
    *,
    directory: Path | str,
    seed: int | None = None,
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

    The directory then holds ``best.pt`` (best by held-out journeys), ``last.pt``, ``state.pt`` (to resume from),
    ``progress.csv``, ``config.json`` and ``tensorboard/``. A resumed run continues with its weights, optimiser, torch's
    random state, schedule and steps. Its cars start new drives, with seeds drawn from the run's seed and steps.

    Args:
        algorithm: ``ppo-segmentation``, ``ppo-image``, ``ppo-auxiliary`` or ``marln``.
        directory: directory of the run; made if it is missing.
        seed: seed of weights, drives and actions; 1 by default. A resumed run keeps its own.
        steps: environment steps; the configuration's if neither steps nor minutes are given.
        minutes: wall clock for everything. The learning rate falls with steps or minutes, whichever is further on.
        device: ``cpu``, ``cuda`` or ``auto``.
        resume: continue the run in the directory.
        threads: threads of the simulation, and of torch on the CPU; all cores by default.
        options: ``name=value`` of the configuration's fields.
        on_row: called with each row of ``progress.csv``.
        on_pretraining: called with the number of frames and the loss.

    Returns:
        Path of the best checkpoint.

    Raises:
        TrainingError: an argument is invalid, a file of the run is damaged or cannot be written, or memory is short.
    """
    folder = Path(directory)
    config = config_of(algorithm).with_options(options)
    if resume:
        begun = _going_on(folder, config, seed, steps, minutes, tuple(options))
    else:
        limit = config.steps if steps is None and minutes is None else steps
        begun = Begun(config, 1 if seed is None else seed, limit, minutes)
    if not 0 <= begun.seed < _SEEDS:
        raise TrainingError(f"seed: is {seed}; give a whole number from 0 to {_SEEDS - 1}")
    check_threads(threads)
    Budget(begun.steps, begun.minutes)  # reports invalid limits before a directory is made
    place = device_of(device)
    encoder = None
    if isinstance(begun.config, ImageConfig | MarlnConfig) and begun.config.encoder and not resume:
        encoder = _encoder_of(Path(begun.config.encoder), begun.config)
    with memory_named(begun.config, place), held(folder, resume=resume):
        state: dict[str, Any] | None = None
        used = 0.0
        if resume and (pretrained := pretraining_seconds(folder)) is not None:
            encoder, used = _encoder_of(folder / ENCODER, begun.config), pretrained
        elif resume:
            state = read_state(folder, STATE_KEYS if isinstance(begun.config, MarlnConfig) else _STATE)
            used = state["seconds"]
        begun.write(folder, place)
        budget = Budget(begun.steps, begun.minutes, used=used)
        run = _train_marln if isinstance(begun.config, MarlnConfig) else _train
        return run(begun, folder, place, state, budget, encoder, threads, on_row, on_pretraining)


def _train_marln(
    begun: Begun,
    folder: Path,
    place: torch.device,
    state: dict[str, Any] | None,
    budget: Budget,
    encoder: dict[str, torch.Tensor] | None,
    threads: int | None,
    on_row: Callable[[Row], None],
    on_pretraining: Callable[[int, float], None],
) -> Path:
    assert isinstance(begun.config, MarlnConfig)
    cores = prepare(place, threads)
    return run_marln(
        begun.config,
        folder,
        seed=begun.seed,
        budget=budget,
        device=place,
        threads=cores,
        stream=_stream(begun.seed, state["steps"] if state else 0),
        state=state,
        encoder=encoder,
        on_row=on_row,
        on_pretraining=on_pretraining,
    )


def _train(
    begun: Begun,
    folder: Path,
    place: torch.device,
    state: dict[str, Any] | None,
    budget: Budget,
    encoder: dict[str, torch.Tensor] | None,
    threads: int | None,
    on_row: Callable[[Row], None],
    on_pretraining: Callable[[int, float], None],
) -> Path:
    config, seed = begun.config, begun.seed
    assert isinstance(config, PPOConfig)
    cores = prepare(place, threads)
    agent = _agent(config, seed).to(place)
    if encoder is not None:
        _take(encoder, agent, config)
    elif isinstance(config, ImageConfig) and config.pretrained and state is None:
        _pretrain(agent, config, folder, place, seed, budget, on_pretraining, threads=cores)
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
        trials = journeys if last else brief
        return Evaluation.each(
            models,
            [*trials, *with_traffic(trials)] if config.traffic else trials,
            track=config.track,
            device=place,
            threads=cores,
            patience=config.patience,
            strict=config.strict_evaluation,
            stop=budget.out_of_time,
            least=config.brief_journeys,
        )

    budget.begun = state["begun"] if state else budget.used
    callback = RunCallback(
        folder,
        seed=seed,
        evaluate=evaluate,
        candidates=_candidates(agent, folder / "best.pt" if state else None),
        brief=len(brief),
        longer=longest(journeys) / longest(brief),
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
    """Return the first of the environments' seeds, which count up from it, far from those of other runs."""
    return int(np.random.SeedSequence([seed, steps]).generate_state(1)[0]) >> 1


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


def _encoder_of(path: Path, config: DrivesConfig) -> dict[str, torch.Tensor]:
    """Return the weights in a run's ``encoder.pt``."""
    if isinstance(config, MarlnConfig):
        return load_encoder(path)
    found = read(path, "option encoder:", "a run's encoder.pt")
    weights = found.get("state_dict") if isinstance(found, dict) else None
    if not isinstance(weights, dict):
        raise TrainingError(f"option encoder: {path} is no encoder; name a run's encoder.pt")
    return weights


def _take(weights: dict[str, torch.Tensor], agent: ActorCritic, config: PPOConfig) -> None:
    """Load another run's encoder. The layers after it are each run's own."""
    try:
        agent.encoder.load_state_dict(agent.encoder.state_dict() | weights)
    except (RuntimeError, TypeError, AttributeError) as error:
        path = getattr(config, "encoder", "")
        raise TrainingError(f"option encoder: {path} is no ResNet-34's; name a run's encoder.pt") from error


def _pretrain(
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
    """Pretrain the encoder, and save it for other runs."""
    torch.manual_seed(seed)
    found = pretrain(agent, config, device=device, seed=seed, budget=budget, threads=threads, on_progress=on_progress)
    content = {name: tensor.detach().cpu() for name, tensor in agent.encoder.state_dict().items()}
    content = {name: tensor for name, tensor in content.items() if name.startswith(("network.", "decoder."))}
    write(folder / ENCODER, {"state_dict": content, "seconds": budget.used, **dataclasses.asdict(found)})
    (folder / "pretraining.json").write_text(json.dumps(dataclasses.asdict(found), indent=1) + "\n", "utf-8")


def _warm(model: WrongturnPPO, envs: SeenVecEnv) -> None:
    """Let batch normalisation see random drives before the policy drives."""
    observation = envs.reset()
    for _ in range(_WARMING):
        with model.policy.precision(observation):
            model.policy.model.update_statistics(observation)
        actions, _, _ = model.policy(observation)
        observation = envs.step(actions.detach().cpu().numpy())[0]


def _restore(model: WrongturnPPO, state: dict[str, Any]) -> None:
    try:
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimizer"])
    except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise TrainingError(
            f"resume: {STATE} is of other networks than this version's; begin anew in another directory"
        ) from error
    model.num_timesteps = state["steps"]
    model._n_updates = state["updates"]
    model.caution = state["caution"]
    model._current_progress_remaining = 1.0 - model.budget.fraction(state["steps"])
    torch.set_rng_state(state["torch"])
    if state["cuda"] and model.device.type == "cuda":
        torch.cuda.set_rng_state_all(state["cuda"])


def _candidates(agent: ActorCritic, best: Path | None) -> Candidates:
    """Return a run's candidates, with the best one from before an interruption."""
    found = Candidates(agent)
    if best is not None and best.is_file():
        told = load_checkpoint(best)
        kept = copy.deepcopy(agent).eval().requires_grad_(False)
        kept.load_state_dict(told["state_dict"])
        evaluation = Evaluation(**told["evaluation"]) if told["evaluation"] else None
        found.best = Candidate(kept, told["steps"], evaluation=evaluation)
    return found


def _going_on(
    folder: Path,
    config: DrivesConfig,
    seed: int | None,
    steps: int | None,
    minutes: float | None,
    options: tuple[str, ...],
) -> Begun:
    """Return what a resumed run continues with. Steps and minutes may be given again, to train for longer."""
    begun = Begun.read(folder)
    if begun.config.algorithm != config.algorithm:
        raise OtherRunError(folder, begun.config.algorithm)
    check_resumed(options, seed, begun.seed)
    if steps is None and minutes is None:
        return begun
    return dataclasses.replace(begun, steps=steps, minutes=minutes)
