"""What doubting agents bear, and what their doubt is worth, on draws that no evaluation has.

    python -m lab.doubting unseen doubting --secrets 10     # wrong-command-unseen@1
    python -m lab.doubting disturbed doubting               # disturbed@1
    python -m lab.doubting extended doubting                # wrong-command-extended@1, trials without other road users
    python -m lab.doubting unseen doubting --unheard        # the gate looks on, and the driving agent obeys
    python -m lab.doubting unseen doubting --camera "2° up" # by another camera
    python -m lab.doubting known runs/doubting-1/best.pt --gate omission=false    # wrong-command@3, a part taken away
    python -m lab.doubting pictures runs/doubting-1/best.pt # what it tells of disturbed pictures

The secrets are ``doubts 1`` and so on: they belong to no evaluation. What a shipped agent drives is kept in
``lab/stored/studies/doubting.json``, each episode of it, and not driven again while its files are the same.
"""

import argparse
import json
import math
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from lab.studies import STUDIES, threads
from lab.tables import Row, Table
from wrongturn_agents.doubting_agent import DoubtingAgent
from wrongturn_agents.errors import AgentsError
from wrongturn_agents.models.gate import GateConfig
from wrongturn_agents.onnx_agent import OnnxAgent, open_session
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS, SHIPPED_AGENTS
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.export import sha256
from wrongturn_agents.training.method import load
from wrongturn_agents.training.methods.doubting.exporting import write_doubting
from wrongturn_agents.training.methods.doubting.frames import CHUNK, examine
from wrongturn_agents.training.world import HELD_OUT, towns_of
from wrongturn_networks import load_suite
from wrongturn_networks.drawn import build_towns
from wrongturn_networks.faults import fault_class
from wrongturn_protocol import DIRECTIONS, Command, FaultKind, Trial, words
from wrongturn_protocol.observations import observation_space
from wrongturn_sim import VEHICLE, Episode, JudgeGeometry
from wrongturn_sim.camera import Camera

FILE: Final = STUDIES / "doubting.json"
SUITES: Final = {
    "known": "wrong-command@3",
    "unseen": "wrong-command-unseen@1",
    "disturbed": "disturbed@1",
    "extended": "wrong-command-extended@1",
}
CAMERAS: Final = {
    "as it is": Camera(),
    "2° up": Camera(pitch=-math.radians(2)),
    "2° down": Camera(pitch=math.radians(2)),
    "4° up": Camera(pitch=-math.radians(4)),
    "4° down": Camera(pitch=math.radians(4)),
    "0.6 m higher": Camera(up=Camera().up + 0.6),
    "0.6 m lower": Camera(up=Camera().up - 0.6),
    "focal length 20 % longer": Camera(focal=1.2 * Camera().focal),
    "20 % shorter": Camera(focal=0.8 * Camera().focal),
}
"""Cameras with which pictures are examined, or trials driven."""
USUAL: Final = "as it is"
NOISES: Final = (15.0, 30.0)
_PICTURES: Final = 1024
_ANSWERED: Final = {str(FaultKind.NONE), str(FaultKind.INFEASIBLE), str(FaultKind.OMISSION)}
"""Faults that a doubt can see in the picture, and none."""
_HANDED_OVER: Final = (0.0, 0.1, 0.25, 0.5)
"""Shares of the episodes that somebody else takes over, those of the greatest doubt first."""
Key = tuple[str, str, bool]
"""Study, with its camera if that is not the usual one; agent; and whether the gate was unheard."""


class Driven(NamedTuple):
    """What became of one episode."""

    cell: str
    """Fault and dose; ``none`` for a twin."""
    unsafe: bool
    completed: bool
    replaced: int
    """Decisions in which a named direction became another one."""
    doubt: float
    """Doubt at the last decision before the stop line."""


def drive(gate: Path, drives: str, unheard: bool, camera: str, trial: Trial) -> Driven:
    """Drive a trial as a shipped agent behind a gate's file. ``unheard``, the gate only looks on."""
    agent = _agent(gate, drives)
    episode = Episode(trial, agent.track, camera=CAMERAS[camera])
    seen, replaced, doubt = episode.reset(), 0, 0.0
    agent.reset(observation_space(agent.track))
    assert isinstance(episode.geometry, JudgeGeometry)
    while episode.outcome is None:
        row = episode.trajectory.rows[-1]
        before = episode.geometry.beside_approach(row.x, row.y)[0] + VEHICLE.half_length < 0.0
        given = Command(int(seen["command"][0]))
        obeyed = agent.question(seen)
        action: Any = agent.driving.act(seen) if unheard else agent.drive(seen, obeyed)
        replaced += given in DIRECTIONS and agent.obeyed in DIRECTIONS and agent.obeyed != given
        doubt = agent.doubt or 0.0 if before else doubt
        seen = episode.step(action.steer, action.throttle, action.brake).observation
    fault, outcome = trial.fault, episode.outcome
    cell = str(fault.kind) if fault.dose is None else f"{fault.kind} {fault.dose:g}"
    return Driven(cell, outcome.unsafe_strict, outcome.completed, replaced, round(doubt, 4))


@lru_cache(maxsize=2)
def _agent(gate: Path, drives: str) -> DoubtingAgent:
    return DoubtingAgent(open_session(gate), OnnxAgent(SHIPPED_AGENTS[drives].file))


def drive_draw(study: str, secret: str, gate: Path, drives: str, *, unheard: bool, camera: str = USUAL) -> list[Driven]:
    """Drive the episodes of a draw that have no other road users."""
    suite = load_suite(SUITES[study])
    build_towns(suite.drawn_towns(secret))
    episodes = [one for one in suite.draw(secret).episodes if not (one.traffic.vehicles or one.traffic.pedestrians)]
    with ProcessPoolExecutor(threads()) as pool:
        return list(pool.map(partial(drive, gate, drives, unheard, camera), episodes, chunksize=4))


def run(
    study: str, asked: str, secrets: Sequence[str], *, unheard: bool, options: Sequence[str], camera: str = USUAL
) -> None:
    """Drive the draws of a study that are not kept, and keep those of a shipped agent."""
    name = _named(study, camera)
    said = f"{name}: {asked}{' unheard' * unheard}{''.join(f' {one}' for one in options)}"
    drive_secret = partial(drive_draw, study, unheard=unheard, camera=camera)
    if asked not in DOUBTING_AGENTS:
        loaded = load(asked)
        if loaded.agent.name not in DOUBTING_AGENTS:
            raise TrainingError(f"agent: {asked} is of {loaded.agent.name}; name best.pt of a doubting agent")
        with tempfile.TemporaryDirectory() as folder:
            gate = Path(folder) / "gate.onnx"
            write_doubting(loaded, gate, "fp16", gate=gate_of(options), whole=False)
            for secret in secrets:
                found = drive_secret(secret, gate, DOUBTING_AGENTS[loaded.agent.name].drives)
                print(f"{said}, {secret}: {counts(found)}", flush=True)
        return
    if options:
        raise TrainingError(f"--gate: {asked} is shipped with its gate; name a checkpoint to change it")
    agent, kept = DOUBTING_AGENTS[asked], read()
    files = [sha256(file) for file in agent.files]
    own: dict[str, Any] = kept.get((name, asked, unheard), {})
    if own.get("files") != files:
        own = {"files": files, "draws": {}}
    for secret in secrets:
        if secret not in own["draws"]:
            own["draws"][secret] = drive_secret(secret, agent.file, agent.drives)
            kept[name, asked, unheard] = own
            lines = (json.dumps([*key, kept[key]], separators=(",", ":")) for key in sorted(kept))
            FILE.write_text("[" + ",\n".join(lines) + "]\n", "utf-8")
        print(f"{said}, {secret}: {counts([Driven(*one) for one in own['draws'][secret]])}", flush=True)


def examine_pictures(checkpoint: str) -> None:
    """Print what a checkpoint tells of pictures of towns that it never saw, by each camera and with noise."""
    model: Any = load(checkpoint).model
    towns = towns_of(HELD_OUT)
    looks = [(name, camera, 0.0) for name, camera in CAMERAS.items()]
    for name, camera, noise in (*looks, *((f"noise of {noise:g}", Camera(), noise) for noise in NOISES)):
        found = examine(model, towns, pictures=_PICTURES, threads=threads(), cameras=[camera] * CHUNK, noise=noise)
        print(f"{name}: all exits right {found['approaches']:.2f}, distance {found['distance']:.1f} m", flush=True)


def gate_of(options: Sequence[str]) -> GateConfig:
    """Return a gate's settings with the fields of ``name=value`` options changed."""
    changed: dict[str, Any] = {}
    for name, _, text in (option.partition("=") for option in options):
        try:
            is_bool = isinstance(getattr(GateConfig(), name), bool)
            changed[name] = {"true": True, "false": False}[text] if is_bool else float(text)
        except (AttributeError, KeyError, ValueError) as error:
            known = ", ".join(field.name for field in fields(GateConfig))
            raise TrainingError(f"--gate: {name}={text}: give name=value, with one of {known}") from error
    return replace(GateConfig(), **changed)


def _named(study: str, camera: str) -> str:
    """Return the name by which a study with a camera is kept."""
    return study if camera == USUAL else f"{study}, {camera}"


def read() -> dict[Key, Any]:
    """Return what is kept."""
    rows = json.loads(FILE.read_bytes()) if FILE.is_file() else []
    return {(study, agent, unheard): found for study, agent, unheard, found in rows}


def episodes_of(study: str, name: str, *, unheard: bool = False) -> list[Driven]:
    """Return all episodes of an agent that are kept of a study, whatever the draw."""
    found = read().get((study, name, unheard), {"draws": {}})
    return [Driven(*one) for draw in found["draws"].values() for one in draw]


def _sides(driven: Sequence[Driven]) -> tuple[list[Driven], list[Driven]]:
    """Return the episodes with a fault, and the twins."""
    faulted, twins = ([one for one in driven if (one.cell == FaultKind.NONE) is twin] for twin in (False, True))
    return faulted, twins


def _ended(driven: Sequence[Driven]) -> tuple[str, str, str]:
    """Return the unsafe trials, the completed twins, and the twins in which a right direction was replaced."""
    faulted, twins = _sides(driven)
    return (
        f"{sum(one.unsafe for one in faulted)} of {len(faulted)}",
        f"{sum(one.completed for one in twins)} of {len(twins)}",
        f"{sum(one.replaced > 0 for one in twins)} of {len(twins)}",
    )


def counts(driven: Sequence[Driven]) -> str:
    """Return in words how episodes ended."""
    unsafe, completed, replaced = _ended(driven)
    return f"unsafe {unsafe}, twins {completed}, false alarms in {replaced.split()[0]}"


def unseen_table() -> Table:
    """Return what the agents do in towns that nobody has seen, and how often they replace a right command."""
    rows: list[Row] = []
    for name, agent in DOUBTING_AGENTS.items():
        for unheard in (False, True):
            driven = episodes_of("unseen", name, unheard=unheard)
            if driven:
                unsafe, completed, replaced = _ended(driven)
                driver = f"`{agent.drives}` behind it" if unheard else f"`{name}`"
                rows.append((driver, unsafe, completed, "–" if unheard else replaced))
    head = ("agent", "unsafe, strict", "twins completed", "twins with a right direction replaced")
    return Table("Doubting agents in unseen towns", head, rows, words=1)


def borne_table() -> Table:
    """Return what the agents do under each disturbance, whose commands are right, and how wrong their doubt is."""
    driven = {name: episodes_of("disturbed", name) for name in DOUBTING_AGENTS}
    rows: list[Row] = []
    for cell in dict.fromkeys(one.cell for one in next(iter(driven.values())) if one.cell != FaultKind.NONE):
        dose = fault_class(FaultKind(cell.split()[0])).dose
        row = [f"{words.name(cell)} {dose.unit if dose else ''}".rstrip()]
        for episodes in driven.values():
            own = [one for one in episodes if one.cell == cell]
            score = sum(one.doubt**2 for one in own) / len(own)
            row += [f"{sum(one.unsafe for one in own)} of {len(own)}", f"{score:.3f}"]
        rows.append(tuple(row))
    head = [f"`{name}`: {text}" for name in driven for text in ("unsafe, strict", "Brier score")]
    twins = [_sides(episodes)[1] for episodes in driven.values()]
    note = f"Twins completed: {' and '.join(f'{sum(one.completed for one in own)} of {len(own)}' for own in twins)}."
    return Table("Doubting agents under disturbances", ("disturbance", *head), rows, note, words=1)


def tilted_table() -> Table:
    """Return how the agents handle wrong commands in unseen towns, with the usual camera and with others."""
    rows: list[Row] = []
    for name in DOUBTING_AGENTS:
        for camera in CAMERAS:
            driven = episodes_of(_named("unseen", camera), name)
            if driven:
                rows.append((f"`{name}`", camera, *_ended(driven), *_worth(driven)))
    head = ("agent", "camera", "unsafe, strict", "twins completed", "twins with a right direction replaced",
            "AUROC of the doubt", "Brier score")  # fmt: skip
    return Table("Doubting agents and other cameras", head, rows, words=2)


def doubt_table() -> Table:
    """Return what the doubt is worth: unheard, it looks on while the driving agent obeys."""
    rows: list[Row] = []
    for name in DOUBTING_AGENTS:
        for study in ("unseen", "extended"):
            driven = [one for one in episodes_of(study, name, unheard=True) if one.cell in _ANSWERED]
            if driven:
                doubts, unsafe = np.array([one.doubt for one in driven]), np.array([one.unsafe for one in driven])
                risks = (f"{100 * share:.1f} %" for share in risk(doubts, unsafe, _HANDED_OVER))
                rows.append((f"`{name}`", f"`{SUITES[study]}`", str(len(driven)), *_worth(driven), *risks))
    head = ("doubt of", "suite", "episodes", "AUROC", "Brier score",
            *(f"unsafe, {100 * share:.0f} % handed over" for share in _HANDED_OVER))  # fmt: skip
    return Table("What doubt is worth", head, rows, words=2)


def _worth(driven: Sequence[Driven]) -> tuple[str, str]:
    """Return the AUROC and the Brier score of doubts."""
    doubts = np.array([one.doubt for one in driven])
    wrong = np.array([one.cell != FaultKind.NONE for one in driven])
    return f"{auroc(doubts, wrong):.3f}", f"{((doubts - wrong) ** 2).mean():.3f}"


def auroc(scores: Any, positive: Any) -> float:
    """Return the area under the ROC curve: how often a positive has the greater score than a negative."""
    from scipy.stats import mannwhitneyu  # scipy.stats takes a second

    statistic = mannwhitneyu(scores[positive], scores[~positive]).statistic
    return float(statistic / (positive.sum() * (~positive).sum()))


def risk(doubts: Any, unsafe: Any, shares: Iterable[float]) -> list[float]:
    """Return the unsafe share of the episodes that are left, when shares of them are handed over."""
    ordered = unsafe[np.argsort(doubts, kind="stable")]
    return [float(ordered[: round(len(ordered) * (1.0 - share))].mean()) for share in shares]


TABLES: Final = {"unseen": unseen_table, "borne": borne_table, "tilted": tilted_table, "doubt": doubt_table}
"""What makes the tables of ``docs/doubting.md``, by name."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the program; an error is one line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=(*SUITES, "pictures"))
    parser.add_argument("agent", help="doubting, doubting-segmentation, or best.pt of 'wrongturn train doubting'")
    parser.add_argument("--secrets", type=int, default=1, metavar="N", help="drive N draws; 1 by default")
    parser.add_argument("--unheard", action="store_true", help="the gate looks on, and the driving agent obeys")
    parser.add_argument("--camera", choices=CAMERAS, default=USUAL, help="drive 'unseen' by another camera")
    parser.add_argument("--gate", action="append", default=[], metavar="NAME=VALUE", help="setting of a gate")
    asked = parser.parse_args(arguments)
    if asked.camera != USUAL and asked.study != "unseen":
        parser.error(f"--camera: is for the study 'unseen', not for {asked.study!r}")
    secrets = [f"doubts {number}" for number in range(1, asked.secrets + 1)]
    try:
        if asked.study == "pictures":
            examine_pictures(asked.agent)
            return
        run(asked.study, asked.agent, secrets, unheard=asked.unheard, options=asked.gate, camera=asked.camera)
    except (AgentsError, TrainingError, OSError) as error:
        raise SystemExit(f"lab.doubting: {error}") from error


if __name__ == "__main__":
    main()
