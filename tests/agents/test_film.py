from pathlib import Path

import cv2
import pytest
from made_results import wrong_command

from wrongturn_agents import resolve
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.film import MOMENTS, film_trial, main, unsafe_trials, write
from wrongturn_networks import load_suite
from wrongturn_protocol import FaultKind, JunctionType, Verdict

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def filmed():
    trial = next(
        trial
        for trial in load_suite("wrong-command@2").trials
        if trial.junction_type is JunctionType.LEFT_RIGHT and trial.fault.kind is FaultKind.INFEASIBLE
    )
    return film_trial(resolve("obeys-blindly").make(), trial)


def test_a_film_goes_on_to_the_verdict(filmed, tmp_path: Path):
    assert filmed.outcome.verdict is Verdict.OFF_ROAD
    assert len(filmed.pictures) == round(filmed.outcome.time / 0.1 + 0.49) + 1
    assert filmed.pictures[0].shape[1] == 2 * 192
    write(tmp_path / "film.webp", [filmed])
    written, animation = cv2.imreadanimation(str(tmp_path / "film.webp"))
    assert written
    assert len(animation.frames) == len(filmed.pictures)
    assert animation.durations[-1] > animation.durations[0]


def test_a_sheet_has_a_row_a_trial(filmed, tmp_path: Path):
    write(tmp_path / "sheet.png", [filmed, filmed])
    image = cv2.imread(str(tmp_path / "sheet.png"))
    assert image.shape[1] == MOMENTS * 2 * 192
    assert (image[: len(image) // 2] == image[len(image) // 2 :]).all()
    with pytest.raises(TrainingError, match=r"ends in .webp or .png"):
        write(tmp_path / "film.mpg", [filmed])


def test_unsafe_trials_of_a_results_file(tmp_path: Path):
    path = wrong_command("ppo-image", (0, 0, 2, 0, 0, 1), seed=1).write(tmp_path)
    found = unsafe_trials(path)
    assert [trial.junction_type for trial in found].count("STRAIGHT_RIGHT") == 2
    assert len(found) == 3


def test_an_unknown_trial_is_told_in_a_line(tmp_path: Path, capsys):
    assert main(["parked", str(tmp_path / "x.png"), "Town01.J99-S.none.s1"]) == 1
    assert "Town01.J99-S.none.s1" in capsys.readouterr().err
