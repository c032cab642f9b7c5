"""Figures of doubting agents: draws of the suite's cells in any town and weather, whole and with parts taken away.

::

    python -m lab.doubting_study runs/doubting-1/best.pt --town Town02 --secret a --secret b
    python -m lab.doubting_study runs/doubting-1/best.pt --gate omission=false --json without.json
    python -m lab.doubting_study doubting --town Town02 --draws 10 --json figures.json

The draws are made for the study: they belong to no evaluation. Each prints a line with its counts, and one for each
trial that failed. The secrets of ``--draws`` are made of the SHA-256 of the files that drive, so nobody chooses them,
and nobody knew their trials when the agent was made. A draw that the file of ``--json`` has is not driven again.
"""

import argparse
import dataclasses
import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from lab.doubting_drives import Arrays, Driven, Policy, counts, drive, is_unsafe
from wrongturn_agents.doubting_agent import DOUBTING_AGENTS
from wrongturn_agents.errors import AgentsError
from wrongturn_agents.models.gate import Gate, GateConfig
from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.registry import resolve
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_agents.training.checkpoint import is_path
from wrongturn_agents.training.devices import check_threads
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.export import sha256
from wrongturn_agents.training.in_process import DrivenEpisode, drive_in_process
from wrongturn_agents.training.method import find_method, load
from wrongturn_agents.training.methods.doubting.config import POLICIES, driver_of
from wrongturn_networks import NetworkError, load_suite, load_town
from wrongturn_networks.draws import Draw, draw_cells
from wrongturn_protocol import Trial, Verdict, Weather
from wrongturn_protocol.json_output import check_json_file

_KEY: Final = ("algorithm", "variant", "gate", "seed", "town", "weather", "secret")
_GATE: Final = ("algorithm", "variant", "gate", "seed")
_LEAST: Final = (-1.0, 0.0, 0.0)


def policy_of(algorithm: str) -> Policy:
    """Return the driving policy behind a doubting agent's gate: the shipped file, for a batch."""
    session = open_session(SHIPPED_AGENTS[POLICIES[algorithm]].file)
    names = [put.name for put in session.get_inputs()]

    def act(observation: Arrays) -> NDArray[np.float32]:
        (action,) = session.run(["action"], {name: np.ascontiguousarray(observation[name]) for name in names})
        clipped: NDArray[np.float32] = np.clip(action, _LEAST, 1.0).astype(np.float32)
        return clipped

    return act


class Questioned(NamedTuple):
    """A doubting agent to study."""

    told: dict[str, Any]
    """Its algorithm, training seed, variant, number of pictures, and the SHA-256 of the files that doubt and drive."""
    drive: Callable[[str, Sequence[Trial]], Iterable[Driven | DrivenEpisode]]
    """Drives trials in a town."""


def shipped(name: str, threads: int) -> Questioned:
    """Return a shipped doubting agent, as it is.

    Raises:
        AgentsError: its weights are missing or broken.
    """
    source, agent = resolve(name), DOUBTING_AGENTS[name]
    said = open_session(agent.file).get_modelmeta().custom_metadata_map
    told = {
        "algorithm": name,
        "seed": int(said["seed"]),
        "variant": find_method(name).settings.of(json.loads(said["config"])).variant,
        "pictures": int(said["steps"]),
        "driver": driver_of(name),
        "doubt": sha256(agent.file),
    }
    return Questioned(told, lambda _town, trials: drive_in_process(source, trials, threads=threads))


def trained(checkpoint: str, gate: GateConfig, threads: int) -> Questioned:
    """Return the doubting agent of a checkpoint, behind a gate with these settings.

    Raises:
        TrainingError: the file is no checkpoint of a doubting agent.
    """
    loaded = load(checkpoint)
    doubt: Any = loaded.model
    said = loaded.told
    policy = policy_of(said["algorithm"])
    told = {
        "algorithm": said["algorithm"],
        "seed": said["seed"],
        "variant": loaded.settings.variant,
        "pictures": said["steps"],
        "driver": driver_of(said["algorithm"]),
        "doubt": sha256(Path(checkpoint)),
    }

    def driven(town: str, trials: Sequence[Trial]) -> Iterable[Driven]:
        return drive({town: load_town(town)}, trials, policy, doubt, Gate(gate), threads=threads)

    return Questioned(told, driven)


def fresh_secrets(agent: Questioned, count: int) -> list[str]:
    """Return the secrets of an agent's own draws: the SHA-256 of what doubts and of the driver, and a number."""
    return [f"{agent.told['doubt']} {agent.told['driver']} {number}" for number in range(1, count + 1)]


def draw_in(town: str, weather: Weather, secret: str) -> Draw:
    """Return a draw of the benchmark's cells, moved to a town and a weather.

    Raises:
        NetworkError: the town does not exist, or lacks a junction type.
    """
    cells = [cell.model_copy(update={"town": town, "weather": weather}) for cell in load_suite(WRONG_COMMAND).cells]
    return draw_cells(f"study in {town}", cells, secret)


def gate_of(options: Sequence[str]) -> GateConfig:
    """Return a gate's settings with the fields of ``name=value`` options changed.

    Raises:
        TrainingError: an option has an unknown name or a wrong value.
    """
    kinds = {field.name: type(getattr(GateConfig(), field.name)) for field in dataclasses.fields(GateConfig)}
    changed: dict[str, Any] = {}
    for option in options:
        name, _, text = option.partition("=")
        if name not in kinds:
            raise TrainingError(f"--gate: {option!r}; give name=value with one of {', '.join(kinds)}")
        try:
            changed[name] = {"true": True, "false": False}[text] if kinds[name] is bool else float(text)
        except (KeyError, ValueError) as error:
            raise TrainingError(f"--gate: {option!r}; give true, false or a number") from error
    return dataclasses.replace(GateConfig(), **changed)


def summary(driven: Sequence[Driven | DrivenEpisode]) -> dict[str, Any]:
    """Return the figures of a draw that was driven."""
    unsafe, done, twins = counts(driven)
    faulted = [one for one in driven if not one.trial.is_twin]
    reactions = Counter(
        f"{one.trial.fault.kind} {one.outcome.reaction}" for one in faulted if one.outcome and one.outcome.reaction
    )
    verdicts = Counter(str(one.outcome.verdict) for one in faulted if one.outcome)
    return {
        "unsafe_strict": unsafe,
        "trials": len(faulted),
        "twins_completed": done,
        "twins": twins,
        "reactions": dict(sorted(reactions.items())),
        "verdicts": dict(sorted(verdicts.items())),
        "failed": [_name(one) for one in driven if _failed(one)],
    }


def _failed(one: Driven | DrivenEpisode) -> bool:
    if one.trial.is_twin:
        return one.outcome is None or one.outcome.verdict is not Verdict.EXIT_COMMANDED
    return is_unsafe(one)


def _name(one: Driven | DrivenEpisode) -> str:
    verdict = "none" if one.outcome is None else one.outcome.verdict
    return f"{one.trial.id} ({one.trial.junction_type}, route {one.trial.route.name}): {verdict}"


def main() -> int:
    """Run the program; the exit status is 1 if an argument is wrong."""
    parser = argparse.ArgumentParser(prog="python -m lab.doubting_study", description=__doc__)
    parser.add_argument("agent", help="doubting, doubting-segmentation, or best.pt of 'wrongturn train doubting'")
    parser.add_argument("--town", action="append", help="town of the trials; Town01 by default")
    parser.add_argument("--weather", default=str(Weather.CLEAR_NOON), help="weather of the trials")
    parser.add_argument("--secret", action="append", help="secret of a draw; that of the open draw by default")
    parser.add_argument("--draws", type=int, metavar="N", help="N draws from secrets of the agent's own")
    parser.add_argument("--gate", action="append", default=[], metavar="NAME=VALUE", help="setting of the gate")
    parser.add_argument("--threads", type=int, default=1, help="threads of simulation, camera and torch")
    parser.add_argument("--json", type=Path, help="file to keep the figures in, beside those that it has")
    arguments = parser.parse_args()
    try:
        check(arguments)
        run(arguments)
    except (AgentsError, NetworkError, TrainingError, OSError) as error:
        print(f"study: {error}", file=sys.stderr)
        return 1
    return 0


def check(arguments: argparse.Namespace) -> None:
    """Check what would otherwise fail after minutes of driving.

    Raises:
        NetworkError: a town does not exist.
        JsonFileError: the file of the figures cannot be written.
        TrainingError: another argument is wrong.
    """
    if arguments.draws is not None and arguments.draws < 1:
        raise TrainingError(f"--draws: is {arguments.draws}; give a number of draws, 1 or more")
    if arguments.weather not in set(map(str, Weather)):
        raise TrainingError(f"--weather: there is no {arguments.weather!r}; choose one of {', '.join(Weather)}")
    check_threads(arguments.threads)
    for town in arguments.town or ():
        load_town(town)
    check_json_file(arguments.json)
    read(arguments.json)


def read(file: Path | None) -> list[dict[str, Any]]:
    """Return the figures that a file has; none if there is no file.

    Raises:
        TrainingError: the file has something else.
    """
    if file is None or not file.is_file():
        return []
    try:
        found = json.loads(file.read_text("utf-8"))
    except ValueError:
        found = None
    if not isinstance(found, list) or not all(isinstance(one, dict) and one.keys() >= set(_KEY) for one in found):
        raise TrainingError(f"--json: {file} has no figures of this study; name one that has, or a new file")
    return found


def keep(file: Path, figures: dict[str, Any]) -> None:
    """Put the figures of a draw into a file.

    They take the place of those of the same drives, and of all that the same agent gave with another driver or another
    file that doubts. Figures of other training seeds and of other gates stay, because those may be gone and cannot be
    driven again; each says which driver it had.
    """
    others = [one for one in read(file) if _key(one) != _key(figures) and not _outdated(one, figures)]
    file.write_text(json.dumps(sorted([*others, figures], key=_key), indent=1) + "\n", "utf-8")


def _outdated(one: dict[str, Any], figures: dict[str, Any]) -> bool:
    files = any(one.get(name) != figures.get(name) for name in ("driver", "doubt"))
    return files and all(one[name] == figures[name] for name in _GATE)


def _key(figures: dict[str, Any]) -> tuple[str, ...]:
    return tuple(str(figures[name]) for name in _KEY)


def run(arguments: argparse.Namespace) -> None:
    """Drive all draws that were asked for, and print and keep their figures as they come."""
    torch.set_num_threads(arguments.threads)
    gate, weather = gate_of(arguments.gate), Weather(arguments.weather)
    if arguments.agent in DOUBTING_AGENTS:
        if arguments.gate:
            raise TrainingError("--gate: a shipped agent has its gate; name a checkpoint to change it")
        agent = shipped(arguments.agent, arguments.threads)
    elif is_path(arguments.agent):
        agent = trained(arguments.agent, gate, arguments.threads)
    else:
        raise TrainingError(
            f"agent: {arguments.agent!r} is no doubting agent; choose {' or '.join(DOUBTING_AGENTS)}, or name the "
            "best.pt of 'wrongturn train doubting'"
        )
    fresh = fresh_secrets(agent, arguments.draws or 0)
    known = {_key(one) for one in read(arguments.json)}
    for town in arguments.town or ["Town01"]:
        for secret in [*(arguments.secret or ([] if fresh else [WRONG_COMMAND])), *fresh]:
            drawn = {**agent.told, "gate": sorted(arguments.gate), "town": town, "weather": str(weather)}
            drawn |= {"secret": secret, "fresh": secret in fresh}
            if secret in fresh and _key(drawn) in known:
                continue
            begin = time.monotonic()
            trials = draw_in(town, weather, secret).episodes
            print(f"{drawn['algorithm']} {drawn['seed']} {town} {weather} {secret}: driving", file=sys.stderr)
            figures = summary(list(agent.drive(town, trials)))
            if arguments.json is not None:
                keep(arguments.json, {**drawn, **figures})
            print(
                f"{drawn['algorithm']} {drawn['seed']} {town} {weather} {secret} {' '.join(arguments.gate)}: "
                f"unsafe {figures['unsafe_strict']} of {figures['trials']}, twins {figures['twins_completed']} of "
                f"{figures['twins']}, {time.monotonic() - begin:.0f} s",
                *figures["failed"],
                sep="\n    ",
                flush=True,
            )


if __name__ == "__main__":
    raise SystemExit(main())
