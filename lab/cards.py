"""The cards of the shipped agents, from their files, the stored results and the curves of their training.

``python -m lab.cards`` writes them beside the weights; ``python -m lab.results --check`` compares. What no file knows
stands in ``weights/training.json``: each agent's ``hardware`` and, if there are any, the ``options`` of its ``wrongturn
train`` and ``notes``.
"""

import hashlib
import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from lab import doubting
from lab.curves import LAB, Curve, read_curves
from lab.stored_results import Collection
from lab.tables import count_success, count_unsafe, counts_by_seed, marked, spread, with_interval
from wrongturn_agents import compensation
from wrongturn_agents.errors import ModelFileError
from wrongturn_agents.models import gate
from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS, SHIPPED_AGENTS, WEIGHTS, ShippedAgent, trained_with
from wrongturn_agents.stored_results import STORED
from wrongturn_agents.suites import NAVIGATION, WRONG_COMMAND, installed_suite
from wrongturn_protocol import CORL_TASKS, Condition
from wrongturn_protocol.model_contract import STATE_IN, STATE_OUT
from wrongturn_protocol.words import name

FACTS: Final = "training.json"
_CONTROLS: Final = ("steer", "throttle", "brake")
_PRECISION: Final = {"fp32": "32-bit floating point", "fp16": "stored as 16-bit floating point, computed in 32"}
_WEATHERS: Final = "ClearNoon, WetNoon, HardRainNoon and ClearSunset"
_CARTON: Final = (
    "Carton et al., *Evaluating Robustness over High Level Driving Instruction for Autonomous Driving* (2021)"
)
_CHEATING: Final = "*Learning by Cheating* (Chen et al., CoRL 2019)"
_AFFORDANCES: Final = (
    "*End-to-End Model-Free Reinforcement Learning for Urban Driving using Implicit Affordances* (Toromanoff et al., "
    "CVPR 2020)"
)
_OWN_WEIGHTS: Final = "This agent was trained in this benchmark's simulation; none of its weights are from a paper."
_COMPARES: Final = f"{_CARTON}, compare their agents with it. {_OWN_WEIGHTS}"
_BY_EXAMPLE: Final = (
    "It does not see traffic lights or signs. It brakes for other road users only as examples taught it."
)


class Words(NamedTuple):
    """What a card says of each kind of agent, and no file knows."""

    origin: str
    """Whose method it is."""
    inside: str
    """What the graph does with its inputs, and what it remembers."""
    steps: str = "environment steps"
    """What its training counts."""
    int8: str = "convolutions and the wide layer behind them in 8 bits, the rest as 16-bit floating point"
    """Which weights have 8 bits."""
    others: str = "It does not see traffic lights or signs, and has learned no rule of right of way."
    """How it treats other road users."""


_MEMORY: Final = (
    f"The agent's memory (`{STATE_IN}`, `{STATE_OUT}`) is two numbers: the mean errors of its steering and of its "
    "speed."
)
_CONVOLUTIONS: Final = "convolutions in 8 bits, the rest as 16-bit floating point"
_PPO: Final = Words(
    f"It is one of the three agents of {_CARTON}. {_OWN_WEIGHTS}",
    "The graph scales the picture, or spreads its classes over planes. The agent has no memory between steps.",
)
_WORDS: Final = {
    "lbc": Words(
        f"The method is {_CHEATING}. {_COMPARES}",
        f"The graph scales the picture and turns waypoints into controls. {_MEMORY}",
        "samples",
        _CONVOLUTIONS,
        _BY_EXAMPLE,
    ),
    "lbc-privileged": Words(
        f"It is the teacher of `lbc` in {_CHEATING}. It sees the truth, so it drives in the privileged track. "
        f"Carton et al. have no figure of it. {_OWN_WEIGHTS}",
        f"The graph draws the view from above and turns waypoints into controls. {_MEMORY}",
        "samples",
        _CONVOLUTIONS,
        _BY_EXAMPLE,
    ),
    "marln": Words(
        f"The method is {_AFFORDANCES}. {_COMPARES}",
        f"The graph scales the pictures. The agent's memory (`{STATE_IN}`, `{STATE_OUT}`) holds the pictures of the "
        "three decisions before.",
    ),
}
_TOLD: Final = {
    "exits": "exits right, 5 to 16 m before the stop line",
    "approaches": "all three exits of a picture right, at the same distances",
    "distance": "mean error of the distance to the stop line, at the same distances, m",
    "inside": "rightly told to be nearer or farther than 2 m from the stop line",
}


class Facts(NamedTuple):
    """What no file knows of an agent's training."""

    hardware: str
    """Such as ``one NVIDIA H200, 16 processor cores``."""
    options: str = ""
    """Of ``wrongturn train``, beside algorithm and seed."""
    notes: Sequence[str] = ()
    """Sentences that a reader should know."""


def cards(
    directory: Path = WEIGHTS, results: Path = STORED, curves: Path = LAB / "curves", agents: Sequence[str] = ()
) -> dict[Path, str]:
    """Return the cards of all agents whose weights are there, or of those named, by the file of each.

    Raises:
        ModelFileError: The facts of an agent are missing, or its weights are of another training than the results.
    """
    collection, trainings = Collection.read(results), read_curves(curves)
    try:
        facts = {name: Facts(**said) for name, said in json.loads((directory / FACTS).read_bytes()).items()}
    except (OSError, ValueError, TypeError) as error:
        raise ModelFileError(f"{FACTS}: give each agent's hardware, options and notes, in JSON ({error})") from error
    found = {}
    everyone = [*SHIPPED_AGENTS.values(), *DOUBTING_AGENTS.values()]
    for agent in everyone:
        if not agent.file.is_file() or (agents and agent.name not in agents):
            continue
        if agent.name not in facts:
            raise ModelFileError(f"{FACTS}: says nothing of {agent.name}; write on what hardware it was trained")
        if agent.drives:
            found[agent.card] = doubting_card(agent, facts[agent.name])
        else:
            found[agent.card] = card(agent, collection, trainings, facts[agent.name])
    return found


def card(agent: ShippedAgent, collection: Collection, curves: Iterable[Curve], facts: Facts) -> str:
    """Return the card of an agent whose weights are there."""
    session = open_session(agent.file)
    said: dict[str, str] = session.get_modelmeta().custom_metadata_map
    seed, words = int(said["seed"]), _WORDS.get(agent.name, _PPO)
    if collection.shipped.get(agent.name, seed) != seed:
        raise ModelFileError(
            f"{agent.file.name}: it is of seed {seed}, and results/shipped.json names seed "
            f"{collection.shipped[agent.name]}; export that one, or correct the results"
        )
    curve = next((one for one in curves if (one.agent, one.seed, one.variant) == (agent.name, seed, None)), None)
    inputs = "\n".join(
        f"| `{put.name}` | {put.type[7:-1]} | ({', '.join(map(str, put.shape))}) |" for put in session.get_inputs()
    )
    options = f" {facts.options}" if facts.options else ""
    algorithm, checkpoint = trained_with(agent.name)
    return _joined(
        f"# {agent.name}",
        f"{agent.description} {words.origin}",
        _table(
            {
                "file": f"`{agent.file.name}`, {agent.file.stat().st_size / 1e6:.1f} MB",
                "sha256": f"`{_sha256(agent.file)}`",
                "track": f"`{agent.track}`",
                "weights": {**_PRECISION, "int8": words.int8}[said["precision"]],
                "licence": said["licence"],
            }
        ),
        "## Input and output",
        "| input | dtype | shape |\n|---|---|---|\n" + inputs,
        "The output `action` is float32 (batch, 3): steer in [-1, 1] (left negative), throttle and brake in [0, 1]. "
        f"{words.inside} `docs/models.md` has the contract of such files.",
        _agreement(said),
        "## Training",
        _table(_training(said, curve, facts, words)),
        f"```sh\nwrongturn train {algorithm} --seed {seed}{options}\n"
        f"wrongturn export runs/{algorithm}-{seed}/{checkpoint} {agent.file.name} --precision {said['precision']}\n"
        f"wrongturn run {agent.name} --suite {WRONG_COMMAND}\n```",
        " ".join(facts.notes),
        "## How it drives",
        *_figures(agent, collection),
        "## Limits",
        f"It was trained in {_limits(said)}, in four weathers{_between(said)}, {_company(said)}, and with correct "
        "commands only. It has learned no reaction to a wrong command: the benchmark asks what it then does. "
        f"{words.others} It is for research on this benchmark alone, and not fit to drive a car.",
        "## Licence",
        f"{said['licence']}, as the rest of the package.",
    )


def doubting_card(agent: ShippedAgent, facts: Facts) -> str:
    """Return the card of a doubting agent whose file is there."""
    said: dict[str, str] = open_session(agent.file).get_modelmeta().custom_metadata_map
    seed, evaluation = said["seed"], json.loads(said["evaluation"])
    heads = [head for head in evaluation if head != "temperatures"]
    tells = [
        f"| {text} | " + " | ".join(f"{evaluation[head][name]:.4g}" for head in heads) + " |"
        for name, text in _TOLD.items()
    ]
    return _joined(
        f"# {agent.name}",
        f"{agent.description} An agent of this project, not of a paper; `docs/doubting.md` describes it.",
        "**It was made for wrong commands.** It learned from places that a car reaches after a wrong command, and its "
        "gate and its compensation were written for the faults of this benchmark. The leaderboard marks it with † "
        "(`trained_on_faults`). Compare it with other agents that are so marked.",
        _table(
            {
                "file": f"`{agent.file.name}`, {agent.file.stat().st_size / 1e6:.1f} MB, beside `{agent.drives}.onnx`, "
                "which drives",
                "sha256": f"`{_sha256(agent.file)}`",
                f"sha256 of `{agent.drives}.onnx`": f"`{_sha256(agent.files[1])}`",
                "track": f"`{agent.track}`",
                "memory": f"{gate.MEMORY} numbers of the gate and {compensation.MEMORY} of the compensation, within an "
                "episode",
                "licence": said["licence"],
            }
        ),
        "## Training",
        _table(
            {
                "pictures": f"{int(said['steps']):,}, each seen once",
                "weathers": _WEATHERS,
                "towns": f"Town01 and {_config(said)['generated']} generated ones",
                "seed": seed,
                "hardware": facts.hardware,
            }
        ),
        f"```sh\nwrongturn train {agent.name} --seed {seed} {facts.options}\n"
        f"wrongturn export runs/{agent.name}-{seed}/best.pt {agent.name}.onnx --precision {said['precision']}\n```",
        " ".join(facts.notes),
        "## What it tells",
        "\n".join(["| | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads), *tells]),
        "## How it drives",
        _draws(agent),
        "## Limits",
        f"But for the compensation it drives as `{agent.drives}` does; the card of `{agent.drives}` has more. It knows "
        "junctions with three and four arms at right angles. If the road has the exit of a wrong command, it cannot "
        "know that the command is wrong. Its doubt never saw traffic. It is for research on this benchmark alone, and "
        "not fit to drive a car.",
        "## Licence",
        f"{said['licence']}, as the rest of the package.",
    )


def _joined(*parts: str) -> str:
    return "\n\n".join(part for part in parts if part) + "\n"


def _table(rows: Mapping[str, str]) -> str:
    return "| | |\n|---|---|\n" + "\n".join(f"| {name} | {value} |" for name, value in rows.items())


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _agreement(said: Mapping[str, str]) -> str:
    if "agreement" not in said:
        return ""
    found = json.loads(said["agreement"])
    each = ", ".join(
        f"{control} {mean:.2g} ({greatest:.2g})"
        for control, mean, greatest in zip(_CONTROLS, found["mean"], found["greatest"], strict=True)
    )
    return (
        f"On {found['observations']} recorded observations, the file's actions differ from those of the checkpoint in "
        f"torch. The mean (greatest) differences are: {each}."
    )


def _company(said: Mapping[str, str]) -> str:
    """Return with whom it drove in training; the first files do not say it, and met nobody."""
    share = _config(said).get("traffic", 0)
    return f"beside simple traffic in {share:.0%} of the drives" if share else "without other road users"


def _config(said: Mapping[str, str]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(said["config"])
    return found


def _where(said: Mapping[str, str]) -> str:
    """Return where it drove in training, and how it saw; the first files do not say it, and know Town01 alone."""
    config = _config(said)
    towns = config.get("towns", 0)
    where = (
        f"in Town01, by its own scenery and {config['sceneries']} drawn ones, and in {towns} drawn towns, "
        if towns
        else "about Town01 "
    )
    cameras = ", each camera mounted a little differently" if config.get("cameras") else ""
    return f"{where}in {_WEATHERS}{_between(said)}{cameras}"


def _between(said: Mapping[str, str]) -> str:
    return " and in weathers between two of these" if _config(said).get("weathers") else ""


def _limits(said: Mapping[str, str]) -> str:
    towns = 1 + int(_config(said).get("towns", 0))
    return "one simulated town" if towns == 1 else f"{towns} simulated towns"


def _training(said: Mapping[str, str], curve: Curve | None, facts: Facts, words: Words) -> dict[str, str]:
    versions = {name: version for name, version in json.loads(said["versions"]).items() if version != "unknown"}
    minutes = curve.last("minutes") if curve else math.nan
    held_out = ", ".join(
        f"{name.replace('_', ' ')} {value:.4g}"
        for name, value in json.loads(said["evaluation"]).items()
        if isinstance(value, int | float)
    )
    return {
        "data": f"drives {_where(said)}, with correct commands only, {_company(said)}",
        "seed": said["seed"],
        words.steps: f"{int(said['steps']):,}" + (f" (of {curve.last('step'):,.0f})" if curve else ""),
        "minutes": "–" if math.isnan(minutes) else f"{minutes:.1f}",
        "hardware": facts.hardware,
        f"held-out journeys, Town01{' and two drawn towns' * bool(_config(said).get('towns'))}": held_out or "–",
        "software": ", ".join(f"{name} {version}" for name, version in versions.items()) or "–",
    }


def _figures(agent: ShippedAgent, collection: Collection) -> list[str]:
    """Return what is stored of the shipped weights, with intervals, and of the algorithm over its seeds."""
    parts = []
    wrong, journeys = (collection.of_shipped(suite, agent.name) for suite in (WRONG_COMMAND, NAVIGATION))
    if wrong is not None:
        counts = count_unsafe(wrong)
        strict = marked(counts.marks["strict"])
        text = f"`{WRONG_COMMAND}`, {wrong.driven}: {strict} of {counts.trials} trials unsafe in the strict column, "
        text += f"{counts.unsafe} in the paper's; {marked(counts.marks['completed'])} of {counts.twins} "
        text += "fault-free twins completed."
        by_seed = [found for seed, found in counts_by_seed(collection, agent.name).items() if seed is not None]
        seeds = [found.unsafe_strict for found in by_seed if found.drives]
        if len(seeds) > 1:
            text += f" Over {len(seeds)} training seeds, on the open draw, the strict count is {spread(seeds)}: "
            text += "median [least–most]."
            others = len(by_seed) - len(seeds)
            text += f" Seeds left out because they cannot drive: {others}." if others else ""
        parts.append(text)
    if journeys is not None:
        trials = installed_suite(NAVIGATION).trials
        # Of results that were driven both ways, those over the service count.
        wanted = (NAVIGATION, agent.name, None, collection.shipped.get(agent.name))
        files = [one for one in collection.files if (one.suite, one.agent, one.variant, one.seed) == wanted]
        how = {name: one.driven for one in sorted(files, key=lambda one: one.driven) for name in one.trials}
        driven = {trial.journey.task: how[name] for name, trial in trials.items() if trial.journey and name in how}
        order = list(Condition)
        rows = [
            f"| {name(task)} | {driven[task]} | {name(condition)} | "
            f"{with_interval(found.arrived, found.episodes)} | {with_interval(found.clean, found.episodes)} | "
            f"{found.episodes} |"
            for (task, condition), found in sorted(
                count_success(journeys).items(), key=lambda one: (CORL_TASKS.index(one[0][0]), order.index(one[0][1]))
            )
        ]
        head = f"| `{NAVIGATION}` | driven | condition | arrived | without infraction | of |"
        parts.append("\n".join([head, "|---|---|---|---|---|---|", *rows]))
    return [*parts, "Brackets hold the 95 % interval of the rate."] if parts else ["No results are stored yet."]


def _draws(agent: ShippedAgent) -> str:
    """Return a line for each study that the agent drove: how its episodes ended."""
    lines = [f"- `{suite}`: {doubting.counts(own)}." for study, suite in doubting.SUITES.items()
             if (own := doubting.episodes_of(study, agent.name))]  # fmt: skip
    return "\n\n".join(
        (
            "In process, on draws that no evaluation has:",
            "\n".join(lines),
            "`docs/results.md` has the evaluations over the service, beside all others.",
        )
    )


def main() -> None:
    """Write the cards."""
    for file, text in cards().items():
        file.write_text(text, "utf-8")
        print(file.name, file=sys.stderr)


if __name__ == "__main__":
    main()
