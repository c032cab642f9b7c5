import pytest

from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.progress import COLUMNS, Display, ProgressFile, read_rows

ROW = {"minutes": 1.25, "step": 16384, "steps_per_second": 2048.4, "done": 0.5, "unit": "steps"}


def test_rows_of_an_interrupted_run_are_kept_up_to_its_checkpoint(tmp_path):
    path = tmp_path / "progress.csv"
    rows = ProgressFile(path)
    for step in (10, 20, 30):
        rows.add({"step": step, "reward_mean": step / 7})
    again = ProgressFile(path, resumed_at=20)
    again.add({"step": 31, "something_else": 1})
    found = read_rows(path)
    assert [row["step"] for row in found] == ["10", "20", "31"]
    assert found[0]["reward_mean"] == "1.42857"
    assert found[2]["reward_mean"] == ""
    assert tuple(found[0]) == COLUMNS


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"step,minutes\nnine,1\n", b"minutes\n1\n", b"step\n\x00\n"])
def test_a_damaged_file_is_named_and_kept(tmp_path, content):
    path = tmp_path / "progress.csv"
    path.write_bytes(content)
    with pytest.raises(TrainingError, match=r"progress\.csv: is damaged; move it away"):
        ProgressFile(path, resumed_at=20)
    assert path.read_bytes() == content


def test_a_folder_in_the_place_of_the_file_is_named(tmp_path):
    with pytest.raises(TrainingError, match=r"cannot be written .*; move it away"):
        ProgressFile(tmp_path, resumed_at=20)


def test_evaluations_are_told_at_once_and_rows_now_and_then(capsys, monkeypatch):
    monkeypatch.setattr("wrongturn_agents.training.progress.time.monotonic", lambda: 100.0)
    with Display("ppo-image") as display:
        display.note("pretraining, 4,096 frames, loss 0.500")
        display.row(ROW)  # too soon after it
        display.row({**ROW, "reward_mean": 1234.5, "success_heldout": 0.96})
    assert capsys.readouterr().out.splitlines() == [
        "ppo-image: pretraining, 4,096 frames, loss 0.500",
        "ppo-image: 50%, 1.2 min, 16,384 steps, 2,048/s, reward of an episode 1,234, held-out journeys 96%",
    ]
