import io
import json

from rich.console import Console

from wrongturn_agents.progress import ProgressStyle, add_bar, lines_progress, progress_bars, show_progress


def test_lines_come_at_the_first_and_the_last_and_every_ten_seconds():
    stream, now = io.StringIO(), [0.0]
    update = lines_progress("careful", stream, lambda: now[0])
    for finished in range(13):
        now[0] = float(2 * finished)
        update(finished, 12)
    assert stream.getvalue().splitlines() == [
        "careful: 0 of 12 episodes",
        "careful: 5 of 12 episodes, 30 a minute",
        "careful: 10 of 12 episodes, 30 a minute",
        "careful: 12 of 12 episodes, 30 a minute",
    ]


def test_json_lines_show_each_episode(capsys):
    with show_progress(ProgressStyle.JSON, "careful") as update:
        update(0, 2)
        update(1, 2)
    assert [json.loads(line) for line in capsys.readouterr().err.splitlines()] == [
        {"agent": "careful", "finished": 0, "total": 2},
        {"agent": "careful", "finished": 1, "total": 2},
    ]
    with show_progress(ProgressStyle.AUTO, "careful") as update:
        update(0, 2)
    assert capsys.readouterr().err == "careful: 0 of 2 episodes\n", "no terminal"


def test_a_bar_is_drawn():
    stream = io.StringIO()
    with progress_bars(Console(file=stream, force_terminal=True, width=100)) as bars:
        add_bar(bars, "careful")(3, 12)
    assert "careful" in stream.getvalue()
    assert "3/12" in stream.getvalue()
