"""A shipped agent's card in Markdown, made from its file, the stored results and the curve of its training.

``python -m lab.cards`` writes the cards beside the weights, and a test compares them with
the files. What no file knows stands in ``weights/training.json``: each agent's ``hardware`` and, if there are any,
the ``options`` of its ``wrongturn train`` and ``notes``.
"""

import hashlib
import json
import math
import sys
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, ValidationError

from lab.card_words import Words, words_of
from lab.curves import Curve, read_curves
from lab.navigation import count_success
from lab.paths import LAB
from lab.tables import spread, with_interval
from lab.wrong_command import count_unsafe, counts_by_seed
from wrongturn_agents.errors import ModelFileError
from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS, WEIGHTS, ShippedAgent, trained_with
from wrongturn_agents.stored_results import STORED, Collection
from wrongturn_agents.suites import NAVIGATION, WRONG_COMMAND, installed_suite
from wrongturn_protocol import CORL_TASKS, Condition, Task

FACTS: Final = "training.json"
_CONTROLS: Final = ("steer", "throttle", "brake")
_STATED: Final = "–"


class Facts(BaseModel):
    """What no file knows of an agent's training."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    hardware: str
    """Such as ``one NVIDIA H200, 16 processor cores``."""
    options: str = ""
    """Of ``wrongturn train``, beside algorithm and seed."""
    notes: tuple[str, ...] = ()
    """Sentences that a reader should know."""


def card(agent: ShippedAgent, collection: Collection, curves: tuple[Curve, ...], facts: Facts) -> str:
    """The card of an agent whose weights are there.

    Args:
        agent: one of the shipped.
        collection: the stored results.
        curves: of the trainings.
        facts: what no file knows.

    Raises:
        ModelFileError: the weights are missing, or of another training than the results.
        OnnxRuntimeMissingError: onnxruntime is not installed.
    """
    session = open_session(agent.file)
    told: dict[str, str] = session.get_modelmeta().custom_metadata_map
    seed, words = int(told["seed"]), words_of(agent.name)
    if collection.shipped.get(agent.name, seed) != seed:
        raise ModelFileError(
            f"{agent.file.name}: it is of seed {seed}, and results/shipped.json names seed "
            f"{collection.shipped[agent.name]}; export that one, or correct the results",
        )
    curve = next((one for one in curves if (one.agent, one.seed, one.variant) == (agent.name, seed, None)), None)
    inputs = "\n".join(f"| `{put.name}` | {put.type[7:-1]} | {_shape(put.shape)} |" for put in session.get_inputs())
    parts = [
        f"# {agent.name}",
        f"{agent.description} {words.origin}",
        _table(
            {
                "file": f"`{agent.file.name}`, {agent.file.stat().st_size / 1e6:.1f} MB",
                "sha256": f"`{hashlib.sha256(agent.file.read_bytes()).hexdigest()}`",
                "track": f"`{agent.track}`",
                "weights": {**_PRECISION, "int8": words.int8}[told["precision"]],
                "licence": told["licence"],
            }
        ),
        "## Input and output",
        "| input | dtype | shape |\n|---|---|---|\n" + inputs,
        "The output `action` is float32 (batch, 3): steer in [-1, 1] (left negative), throttle and brake in [0, 1]. "
        f"{words.inside} `docs/models.md` has the contract of such files.",
        _agreement(told),
        "## Training",
        _table(_training(told, curve, facts, words)),
        _commands(agent, seed, told, facts),
        *([" ".join(facts.notes)] if facts.notes else []),
        "## How it drives",
        *_figures(agent, collection),
        "## Limits",
        f"It was trained in one simulated town, in four weathers, {_company(told)}, and with correct commands "
        "only. It has learned no reaction to a wrong command: the benchmark asks what it then does. "
        f"{words.others} It is for research on this benchmark alone, and not fit to drive a car.",
        "## Licence",
        f"{told['licence']}, as the rest of the package.",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


_PRECISION: Final = {
    "fp32": "32-bit floating point",
    "fp16": "stored as 16-bit floating point, computed in 32",
}


def read_facts(file: Path) -> dict[str, Facts]:
    """The facts by agent.

    Raises:
        ModelFileError: the file is missing, or a field is wrong.
    """
    try:
        return {name: Facts.model_validate(said) for name, said in json.loads(file.read_text("utf-8")).items()}
    except OSError as error:
        raise ModelFileError(f"{file}: cannot be read ({error.strerror}); write hardware of each agent there") from None
    except (ValueError, ValidationError) as error:
        raise ModelFileError(f"{file}: give each agent's hardware, options and notes, in JSON ({error})") from error


def cards(directory: Path = WEIGHTS, results: Path = STORED, curves: Path = LAB / "curves") -> dict[Path, str]:
    """The cards of all agents whose weights are there, by the file that each belongs into."""
    collection, trainings = Collection.read(results), read_curves(curves)
    present = [agent for agent in SHIPPED_AGENTS.values() if agent.file.is_file()]
    facts = read_facts(directory / FACTS) if present else {}
    lacking = [agent.name for agent in present if agent.name not in facts]
    if lacking:
        raise ModelFileError(f"{FACTS}: says nothing of {', '.join(lacking)}; write on what hardware it was trained")
    return {agent.card: card(agent, collection, trainings, facts[agent.name]) for agent in present}


def _table(rows: dict[str, str]) -> str:
    return "| | |\n|---|---|\n" + "\n".join(f"| {name} | {value} |" for name, value in rows.items())


def _shape(shape: list[Any]) -> str:
    return "(" + ", ".join(str(size) for size in shape) + ")"


def _agreement(told: dict[str, str]) -> str:
    if "agreement" not in told:
        return ""
    found = json.loads(told["agreement"])
    each = ", ".join(
        f"{control} {mean:.2g} ({greatest:.2g})"
        for control, mean, greatest in zip(_CONTROLS, found["mean"], found["greatest"], strict=True)
    )
    return (
        f"On {found['observations']} recorded observations, the file's actions differ from those of the checkpoint in "
        f"torch. The mean (greatest) differences are: {each}."
    )


def _company(told: dict[str, str]) -> str:
    """With whom it drove in training; the first files do not say it, and met nobody."""
    share = json.loads(told["config"]).get("traffic", 0)
    return f"beside simple traffic in {share:.0%} of the drives" if share else "without other road users"


def _training(told: dict[str, str], curve: Curve | None, facts: Facts, words: Words) -> dict[str, str]:
    versions = {name: version for name, version in json.loads(told["versions"]).items() if version != "unknown"}
    minutes = curve.last("minutes") if curve else math.nan
    held_out = ", ".join(
        f"{name.replace('_', ' ')} {value:.4g}"
        for name, value in json.loads(told["evaluation"]).items()
        if isinstance(value, int | float)
    )
    return {
        "data": "drives about Town01 in ClearNoon, WetNoon, HardRainNoon and ClearSunset, with correct commands only, "
        + _company(told),
        "seed": told["seed"],
        words.steps: f"{int(told['steps']):,}" + (f" (of {curve.last('step'):,.0f})" if curve else ""),
        "minutes": _STATED if math.isnan(minutes) else f"{minutes:.1f}",
        "hardware": facts.hardware,
        "held-out journeys, Town01": held_out or _STATED,
        "software": ", ".join(f"{name} {version}" for name, version in versions.items()) or _STATED,
    }


def _commands(agent: ShippedAgent, seed: int, told: dict[str, str], facts: Facts) -> str:
    options = f" {facts.options}" if facts.options else ""
    algorithm, checkpoint = trained_with(agent.name)
    lines = (
        f"wrongturn train {algorithm} --seed {seed}{options}",
        f"wrongturn export runs/{algorithm}-{seed}/{checkpoint} {agent.file.name} --precision {told['precision']}",
        f"wrongturn run {agent.name} --suite {WRONG_COMMAND}",
    )
    return "```sh\n" + "\n".join(lines) + "\n```"


def _figures(agent: ShippedAgent, collection: Collection) -> list[str]:
    """What is stored of the shipped weights, with Wilson's intervals, and of the algorithm over its seeds."""
    parts = []
    wrong = collection.of_shipped(WRONG_COMMAND, agent.name)
    if wrong is not None:
        counts = count_unsafe(wrong)
        strict, twins = (
            with_interval(counts.unsafe_strict, counts.trials),
            with_interval(counts.completed, counts.twins),
        )
        text = f"`{WRONG_COMMAND}`, {wrong.driven}: {strict} of {counts.trials} trials unsafe in the strict column, "
        text += f"{counts.unsafe} in the paper's; {twins} of {counts.twins} fault-free twins completed."
        found_by_seed = [found for seed, found in counts_by_seed(collection, agent.name).items() if seed is not None]
        seeds = [found.unsafe_strict for found in found_by_seed if found.drives]
        if len(seeds) > 1:
            text += f" Over {len(seeds)} training seeds, on the open draw, the strict count is {spread(seeds)}: "
            text += "median [least–most]"
            others = len(found_by_seed) - len(seeds)
            text += f". {others} more cannot drive, and say nothing about commands." if others else "."
        parts.append(text)
    journeys = collection.of_shipped(NAVIGATION, agent.name)
    if journeys is not None:
        suite = installed_suite(NAVIGATION)
        cells = count_success(journeys)
        driven = {
            trial.journey.task: how
            for name, how in collection.driven_how(NAVIGATION, agent.name).items()
            if (trial := suite.trials[name]).journey is not None
        }
        rows = [
            f"| {str(task).replace('_', ' ')} | {driven[task]} | {str(condition).replace('_', ' ')} | "
            f"{with_interval(found.arrived, found.episodes)} | {with_interval(found.clean, found.episodes)} | "
            f"{found.episodes} |"
            for (task, condition), found in sorted(cells.items(), key=lambda cell: _place(*cell[0]))
        ]
        head = f"| `{NAVIGATION}` | driven | condition | arrived | without infraction | of |"
        parts.append("\n".join([head, "|---|---|---|---|---|---|", *rows]))
    if not parts:
        return ["No results are stored yet."]
    return [*parts, "Brackets hold Wilson's 95 % interval of the rate."]


def _place(task: Task, condition: Condition) -> tuple[int, int]:
    return CORL_TASKS.index(task), list(Condition).index(condition)


def main() -> None:
    """Write the cards."""
    for file, text in cards().items():
        file.write_text(text, "utf-8")
        print(file.name, file=sys.stderr)


if __name__ == "__main__":
    main()
