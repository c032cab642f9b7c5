"""What if: bytes before a fork are the stored ones, and a sweep finds what a scripted agent is known to do."""

import json
import random
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from wrongturn_agents.batch.group import loaded
from wrongturn_agents.batch.whatif import WhatIf, actions_of
from wrongturn_agents.errors import RunError
from wrongturn_agents.whatif_file import SweepResult
from wrongturn_client import Client
from wrongturn_client.cli import app
from wrongturn_judge import Trajectory
from wrongturn_networks import draw_trial, load_town
from wrongturn_protocol import Command, Trial
from wrongturn_protocol.observations import observation_space
from wrongturn_protocol.run_file import RunFile
from wrongturn_sim.episode import Episode

AGENTS = """
import random
import numpy as np
from wrongturn_agents.baselines import ObeysBlindly

class Latch(ObeysBlindly):
    'Decides so far before the stop line, once and for good.'
    name, memoryless, metres = "latch", False, 8.0

    def reset(self, space):
        super().reset(space)
        self.decided = 4

    def act(self, seen):
        decides = self.decided == 4 and 0 <= seen["stop_line"][0] <= self.metres
        if decides:
            self.decided = int(seen["command"][0])
        action = super().act({**seen, "command": np.array([self.decided])})
        return (action.steer, 0.0, 0.01 * abs(self.decided)) if decides else action  # the moment shows in the action

class Early(Latch):
    metres = 11.0

class Late(Latch):
    metres = 5.0

class Random(ObeysBlindly):
    def act(self, seen):
        action = super().act(seen)
        return random.random() / 100, action.throttle, action.brake
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("latch")
    (folder / "scripted_forks.py").write_text(AGENTS)
    return str(folder)


def driven(agent: str, folder: str, trial: Trial) -> Trajectory:
    """A drive as it is stored."""
    policy, track = loaded(agent, folder)
    episode = Episode(trial, track)
    seen = episode.reset()
    policy.reset(observation_space(track))
    while episode.outcome is None:
        action = policy.act(seen)
        seen = episode.step(action.steer, action.throttle, action.brake).observation
    return Trajectory.from_json(episode.trajectory.to_json())


def trial_of(fault: str = "infeasible", seed: int = 3, approach: str = "J3-S") -> Trial:
    return draw_trial(load_town("Town01"), approach, fault, seed)


def check_fork(stored: Trajectory, whatif: WhatIf, decision: int, command: Command | None) -> Episode:
    fork = whatif.fork(decision, command)
    before = 2 * decision + (decision > 0)
    assert fork.trajectory.rows[:before] == stored.rows[:before]
    told = {row.command if command is None else command for row in fork.trajectory.rows[before:]}
    wanted = {row.route_command if command is None else command for row in fork.trajectory.rows[before:]}
    assert told == wanted
    return fork


@pytest.mark.parametrize("episodes", [3, pytest.param(100, marks=pytest.mark.soak)])
def test_bytes_before_a_fork_are_the_stored_ones(folder: str, episodes: int) -> None:
    for seed in range(episodes):
        agent = ("careful", "obeys-blindly", "scripted_forks:Latch")[seed % 3]
        approach = ("J3-S", "J1-N", "J9-W")[seed // 3 % 3]
        stored = driven(agent, folder, trial_of(("infeasible", "omission")[seed % 2], seed, approach))
        whatif = WhatIf(stored, *loaded(agent, folder))
        random.seed(seed)
        last = len(whatif.actions) - 1
        for decision in (0, 1, random.randrange(last), last):
            for command in (None, Command.LEFT, random.choice(list(Command))):
                check_fork(stored, whatif, decision, command)
        assert whatif.differs is None


def test_the_command_that_was_delivered_gives_the_episode_itself(folder: str) -> None:
    """But for what its trial says."""
    twin = driven("careful", folder, trial_of("none"))
    fork = WhatIf(twin, *loaded("careful", folder)).fork(5, None).trajectory
    fork.trial = twin.trial
    assert fork.to_json() == twin.to_json()


@pytest.mark.parametrize(("agent", "metres"), [("Early", 11.0), ("Latch", 8.0), ("Late", 5.0)])
@pytest.mark.parametrize("every", [0.1, 0.5])
def test_the_point_of_no_return_is_where_the_agent_decides(
    folder: str, agent: str, metres: float, every: float
) -> None:
    trial = trial_of()
    assert trial.route == Command.STRAIGHT
    stored = driven(f"scripted_forks:{agent}", folder, trial)
    lane = trial.start.distance
    gone = np.hypot(*(np.array([row[1:3] for row in stored.rows[::2]]) - stored.rows[0][1:3]).T)
    decides = int(np.argmax(gone >= lane - metres))
    found = WhatIf(stored, *loaded(f"scripted_forks:{agent}", folder)).sweep(every)
    assert found.verdict == "off_road"
    assert found.right == "exit_commanded"
    assert found.no_return_s == pytest.approx(decides / 10, abs=0.11)
    assert found.detection_s == pytest.approx(decides / 10, abs=0.11)
    assert found.wrong_s <= found.no_return_s
    assert found.differs is None


def test_what_cannot_be_forked_says_why(folder: str) -> None:
    stored = driven("obeys-blindly", folder, trial_of())
    whatif = WhatIf(stored, *loaded("obeys-blindly", folder))
    with pytest.raises(RunError, match="--at: is outside the drive, whose last decision is at"):
        whatif.forked(60.0, None)
    with pytest.raises(RunError, match="is a fork itself"):
        WhatIf(whatif.fork(3, None).trajectory, *loaded("obeys-blindly", folder))
    stored.rows[9] = stored.rows[9]._replace(x=0.0)
    with pytest.raises(RunError, match=r"cannot be repeated here: it differs from 0\.45 s on"):
        WhatIf(stored, *loaded("obeys-blindly", folder))


def test_an_agent_that_is_not_deterministic_is_told_so(folder: str) -> None:
    stored = driven("scripted_forks:Random", folder, trial_of())
    whatif = WhatIf(stored, *loaded("scripted_forks:Random", folder))
    result = whatif.forked(1.0, Command.LEFT)
    assert result.differs is not None
    assert (result.differs.at, result.differs.stored) == (0.0, whatif.actions[0])
    assert "not deterministic, or not the one that drove: at 0.0 s it gives steer" in str(result.differs)
    assert actions_of(whatif.fork(10, None).trajectory)[:10] == whatif.actions[:10]


@pytest.fixture(scope="module")
def run_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a run over a service."""
    file = tmp_path_factory.mktemp("run") / "run.json.gz"
    done = CliRunner().invoke(app, ["run", "obeys-blindly", "--suite", "smoke@3", "--json", str(file)])
    assert done.exit_code == 0, done.output
    return file


def test_the_command(run_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def whatif(*words: str, code: int = 0, source: str = str(run_file)) -> str:
        done = CliRunner().invoke(app, ["whatif", source, *words])
        assert done.exit_code == code, done.output
        return done.output + str(done.exception or "")

    file = tmp_path / "sweep.json"
    whatif("--sweep", "--all", "--workers", "2", "--json", str(file))
    whole = file.read_bytes()
    swept = {name: SweepResult.model_validate(one) for name, one in json.loads(whole)["trials"].items()}
    assert swept
    assert all(one.verdict.unsafe_strict and one.no_return_s is not None for one in swept.values())
    # An interrupted sweep goes on with what it has, and comes to the same.
    half = json.loads(whole)
    trial, _ = half["trials"].popitem()
    file.write_text(json.dumps(half))
    assert trial in whatif("--sweep", "--all", "--json", str(file))
    assert json.loads(file.read_bytes()) == json.loads(whole)
    # A finished evaluation of a service is swept like its file.
    asked = []
    monkeypatch.setattr(Client, "run_file", lambda _, named: asked.append(named) or RunFile.read(run_file))
    file.write_text(json.dumps(half))
    whatif("--sweep", "--all", "--json", str(file), source="ev_1a2b")
    assert (asked, json.loads(file.read_bytes())) == (["ev_1a2b"], json.loads(whole))
    assert "is of another run" in whatif("--sweep", "--all", "--every", "1", "--json", str(file), code=1)

    last = swept[trial].no_return_s
    assert last is not None
    found = json.loads(whatif("--episode", trial, "--command", "ROUTE", "--at", f"{last:.1f}", "--json", "-"))
    assert found["outcome"]["verdict"].startswith("exit")
    assert found["was"] == swept[trial].verdict
    said = whatif("--episode", trial, "--command", "ROUTE", "--at", f"{last + 0.1:.1f}")
    assert f"ROUTE from {last + 0.1:.1f} s on: off road" in said or "collision" in said
    for words, why in (
        (["--command", "LEFT"], "--command, --at: give both"),
        (["--sweep", "--at", "1"], "--sweep: give it alone"),
        (["--all", "--command", "LEFT", "--at", "1"], "--all: needs --sweep"),
        (["--sweep", "--post"], "--post: an EPISODE of a service"),
        (["--sweep"], "--episode: "),
    ):
        assert why in whatif(*words, code=1), words
