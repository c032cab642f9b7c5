"""Figures for a paper, against figures counted by hand."""

import dataclasses
import re
from pathlib import Path

import pytest
from driven_runs import OFF_ROAD, driven_run, leaves_the_road
from made_results import wrong_command
from shapely import Point

import wrongturn_figures as figures
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.records import evaluation_record
from wrongturn_client import LocalService
from wrongturn_figures.junction_maps import installed_town
from wrongturn_networks import load_town
from wrongturn_protocol import Flag, Verdict
from wrongturn_protocol.junction_frame import rings


@pytest.fixture(scope="module")
def run() -> figures.EvaluationRecord:
    """Of six trials the three with a wrong command left the road; all twins took their exits."""
    return evaluation_record.of_run(driven_run(leaves_the_road))


def test_trajectories_are_drawn_over_their_type_and_fault(run):
    figure = figures.trajectories(run)
    panels = {
        (axes.get_subplotspec().rowspan.start, axes.get_subplotspec().colspan.start): axes for axes in figure.axes
    }
    titles = [panels[0, column].get_title() for column in range(3)]
    assert titles == ["straight or left", "straight or right", "left or right"]
    assert [panels[row, 0].get_ylabel() for row in range(2)] == ["infeasible", "omission"]
    labels = {(row, axes.get_xlabel()) for (row, _), axes in panels.items()}
    assert labels == {(0, "1 of 1 unsafe"), (1, "0 of 1 unsafe")}
    (drawn,) = [line for line in panels[0, 1].lines if len(line.get_xdata()) > 2]
    assert drawn.get_xdata() == pytest.approx([0.0] * 27, abs=1e-6)
    assert drawn.get_ydata() == pytest.approx([step - 20.0 for step in range(27)], abs=1e-6)
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["exit", "off road"]
    # Dash and marker tell them apart without colour.
    looks = {(line.get_linestyle(), line.get_marker()) for line in legend.get_lines()}
    assert len(looks) == len({dash for dash, _ in looks}) == len({marker for _, marker in looks}) == 2


@pytest.mark.soak
def test_a_cross_lies_where_the_road_was_left():
    run = evaluation_record.of_run(driven_run(leaves_the_road, suite="wrong-command@3"))
    drives = {}
    for name, drive in run.by_trial.items():
        road, (first, second) = load_town(drive.trial.town).road, drive.path[-2:]
        step = [(b - a) / 100 for a, b in zip(first, second, strict=True)]  # a centimetre
        path = [second]
        while road.contains(Point(path[-1])):
            path.append((path[-1][0] + step[0], path[-1][1] + step[1]))
        drives[name] = dataclasses.replace(drive, path=(*drive.path, *path[1:]))
    axes = figures.trajectories(dataclasses.replace(run, by_trial=drives)).axes[2]
    assert axes.get_title() == "left or right"
    crosses = [line.get_ydata()[0] for line in axes.lines if line.get_marker() == "X"]
    assert len(crosses) == 10
    assert max(crosses) - min(crosses) < 0.05
    lines = {round(line.get_ydata()[0], 1) for line in axes.lines if len(line.get_xdata()) == 2}
    assert len(lines) > 1  # the junctions differ in size


def test_every_verdict_has_a_look_of_its_own():
    from wrongturn_agents.results_file import TrialResult
    from wrongturn_figures.look import MARKS, mark_of

    assert len({(mark.dash, mark.marker) for mark in MARKS}) == len(MARKS)
    found = {mark_of(TrialResult(verdict=verdict)).name for verdict in Verdict}
    opposed = mark_of(TrialResult(verdict=Verdict.EXIT_ROUTE, flags=(Flag.OPPOSED_LANE,)))
    assert found | {opposed.name} == {mark.name for mark in MARKS}
    assert opposed.name not in found


def test_pairs_are_drawn_over_one_another(run):
    figure = figures.beside_twins(run)
    assert len(figure.axes) == 3
    for axes in figure.axes:
        assert len([line for line in axes.lines if len(line.get_xdata()) > 2]) == 2
    assert figure.axes[0].get_title() == "straight or left\ninfeasible"
    trial = run.trials[0].trial
    (one,) = figures.beside_twins(run, [trial.id]).axes
    assert one.get_xlabel() == trial.approach
    with pytest.raises(ResultsError, match="trials: no-such: is no trial of this run"):
        figures.beside_twins(run, ["no-such"])


def test_rates_and_their_intervals(run):
    safe = evaluation_record.of_run(driven_run(lambda _: {}, agent="safe"))
    (axes,) = figures.unsafe_rates([run, safe]).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["by hand", "safe"]
    assert [text.get_text() for text in axes.texts] == ["3/6", "0/6"]
    strict = axes.containers[0]
    assert list(strict.lines[0].get_xdata()) == [50.0]
    ((left, _), (right, _)) = strict.lines[2][0].get_segments()[0]
    # Wilson's 95 % interval of 3 of 6.
    assert (left, right) == (pytest.approx(18.76, abs=0.01), pytest.approx(81.24, abs=0.01))


def test_the_plane_of_obedience_and_safety():
    figures_of = {
        "follows": {"unsafe": (10, 5, 0, 0, 0, 0)},
        "stands": {"unsafe": (0,) * 6, "twins_failed": 60},
        "doubting": {"unsafe": (0,) * 6},
        "careful": {"unsafe": (0,) * 6},
    }
    runs = [evaluation_record.of_results(wrong_command(name, **found)) for name, found in figures_of.items()]
    (axes,) = figures.obedience_safety(runs).axes
    marks = [tuple(float(one.get_data()[axis][0]) for axis in (0, 1)) for one in axes.lines if one.get_marker() == "o"]
    # Completed twins and unsafe trials, percent.
    assert sorted(marks) == [(0.0, 0.0), (100.0, 0.0), (100.0, 25.0)]
    assert {text.get_text() for text in axes.texts} == {"follows", "stands", "doubting †\ncareful"}
    assert axes.get_xlabel().endswith("† met wrong commands in its training")
    boxes = [text.get_position() for text in axes.texts]
    assert len(set(boxes)) == len(boxes)
    (plain,) = figures.obedience_safety(runs[:1]).axes
    assert plain.get_xlabel() == "twins completed, %"


def test_an_agent_that_met_wrong_commands_is_marked():
    doubting = evaluation_record.of_results(wrong_command("doubting", (0,) * 6))
    assert (doubting.label, doubting.named("ours").label) == ("doubting †", "ours †")
    assert "doubting\\,\\dag & infeasible" in figures.latex_table([doubting])
    (axes,) = figures.unsafe_rates([doubting]).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["doubting †"]


def test_pairs_are_counted(run):
    assert figures.pair_counts(run) == (3, 0, 0, 3)
    twins_fail = evaluation_record.of_run(
        driven_run(lambda trial: OFF_ROAD if trial.is_twin else {}, agent="worse twins")
    )
    assert figures.pair_counts(twins_fail) == (0, 6, 0, 0)
    (axes,) = figures.pairs([run, twins_fail]).axes
    said = [text.get_text() for text in axes.texts]
    assert "+50, p = 0.25" in said
    assert "-100, p = 0.031" in said


@pytest.mark.parametrize("kind", ["pdf", "svg", "png"])
def test_a_figure_has_the_same_bytes_each_time(run, tmp_path: Path, kind):
    files = [figures.save(figures.pairs([run]), tmp_path / f"{number}.{kind}").read_bytes() for number in range(2)]
    assert files[0] == files[1]
    if kind == "pdf":
        assert b"/FontFile2" in files[0]  # TrueType, embedded
        assert b"/Type3" not in files[0]


@pytest.mark.parametrize(
    ("name", "says"),
    [("rates.jpeg", r"ends in \.jpeg; choose one of \.pdf"), ("no/such/rates.pdf", "cannot be written")],
)
def test_a_file_that_cannot_be_a_figure(run, tmp_path: Path, name, says):
    with pytest.raises(ResultsError, match=says):
        figures.save(figures.unsafe_rates([run]), tmp_path / name)


def test_a_service_of_another_town_is_told(run):
    town = installed_town("Town01")
    with pytest.raises(ResultsError, match=r"Town01: has no approach J\d+-.; the town is another version"):
        figures.trajectories(run, towns=lambda _: town.model_copy(update={"approaches": ()}))


def test_a_service_has_the_same_towns(service: LocalService):
    here, there = figures.installed_town("Town01"), figures.town_of(service.url)("Town01")
    roads = ([[ring.tolist() for ring in polygon] for polygon in rings(town.road)] for town in (here, there))
    assert next(roads) == next(roads)
    ways = ([(one.id, one.stop_line, one.heading) for one in town.approaches] for town in (here, there))
    assert next(ways) == next(ways)


def test_the_pages_example_runs(tmp_path: Path, monkeypatch, capsys):
    page = Path(__file__).parents[3] / "docs" / "figures.md"
    (example,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(example, {})
    assert (tmp_path / "rates.pdf").read_bytes().startswith(b"%PDF")
    assert "PPO, image & infeasible &" in capsys.readouterr().out
