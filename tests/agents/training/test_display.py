import sys

from wrongturn_agents.training.display import Display

ROW = {"minutes": 1.25, "step": 16384, "steps_per_second": 2048.4, "done": 0.5, "unit": "steps"}


def test_evaluations_are_told_at_once_and_rows_now_and_then(capsys, monkeypatch):
    monkeypatch.setattr("wrongturn_agents.training.display.time.monotonic", lambda: 100.0)
    with Display("ppo-image") as display:
        display.note("pretraining, 4,096 frames, loss 0.500")
        display.row(ROW)  # too soon after it
        display.row({**ROW, "reward_mean": 1234.5, "success_heldout": 0.96})
    assert capsys.readouterr().out.splitlines() == [
        "ppo-image: pretraining, 4,096 frames, loss 0.500",
        "ppo-image: 1.2 min, 16,384 steps, 2,048/s, reward of an episode 1,234, held-out journeys 96%",
    ]


def test_a_terminal_has_a_bar(capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    with Display("ppo-image") as display:
        display.row({**ROW, "success_heldout": 0.5})
        assert display._bar.tasks[0].completed == 0.5
    assert "held-out journeys 50%" in capsys.readouterr().out
