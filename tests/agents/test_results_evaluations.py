"""``wrongturn results --evaluations``: several evaluations of an agent, and their table."""

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from made_results import wrong_command

import wrongturn_sim  # noqa: F401 - sets where compiled kernels are kept, before the home is another
from wrongturn_agents import evaluation_run
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.registry import resolve
from wrongturn_agents.reporting.collection import STORED, Collection
from wrongturn_agents.reporting.evaluations import (
    Evaluation,
    evaluations_folder,
    evaluations_table,
    read_evaluations,
)
from wrongturn_agents.reporting.making_evaluations import code_of, keep, make_evaluations
from wrongturn_protocol import Reaction

SMOKE = "smoke@2"


def evaluation(agent: str, unsafe: tuple[int, ...], number: int, *, twins_failed: int = 0) -> Evaluation:
    """Return an evaluation on a draw of its own; every wrong command was overridden."""
    secret = f"secret {number}"
    file = wrong_command(agent, unsafe, twins_failed=twins_failed, driven="over the service", secret=secret)
    trials = {
        name: one.model_copy(update={"reaction": Reaction.OVERRODE}) if ".infeasible." in name else one
        for name, one in file.trials.items()
    }
    fields = {**dict(file), "trials": trials}
    return Evaluation(**fields, number=number, evaluation=f"ev_{number}", code={"model.onnx": "0" * 64})


def test_each_evaluation_has_a_row_and_all_have_one(tmp_path: Path) -> None:
    for number, unsafe in ((2, (0, 3, 0, 0, 0, 0)), (1, (0,) * 6)):
        keep(evaluation("doubting", unsafe, number, twins_failed=number - 1), tmp_path)
    table = evaluations_table(read_evaluations(tmp_path))
    assert [row[:2] for row in table.rows] == [("`doubting` †", "`secret 1`"), ("", "`secret 2`"), ("", "all 2")]
    assert [row[4:] for row in table.rows[:2]] == [
        ("0 of 60", "0 of 60", "60 of 60"),
        ("3 of 60", "3 of 60", "59 of 60"),
    ]
    # Wilson's intervals of 3 of 120 and of 119 of 120.
    assert table.rows[2][4:] == ("3 of 120 (0.9–7.1 %)", "3 of 120 (0.9–7.1 %)", "119 of 120 (95.4–99.9 %)")
    assert table.rows[2][2:4] == ("overrode 60", "")


def test_the_first_evaluation_is_the_agents_row(tmp_path: Path) -> None:
    keep(evaluation("doubting", (1, 0, 0, 0, 0, 0), 1), tmp_path)
    keep(evaluation("doubting", (0,) * 6, 2), tmp_path)
    file = Collection.read(tmp_path).of_shipped("wrong-command@2", "doubting")
    assert file is not None
    assert (file.secret, file.driven) == ("secret 1", "over the service")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"secret": "another"}, "commitment"),
        ({"number": 0}, "number"),
        ({"code": None}, "code: .*--evaluations"),
        ({"trials": {}}, "lacks 120"),
    ],
)
def test_an_evaluation_that_was_changed_is_found(tmp_path: Path, change: dict[str, Any], says: str) -> None:
    keep(evaluation("doubting", (0,) * 6, 1), tmp_path)
    (path,) = evaluations_folder(tmp_path).iterdir()
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(ResultsError, match=says):
        read_evaluations(tmp_path)


def test_the_agents_have_to_be_named(tmp_path: Path) -> None:
    with pytest.raises(ResultsError, match="--agent doubting"):
        make_evaluations(tmp_path, [], 1)


@pytest.mark.parametrize("stored", read_evaluations(STORED), ids=lambda one: one.stem)
def test_stored_evaluations_are_of_the_files_that_are_shipped(stored: Evaluation) -> None:
    assert stored.code == code_of(resolve(stored.agent)), (
        f"{stored.agent} changed since it was evaluated: drive it again with "
        f"wrongturn results --evaluations 10 --agent {stored.agent}, and read docs/doubting.md anew"
    )


@pytest.mark.soak  # runs go on in CI in test_worker.py and test_practice_run.py
@pytest.mark.slow
def test_an_evaluation_goes_on_where_it_stopped_and_is_not_driven_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "home"))
    shown = evaluation_run.show_progress
    driven: list[int] = []

    @contextlib.contextmanager
    def interrupted(style: Any, name: str) -> Iterator[Any]:
        with shown(style, name) as update:

            def progress(finished: int, total: int) -> None:
                update(finished, total)
                driven.append(finished)
                if len(driven) == 4:
                    raise KeyboardInterrupt

            yield progress

    monkeypatch.setattr(evaluation_run, "show_progress", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make_evaluations(tmp_path, ["always-stops"], 1, SMOKE)
    (saved,) = (tmp_path / "home" / "runs").glob("*.json")
    assert read_evaluations(tmp_path) == ()
    make_evaluations(tmp_path, ["always-stops"], 1, SMOKE)
    (stored,) = read_evaluations(tmp_path)
    assert (stored.evaluation, stored.agent, stored.number) == (saved.stem, "always-stops", 1)
    assert driven[-1] == 12
    count = len(driven)
    make_evaluations(tmp_path, ["always-stops"], 1, SMOKE)
    assert len(driven) == count
    # Another agent's evaluation does not stay.
    path = evaluations_folder(tmp_path) / f"{stored.stem}.json"
    stored.model_copy(update={"code": {"always_stops.py": "0" * 64}}).write(path.parent)
    monkeypatch.setattr("wrongturn_agents.reporting.making_evaluations.evaluate", lambda _: pytest.fail("driven anew"))
    with pytest.raises(pytest.fail.Exception, match="driven anew"):
        make_evaluations(tmp_path, ["always-stops"], 1, SMOKE)
    assert not path.exists()
