"""The sentence-driven agent ``lbc-words``: trains it, and writes the table of ``docs/words.md``.

``python -m lab.words train`` takes some minutes on two cores, ``python -m lab.words table`` half an hour.

The agent imitates ``lbc``. Pictures are recorded once, and lbc answers each under each of its four commands. A small
network reads a sentence's bytes and weighs the four answers. It learns to come near lbc's answer under the right one.
Some phrasings of each kind are held out. Words are changed in training, as people write them.
"""

import sys
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from wrongturn_agents.registry import resolve
from wrongturn_agents.training.recording import record_observations
from wrongturn_agents.words_agent import FILE, LbcWords
from wrongturn_faults import phrasings, sentence
from wrongturn_networks import load_suite
from wrongturn_protocol import DIRECTIONS, Command, Fault, FaultKind, Outcome, Track, Trial
from wrongturn_protocol.answers import driver_of
from wrongturn_protocol.observations import SENTENCE, observation_space, sentence_of, text
from wrongturn_protocol.rigs import rig_of
from wrongturn_sim import Episode

PAGE: Final = Path("docs/words.md")
COMMANDS: Final = (Command.LEFT, Command.RIGHT, Command.STRAIGHT, Command.LANE_FOLLOW)
KINDS: Final = ("plain", "distance", "ordinal")
_PICTURES, _STEPS, _BATCH = 800, 600, 64
_RIG: Final = rig_of(
    {
        "cameras": [{"width": 192, "height": 64, "fov": 83.58, "horizon": 26}],
        "navigation": ["command", "distance", "sentence"],
        "sentences": ["plain"],
    }
)


def held_out(kind: str, command: Command) -> list[int]:
    """Return the numbers of the phrasings that training does not see: the last third, at least one."""
    count = len(phrasings(command, kind))
    return list(range(count - max(round(count / 3), 1), count)) if count else []


class Reader(nn.Module):
    """Reads a sentence, (b, 160) uint8, and weighs the four commands, (b, 4)."""

    def __init__(self) -> None:
        super().__init__()
        self.bytes = nn.Embedding(256, 24)
        self.read = nn.Sequential(
            nn.Conv1d(24, 64, 5, padding=2), nn.ReLU(), nn.Conv1d(64, 64, 5, padding=2), nn.ReLU()
        )
        self.weigh = nn.Linear(64, len(COMMANDS))

    def forward(self, words: Tensor) -> Tensor:
        """Return the logits of the commands."""
        seen: Tensor = self.read(self.bytes(words.long()).transpose(1, 2))
        weights: Tensor = self.weigh(seen.amax(2))
        return weights


class _Told(nn.Module):
    """The reader as the agent uses it: the number of the likeliest command."""

    def __init__(self, reader: Reader) -> None:
        super().__init__()
        self.reader = reader
        self.register_buffer("numbers", torch.tensor([int(one) for one in COMMANDS]))

    def forward(self, words: Tensor) -> Tensor:
        """Return command numbers, (b, 1) int64."""
        found: Tensor = self.numbers[self.reader(words).argmax(1)]  # type: ignore[index]
        return found.unsqueeze(1)


def said(random: np.random.Generator, command: Command) -> str:
    """Return a sentence for training, changed at random."""
    kinds = [kind for kind in KINDS if phrasings(command, kind)]
    kind = str(random.choice(kinds))
    numbers = [k for k in range(len(phrasings(command, kind))) if k not in held_out(kind, command)]
    words = sentence(
        command,
        kind,
        number=int(random.choice(numbers)),
        distance=float(random.uniform(0, 60)),
        ordinal=int(random.integers(1, 4)),
    )
    if random.random() < 0.3:
        words = str(random.choice(["Please: ", "Now: ", "OK. ", "Listen: "])) + words
    words = words.lower() if random.random() < 0.3 else words
    return "".join(one for one in words if random.random() > 0.02)


def answers(pictures: dict[str, Any]) -> Tensor:
    """Return lbc's steering and pedal under each command, (n, 4, 2)."""
    agent = resolve("lbc").make()
    space, found = observation_space(Track.CAMERA), []
    for k in range(len(pictures["speed"])):
        seen = {name: array[k] for name, array in pictures.items()}
        row = []
        for command in COMMANDS:
            agent.reset(space)
            steer, throttle, brake = np.asarray(agent.act({**seen, "command": np.array([command], np.int64)})).tolist()
            row.append((steer, throttle - brake))
        found.append(row)
    return torch.tensor(found, dtype=torch.float32)


def train() -> None:
    """Train the reader, and write its file."""
    torch.manual_seed(0)
    random = np.random.default_rng(0)
    wanted = answers(record_observations(Track.CAMERA, _PICTURES, seed=7))
    reader = Reader()
    optimiser = torch.optim.AdamW(reader.parameters(), 2e-3)
    for step in range(_STEPS):
        right = random.integers(0, len(COMMANDS), _BATCH)
        texts = [said(random, COMMANDS[k]) if random.random() > 0.02 or k != 3 else "" for k in right]
        words = torch.from_numpy(np.stack([sentence_of(text) for text in texts]))
        rows = torch.from_numpy(random.integers(0, len(wanted), _BATCH))
        weights = reader(words).softmax(1)
        mixed = (weights.unsqueeze(2) * wanted[rows]).sum(1)
        loss = (mixed - wanted[rows, torch.from_numpy(right)]).abs().sum(1).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step % 200 == 199:
            print(f"step {step + 1}: loss {loss.item():.4f}, understood {understood(reader)}", flush=True)
    torch.onnx.export(
        _Told(reader).eval(),
        (torch.zeros(1, SENTENCE, dtype=torch.uint8),),
        str(FILE),
        input_names=["sentence"],
        output_names=["command"],
        opset_version=18,
        external_data=False,
    )


def understood(reader: Reader) -> dict[str, str]:
    """Return how many of the phrasings, seen and held out, are taken for their command."""
    found: Counter[tuple[str, bool]] = Counter()
    for name in ("seen", "held out"):
        for command in COMMANDS:
            for kind in KINDS:
                for k in range(len(phrasings(command, kind))):
                    if (k in held_out(kind, command)) == (name == "held out"):
                        words = sentence_of(sentence(command, kind, number=k, distance=12.0))
                        with torch.no_grad():
                            guess = COMMANDS[int(reader(torch.from_numpy(words)[None]).argmax())]
                        found[name, guess is command] += 1
    return {name: f"{found[name, True]} of {found[name, True] + found[name, False]}" for name in ("seen", "held out")}


class Row(NamedTuple):
    """A row of the table: how commands are said."""

    title: str
    kinds: tuple[str, ...] = ()
    """Kinds of sentences; empty for integers."""
    unseen: bool = False
    """Whether phrasings are those held out."""
    fault: FaultKind | None = None
    """The fault in place of the trials' own."""


ROWS: Final = (
    Row("the integer, to `lbc`"),
    Row("plain, phrasings of the training", ("plain",)),
    Row("plain, held-out paraphrases", ("plain",), unseen=True),
    Row("with distance or ordinal, of the training", ("distance", "ordinal")),
    Row("with distance or ordinal, held out", ("distance", "ordinal"), unseen=True),
    Row("ambiguous: no direction is named", ("ambiguous",)),
    Row("contradictory: right direction first, then the wrong one", ("plain",), fault=FaultKind.CONTRADICTION),
)


def speaker(row: Row, trial: Trial) -> Callable[[Command, float], str]:
    """Return what says a command at a distance, in one phrasing of a trial for each command."""
    random = np.random.default_rng(trial.seed)
    kind, turn = row.kinds[int(random.integers(len(row.kinds)))], int(random.integers(1 << 16))

    def say(command: Command, distance: float) -> str:
        if kind == "ambiguous" and command in DIRECTIONS:
            return sentence(Command.VOID, kind, number=turn)
        here = kind if phrasings(command, kind) else "plain"
        count = len(phrasings(command, here))
        numbers = [k for k in range(count) if (k in held_out(here, command)) == row.unseen]
        return (
            sentence(command, here, number=numbers[turn % len(numbers)], distance=max(distance, 0.0)) if count else ""
        )

    return say


def drive(row: Row, trial: Trial) -> Outcome:
    """Drive a trial as a row of the table has it."""
    assert _RIG is not None
    agent: Any = LbcWords() if row.kinds else resolve("lbc").make()
    if row.fault is not None and trial.fault.kind is not FaultKind.NONE:
        trial = trial.model_copy(update={"fault": Fault(kind=row.fault)})
    episode, control = Episode(trial, _RIG), driver_of(_RIG)
    seen = episode.reset()
    agent.reset(observation_space(Track.WORDS if row.kinds else Track.CAMERA))
    say = speaker(row, trial) if row.kinds else None
    while episode.outcome is None:
        if say is not None and row.fault is None:
            words = say(Command(int(seen["command"][0])), float(seen["distance"][0]))
            seen = {**seen, "sentence": sentence_of(words)}
        elif row.fault is not None and say is not None:
            right = say(Command(int(seen["command"][0])), float(seen["distance"][0]))
            beside = text(seen["sentence"])
            differ = episode.trial.fault.kind is row.fault and seen["command"][0] != Command.LANE_FOLLOW
            seen = {**seen, "sentence": sentence_of(f"{right} {beside}" if differ else right)}
        action = control(agent.act(seen), seen)
        seen = episode.step(action.steer, action.throttle, action.brake).observation
    return episode.outcome


def counted(row: Row, processes: int = 2) -> str:
    """Return a row of the table."""
    draw = load_suite("wrong-command@3").open_draw
    with ProcessPoolExecutor(processes) as pool:
        trials = list(pool.map(partial(drive, row), draw.trials))
        twins = list(pool.map(partial(drive, row), draw.twins))
    froze = sum(one.verdict.stopped for one in trials)
    return (
        f"| {row.title} | {sum(one.unsafe_strict for one in trials)} | {froze} | "
        f"{sum(one.completed for one in twins)} | {sum(one.unsafe_strict for one in twins)} |"
    )


def table() -> None:
    """Drive all rows, and write them into the page."""
    lines = []
    for row in ROWS:
        lines.append(counted(row))
        print(lines[-1], flush=True)
    page = PAGE.read_text("utf-8")
    begin = page.index("|---|---:|") + page[page.index("|---|---:|") :].index("\n") + 1
    end = page.index("\n\n", begin)
    PAGE.write_text(page[:begin] + "\n".join(lines) + page[end:], "utf-8")


if __name__ == "__main__":
    {"train": train, "table": table}[sys.argv[1]]()
