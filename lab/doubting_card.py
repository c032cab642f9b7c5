"""Model cards of the doubting agents, from their files and the stored figures.

``python -m lab.doubting_card`` writes them beside the weights, and a test compares the two.
"""

import hashlib
import json
from typing import Any, Final

from lab.cards import FACTS, read_facts
from lab.doubting_pages import FIGURES
from lab.evaluations import read_evaluations
from lab.paths import LAB
from lab.wrong_command import count_unsafe
from wrongturn_agents.doubting_agent import DOUBTING_AGENTS, ShippedDoubtingAgent
from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.shipped_agents import WEIGHTS
from wrongturn_agents.training.methods.doubting.config import driver_of

_TOLD: Final = {
    "exits": "exits right, 5 to 16 m before the stop line",
    "approaches": "all three exits of a picture right, at the same distances",
    "distance": "mean error of the distance to the stop line, at the same distances, m",
    "inside": "rightly told to be nearer or farther than 2 m from the stop line",
}


def card(agent: ShippedDoubtingAgent) -> str:
    """Return the card of an agent whose file is there."""
    told: dict[str, str] = open_session(agent.file).get_modelmeta().custom_metadata_map
    facts = read_facts(WEIGHTS / FACTS)[agent.name]
    seed = told["seed"]
    evaluation = json.loads(told["evaluation"])
    data = agent.file.read_bytes()
    parts = [
        f"# {agent.name}",
        f"{agent.description} An agent of this project, not of a paper; `docs/doubting.md` describes it.",
        "**It was made for wrong commands.** It learned from places that a car reaches after a wrong command, and its "
        "gate was written for the faults of this benchmark. The leaderboard marks it with † (`trained_on_faults`). "
        "Compare it with other agents that are so marked.",
        _table(
            {
                "file": f"`{agent.file.name}`, {len(data) / 1e6:.1f} MB, beside `{agent.drives}.onnx`, which drives",
                "sha256": f"`{hashlib.sha256(data).hexdigest()}`",
                f"sha256 of `{agent.drives}.onnx`": f"`{driver_of(agent.name)}`",
                "track": f"`{agent.track}`",
                "memory": "8 numbers, within an episode",
                "licence": told["licence"],
            }
        ),
        "## Training",
        _table(
            {
                "pictures": f"{int(told['steps']):,}, each seen once",
                "weathers": "ClearNoon, WetNoon, HardRainNoon and ClearSunset",
                "towns": f"Town01 and {json.loads(told['config'])['generated']} generated ones",
                "seed": seed,
                "hardware": facts.hardware,
            }
        ),
        "```sh\n"
        f"wrongturn train {agent.name} --seed {seed} {facts.options}\n"
        f"wrongturn export runs/{agent.name}-{seed}/best.pt {agent.name}.onnx --precision {told['precision']}\n"
        "```",
        *([" ".join(facts.notes)] if facts.notes else []),
        "## What it tells",
        _told(evaluation),
        "## How it drives",
        _drives(agent, int(seed)),
        "## Limits",
        f"It drives as `{agent.drives}` does; the card of `{agent.drives}` has more. It knows junctions with three and "
        "four arms at right angles. If the road has the exit of a wrong command, it cannot know that the command is "
        "wrong. Its doubt never saw traffic. It is for research on this benchmark alone, and not fit to drive a car.",
        "## Licence",
        f"{told['licence']}, as the rest of the package.",
    ]
    return "\n\n".join(parts) + "\n"


def _told(evaluation: dict[str, dict[str, float]]) -> str:
    heads = list(evaluation)
    rows = [f"| {text} | " + " | ".join(f"{evaluation[head][name]:.4g}" for head in heads) + " |"
            for name, text in _TOLD.items()]  # fmt: skip
    return "\n".join(["| | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads), *rows])


def _drives(agent: ShippedDoubtingAgent, seed: int) -> str:
    figures: list[dict[str, Any]] = json.loads(FIGURES.read_text("utf-8")) if FIGURES.is_file() else []
    own = [
        one
        for one in figures
        if (one["algorithm"], one["seed"]) == (agent.name, seed) and not one["gate"] and one["variant"] is None
    ]
    counted = [count_unsafe(one) for one in read_evaluations(LAB) if one.agent == agent.name]
    if not own and not counted:
        return "No results are stored yet."
    lines = []
    if counted:
        unsafe, trials, done, twins = (
            sum(getattr(one, name) for one in counted) for name in ("unsafe_strict", "trials", "completed", "twins")
        )
        where = "Town01, ClearNoon, over the service"
        lines.append(f"| {where} | {len(counted)} | {unsafe} of {trials} | {done} of {twins} |")
    for place in dict.fromkeys((one["town"], one["weather"]) for one in own):
        there = [one for one in own if (one["town"], one["weather"]) == place]
        sums = {
            name: sum(one[name] for one in there) for name in ("unsafe_strict", "trials", "twins_completed", "twins")
        }
        lines.append(
            f"| {place[0]}, {place[1]}, in process | {len(there)} | {sums['unsafe_strict']} of {sums['trials']} | "
            f"{sums['twins_completed']} of {sums['twins']} |"
        )
    return "\n".join(["| draws of `wrong-command@2`'s cells | draws | unsafe, strict | twins completed |",
                      "|---|---:|---:|---:|", *lines])  # fmt: skip


def _table(rows: dict[str, str]) -> str:
    return "| | |\n|---|---|\n" + "\n".join(f"| {name} | {value} |" for name, value in rows.items())


def main() -> None:
    """Write the cards of all agents whose files are there."""
    for agent in DOUBTING_AGENTS.values():
        if agent.file.is_file():
            agent.card.write_text(card(agent), "utf-8")


if __name__ == "__main__":
    main()
