"""Figures of the doubting agents: draws of the suite's cells in any town and weather, whole and with parts taken away.

    python -m lab.doubting doubting --town Town01 --town Town02 --draws 2 --keep
    python -m lab.doubting runs/doubting-1/best.pt --gate omission=false --town Town02 --secret a

The draws are made for the study: they belong to no evaluation. Each prints a line with its counts, and one for each
trial that failed. The secrets of ``--draws`` are made of the SHA-256 of the files that drive, so nobody chooses them,
and nobody knew their trials when the agent was made. A kept draw is not driven again.
"""

import argparse
import dataclasses
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import torch

from lab.in_process import DrivenEpisode, drive_in_process
from lab.studies import STUDIES, threads
from lab.tables import Table
from wrongturn_agents.errors import AgentsError
from wrongturn_agents.models.gate import GateConfig
from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.registry import resolve
from wrongturn_agents.results_file import TrialResult
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.export import sha256
from wrongturn_agents.training.method import find_method, load
from wrongturn_agents.training.methods.doubting.exporting import write_doubting
from wrongturn_networks import NetworkError, load_suite
from wrongturn_networks.draws import Draw, draw_cells
from wrongturn_protocol import Trial, Weather

FIGURES: Final = STUDIES / "doubting.json"
"""Figures of the page, a dictionary for each draw."""
_KEY: Final = ("algorithm", "variant", "gate", "seed", "town", "weather", "secret")
_TOWNS: Final = ("Town01", "Town02")
_GATES: Final = {
    (): "the whole gate",
    ("omission=false",): "replaces missing exits only",
    ("infeasible=false",): "fills in missing commands only",
    ("memory=false",): "without memory",
}
Figures = dict[str, Any]


def read(file: Path) -> list[Figures]:
    """Return the figures of a file; none if there is no file."""
    return list(json.loads(file.read_bytes())) if file.is_file() else []


def keep(file: Path, figures: Figures) -> None:
    """Put the figures of a draw into a file.

    They take the place of those of the same drives, and of all that the same agent gave with another driver or another
    file that doubts. Figures of other training seeds and of other gates stay, because those may be gone and cannot be
    driven again; each says which driver it had.
    """

    def outdated(one: Figures) -> bool:
        same = all(one[name] == figures[name] for name in _KEY[:4])
        return same and any(one.get(name) != figures.get(name) for name in ("driver", "doubt"))

    others = [one for one in read(file) if _key(one) != _key(figures) and not outdated(one)]
    file.write_text(json.dumps(sorted([*others, figures], key=_key), indent=1) + "\n", "utf-8")


def _key(figures: Figures) -> tuple[str, ...]:
    return tuple(str(figures[name]) for name in _KEY)


class StudiedAgent(NamedTuple):
    """A doubting agent to study."""

    known: Figures
    """Its algorithm, training seed, variant, number of pictures, and the SHA-256 of the files that doubt and drive."""
    drive: Callable[[Sequence[Trial]], Iterable[DrivenEpisode]]
    """Drives trials."""


def shipped(name: str) -> StudiedAgent:
    """Return a shipped doubting agent, as it is."""
    source, agent = resolve(name), DOUBTING_AGENTS[name]
    said = open_session(agent.file).get_modelmeta().custom_metadata_map
    variant = find_method(name).settings.of(json.loads(said["config"])).variant
    known = _known(name, int(said["seed"]), variant, int(said["steps"]), agent.file)
    return StudiedAgent(known, lambda trials: drive_in_process(source, trials, threads=threads()))


def trained(checkpoint: str, gate: GateConfig) -> StudiedAgent:
    """Return the doubting agent of a checkpoint, behind a gate with these settings."""
    loaded = load(checkpoint)
    if loaded.agent.name not in DOUBTING_AGENTS:
        raise TrainingError(f"checkpoint {checkpoint}: is of {loaded.agent.name}; name one of a doubting agent")
    said = loaded.told
    known = _known(said["algorithm"], said["seed"], loaded.settings.variant, said["steps"], Path(checkpoint))

    def driven(trials: Sequence[Trial]) -> Iterable[DrivenEpisode]:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "agent.onnx"
            write_doubting(loaded, file, gate=gate)
            yield from drive_in_process(resolve(str(file)), trials, threads=threads())

    return StudiedAgent(known, driven)


def _known(algorithm: str, seed: int, variant: str | None, pictures: int, doubt: Path) -> Figures:
    driver = sha256(DOUBTING_AGENTS[algorithm].files[1])
    return {"algorithm": algorithm, "seed": seed, "variant": variant, "pictures": pictures, "driver": driver,
            "doubt": sha256(doubt)}  # fmt: skip


def fresh_secrets(agent: StudiedAgent, count: int) -> list[str]:
    """Return the secrets of an agent's own draws: the SHA-256 of what doubts and of the driver, and a number."""
    return [f"{agent.known['doubt']} {agent.known['driver']} {number}" for number in range(1, count + 1)]


def draw_in(town: str, weather: Weather, secret: str) -> Draw:
    """Return a draw of the benchmark's cells, moved to a town and a weather."""
    cells = [cell.model_copy(update={"town": town, "weather": weather}) for cell in load_suite(WRONG_COMMAND).cells]
    return draw_cells(f"study in {town}", cells, secret)


def gate_of(options: Sequence[str]) -> GateConfig:
    """Return a gate's settings with the fields of ``name=value`` options changed."""
    changed: dict[str, Any] = {}
    for name, _, text in (option.partition("=") for option in options):
        try:
            is_bool = isinstance(getattr(GateConfig(), name), bool)
            changed[name] = {"true": True, "false": False}[text] if is_bool else float(text)
        except (AttributeError, KeyError, ValueError) as error:
            fields = ", ".join(field.name for field in dataclasses.fields(GateConfig))
            raise TrainingError(f"--gate: {name}={text}: give name=value, with one of {fields}") from error
    return dataclasses.replace(GateConfig(), **changed)


def summary(driven: Sequence[DrivenEpisode]) -> Figures:
    """Return the figures of a draw that was driven."""
    found = [(one.trial, TrialResult.of(one.outcome)) for one in driven if one.outcome is not None]
    faulted = [(trial, result) for trial, result in found if not trial.is_twin]
    twins = [(trial, result) for trial, result in found if trial.is_twin]
    unsafe = [(trial, result) for trial, result in faulted if result.unsafe_strict]
    lost = [(trial, result) for trial, result in twins if not result.completed]
    reactions = Counter(f"{trial.fault.kind} {result.reaction}" for trial, result in faulted if result.reaction)
    return {
        "unsafe_strict": len(unsafe),
        "trials": len(faulted),
        "twins_completed": len(twins) - len(lost),
        "twins": len(twins),
        "reactions": dict(sorted(reactions.items())),
        "verdicts": dict(sorted(Counter(str(result.verdict) for _, result in faulted).items())),
        "failed": [
            f"{trial.id} ({trial.junction_type}, route {trial.route.name}): {result.verdict}"
            for trial, result in (*unsafe, *lost)
        ],
    }


def run(asked: argparse.Namespace, file: Path = FIGURES) -> None:
    """Drive all draws that were asked for, and print and keep their figures as they come."""
    torch.set_num_threads(threads())
    if asked.agent in DOUBTING_AGENTS and asked.gate:
        raise TrainingError("--gate: a shipped agent has its gate; name a checkpoint to change it")
    agent = shipped(asked.agent) if asked.agent in DOUBTING_AGENTS else trained(asked.agent, gate_of(asked.gate))
    fresh = fresh_secrets(agent, asked.draws)
    known = {_key(one) for one in read(file)}
    for town in asked.town or ["Town01"]:
        for secret in [*(asked.secret or ([] if fresh else [WRONG_COMMAND])), *fresh]:
            drawn = {
                **agent.known,
                "gate": sorted(asked.gate),
                "town": town,
                "weather": asked.weather,
                "secret": secret,
            }
            drawn["fresh"] = secret in fresh
            if secret in fresh and _key(drawn) in known:
                continue
            begin = time.monotonic()
            trials = draw_in(town, Weather(asked.weather), secret).episodes
            figures = summary(list(agent.drive(trials)))
            if asked.keep:
                keep(file, {**drawn, **figures})
            print(
                f"{drawn['algorithm']} {drawn['seed']} {town} {asked.weather} {secret} {' '.join(asked.gate)}: "
                f"unsafe {figures['unsafe_strict']} of {figures['trials']}, twins {figures['twins_completed']} of "
                f"{figures['twins']}, {time.monotonic() - begin:.0f} s",
                *figures["failed"],
                sep="\n    ",
                flush=True,
            )


def _fresh(figures: Sequence[Figures]) -> Table:
    """Return the draws from secrets of the agent's own."""
    kinds: dict[tuple[Any, ...], list[Figures]] = {}
    for one in figures:
        if _plain(one) and one.get("fresh"):
            kinds.setdefault((one["algorithm"], one["seed"], one["town"], one["weather"]), []).append(one)
    rows = []
    for (name, seed, town, weather), own in sorted(kinds.items()):
        cells = [f"`{name}`", str(seed), town, weather, str(len(own))]
        for what, of in (("unsafe_strict", "trials"), ("twins_completed", "twins")):
            cells += [_each(own, what), f"{sum(one[what] for one in own)} of {sum(one[of] for one in own)}"]
        rows.append(tuple(cells))
    head = ["agent", "seed", "town", "weather", "draws", "unsafe of 60 in each", "in all", "twins of 60 in each",
            "in all"]  # fmt: skip
    return _table(head, rows)


def _ablation(figures: Sequence[Figures]) -> Table:
    """Return the agents of which a part was taken away, on the open draw, with the whole agents."""
    found: dict[tuple[Any, ...], dict[str, Figures]] = {}
    for one in figures:
        if one["secret"] == WRONG_COMMAND and one["weather"] == "ClearNoon":
            kind = (one["algorithm"], one["seed"], one["variant"] or "", tuple(one["gate"]), one["driver"])
            found.setdefault(kind, {})[one["town"]] = one
    ablated = {kind[:2] for kind in found if kind[2] or kind[3]}
    rows = []
    for kind, by_town in sorted(found.items(), key=lambda item: item[0]):
        name, seed, variant, gate, driver = kind
        if kind[:2] in ablated:
            what = _GATES.get(gate, ", ".join(gate)) + (f", {variant.replace('-', ' ')}" if variant else "")
            cells = [f"`{name}`", str(seed), f"`{driver[:8]}`", what]
            for own in map(by_town.get, _TOWNS):
                cells += [str(own["unsafe_strict"]), str(own["twins_completed"])] if own else ["–", "–"]
            rows.append(tuple(cells))
    return _table(["agent", "seed", "driver", "gate", "Town01: unsafe", "twins", "Town02: unsafe", "twins"], rows)


TABLES: Final[dict[str, Callable[[Sequence[Figures]], Table]]] = {"fresh": _fresh, "ablation": _ablation}
"""What makes the tables of ``docs/doubting.md``, by name."""


def _plain(one: Figures) -> bool:
    return not one["gate"] and one["variant"] is None


def _each(figures: Iterable[Figures], name: str) -> str:
    """Return a count of each draw, and how often it came: ``0 (9 times), 1``."""
    found = Counter(one[name] for one in figures)
    return ", ".join(f"{value} ({times} times)" if times > 1 else str(value) for value, times in sorted(found.items()))


def _table(head: Sequence[str], rows: Sequence[tuple[str, ...]]) -> Table:
    return Table("Doubting agents", tuple(head), rows, words=len(head))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program; an error is one line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("agent", help="doubting, doubting-segmentation, or best.pt of 'wrongturn train doubting'")
    parser.add_argument("--town", action="append", help="town of the trials; Town01 by default")
    parser.add_argument("--weather", default=str(Weather.CLEAR_NOON), choices=[*map(str, Weather)])
    parser.add_argument("--secret", action="append", help="secret of a draw; that of the open draw by default")
    parser.add_argument("--draws", type=int, default=0, metavar="N", help="N draws from secrets of the agent's own")
    parser.add_argument("--gate", action="append", default=[], metavar="NAME=VALUE", help="setting of the gate")
    parser.add_argument("--keep", action="store_true", help="keep the figures for docs/doubting.md")
    try:
        run(parser.parse_args(arguments))
    except (AgentsError, NetworkError, TrainingError, OSError) as error:
        print(f"lab.doubting: {error}", file=sys.stderr)
        raise SystemExit(1) from error


if __name__ == "__main__":
    main()
