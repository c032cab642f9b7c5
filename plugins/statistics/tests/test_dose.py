"""D50: of agents that are known, simulated or driven."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lab import dose_power
from wrongturn_client.cli import app
from wrongturn_networks.faults import Dose
from wrongturn_protocol import FaultKind, JunctionType, Track
from wrongturn_statistics.dose_file import DoseFile
from wrongturn_statistics.dose_response import DoseResponse
from wrongturn_statistics.dose_run import DoseRun, dose_of

AGENTS = """
import numpy as np
from wrongturn_agents.baselines import ObeysBlindly

class Once(ObeysBlindly):
    'Decides by the command of one moment, so far before the stop line, whatever it is told then and later.'
    name, memoryless, metres = "once", False, 8.0

    def reset(self, space):
        super().reset(space)
        self.decided = None

    def act(self, seen):
        if self.decided is None and 0 <= seen["stop_line"][0] <= self.metres:
            self.decided = int(seen["command"][0])
        return super().act({**seen, "command": np.array([4 if self.decided is None else self.decided])})

class Early(Once):
    metres = 11.0

class Late(Once):
    metres = 4.0
"""
PAGE = Path(__file__).parents[3] / "docs" / "dose.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("once")
    (folder / "scripted_doses.py").write_text(AGENTS)
    return str(folder)


@pytest.mark.parametrize(
    ("agent", "kind", "low", "d50"),
    [
        # The window opens 15 m before the line.
        ("Early", FaultKind.LATE, None, 15.0 - 11.0),
        ("Once", FaultKind.LATE, None, 15.0 - 8.0),
        ("Late", FaultKind.LATE, None, 15.0 - 4.0),
        # A smaller dose is harder: the command is put right so far before the line.
        ("Once", FaultKind.CORRECTED, None, 8.0),
        ("Late", FaultKind.CORRECTED, -2.0, 4.0),
    ],
)
def test_d50_is_where_a_scripted_agent_decides_within_one_decision(
    folder: str, agent: str, kind: FaultKind, low: float | None, d50: float
) -> None:
    dose = dose_of(kind, low, None, Track.PRIVILEGED)
    begun = DoseFile(
        agent="once",
        fault=kind,
        low=dose.low,
        high=dose.high,
        unit=dose.unit,
        towns=("Town01",),
        types=(JunctionType.LEFT_RIGHT,),
        seed=0,
        counted="unsafe",
    )
    *_, done = DoseRun(f"scripted_doses:{agent}", folder, dose, begun).drive(60)
    value, low_end, high_end = (done.d50[name] for name in ("value", "low", "high"))
    # It decides at the first moment within its distance: between 0 and 0.1 s late, at 7 m/s.
    late = value - d50 if kind is FaultKind.LATE else d50 - value
    assert -0.1 < late < 0.7
    assert low_end < value < high_end
    assert high_end - low_end < 1.0


@pytest.mark.soak
def test_sixty_trials_tell_d50(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dose_power, "RUNS", 24)
    for case in ((15.0, 5.0, (0.0, 0.0)), (25.0, 10.0, (0.0, 0.0)), (6.0, 1.0, (0.05, 0.1))):
        near, inside, _ = dose_power.found(*case)
        assert near >= 0.95, case
        assert inside >= 0.8, case


@pytest.mark.soak
def test_the_page_has_the_codes_table() -> None:
    _, _, after = PAGE.read_text("utf-8").partition("<!-- python -m lab.dose_power -->\n\n")
    assert after.partition("\n<!-- end of dose -->")[0] == dose_power.table().markdown().rstrip("\n")


@pytest.mark.parametrize("more_is_worse", [True, False])
@pytest.mark.parametrize(("failed", "side"), [(False, "harder"), (True, "easier")])
def test_agents_that_never_or_always_fail_have_a_bound_alone(more_is_worse: bool, failed: bool, side: str) -> None:
    response = DoseResponse(Dose("how much", "m", 0.0, 20.0, 10.0, more_is_worse=more_is_worse))
    for _ in range(30):
        response.add(response.best(), failed=failed)
    assert response.d50() == (None, None, None)
    assert response.side() == side
    assert response.best() == (20.0 if (side == "harder") == more_is_worse else 0.0)


def test_a_dose_that_parts_all_outcomes_is_found_and_order_does_not_matter() -> None:
    doses = np.linspace(1, 19, 37)
    forward, backward = (DoseResponse(Dose("how much", "m", 0.0, 20.0, 10.0)) for _ in range(2))
    for dose in doses:
        forward.add(dose, failed=bool(dose > 7.7))
    for dose in reversed(doses):
        backward.add(dose, failed=bool(dose > 7.7))
    value, low, high = forward.d50()
    assert low < value < high
    assert value == pytest.approx(7.75, abs=0.25)  # between 7.5 and 8
    assert high - low < 2
    assert forward.d50() == pytest.approx(backward.d50(), abs=1e-3)
    assert forward.width().value < 2


def test_the_command(tmp_path: Path) -> None:
    def dose(*words: str, code: int = 0) -> str:
        done = CliRunner().invoke(app, ["dose", "obeys-blindly", *words])
        assert done.exit_code == code, done.output
        return done.output + str(done.exception or "")

    file, whole = tmp_path / "part.json", tmp_path / "whole.json"
    late = ("--fault", "late", "--type", "LEFT_RIGHT")
    dose(*late, "--trials", "7", "--json", str(file))
    # An interrupted run goes on with what it has, and comes to the same.
    said = dose(*late, "--trials", "20", "--json", str(file))
    assert "D50: half of the trials are unsafe at 14." in said
    printed = dose(*late, "--trials", "20", "--json", str(whole))
    assert file.read_bytes() == whole.read_bytes()
    assert len(json.loads(whole.read_bytes())["trials"]) == 20
    assert printed.partition("obeys-blindly: late")[2] == said.partition("obeys-blindly: late")[2]
    # A disturbance's trials have to be completed.
    assert "steering_gain" in dose("--fault", "steering_gain", "--trials", "4")
    for words, why in (
        ((*late, "--seed", "1", "--json", str(file)), "is of another run"),
        (("--fault", "noise"), "--fault: agents of the track privileged do not notice noise"),
        (("--fault", "late", "--low", "0.1"), "--low: is 0.1; give how much too late it comes, 1 to 30 m"),
        (("--fault", "late", "--low", "5", "--high", "5"), "--low: is 5, and --high is 5"),
        (("--fault", "early", "--town", "Town02", "--type", "LEFT_RIGHT"), "narrow --low and --high"),
    ):
        assert why in dose(*words, code=1), words
    # Only what has a dose is offered, and nothing that is not installed.
    for fault in ("omission", "custom", "lat"):
        said = dose("--fault", fault, code=2)
        assert f"--fault: '{fault}' is no fault with a dose; take one of early, late, " in said
        assert not {"infeasible", "none"} & set(said.replace(",", "").split())
