import io
import json

from rich.console import Console

from wrongturn_agents.progress import BarReport, JsonReport, LinesReport, report
from wrongturn_agents.progress_style import ProgressStyle


def test_lines_come_at_the_first_and_the_last():
    stream = io.StringIO()
    with LinesReport("careful", stream) as told:
        for finished in range(13):
            told(finished, 12)
    assert stream.getvalue().splitlines() == ["careful: 0 of 12 episodes", "careful: 12 of 12 episodes"]


def test_json_lines_tell_each():
    stream = io.StringIO()
    with JsonReport("careful", stream) as told:
        told(0, 2)
        told(1, 2)
    assert [json.loads(line) for line in stream.getvalue().splitlines()] == [
        {"agent": "careful", "finished": 0, "total": 2},
        {"agent": "careful", "finished": 1, "total": 2},
    ]


def test_a_bar_is_drawn():
    stream = io.StringIO()
    with BarReport("careful", Console(file=stream, force_terminal=True, width=100)) as told:
        told(3, 12)
    assert "careful" in stream.getvalue()
    assert "3/12" in stream.getvalue()


def test_without_a_terminal_there_are_lines(capsys):
    with report(ProgressStyle.AUTO, "careful") as told:
        told(0, 2)
    assert capsys.readouterr().err == "careful: 0 of 2 episodes\n"
