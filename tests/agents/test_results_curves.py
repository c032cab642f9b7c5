import json
import re
from dataclasses import replace

import pytest
from made_results import progress

from wrongturn_agents.errors import OutdatedPageError, ResultsError
from wrongturn_agents.reporting.curve_pictures import PICTURES, check_pictures, draw_pictures
from wrongturn_agents.reporting.curves import (
    POINTS,
    imitation_table,
    read_curves,
    read_progress,
    time_table,
    training_table,
)
from wrongturn_agents.reporting.importing import Overrides, import_results


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    progress(folder / "progress.csv", 2000)
    (folder / "config.json").write_text(json.dumps({"algorithm": "ppo-image", "seed": 3, "variant": None}))
    return folder


def test_a_run_is_kept_thinned_with_its_end_its_evaluations_and_its_time(tmp_path, run):
    kept = import_results(run, tmp_path, Overrides())
    assert kept == tmp_path / "curves" / "ppo-image.s3.csv"
    (curve,) = read_curves(tmp_path / "curves")
    assert (curve.agent, curve.seed, curve.variant) == ("ppo-image", 3, None)
    assert len(curve.columns["step"]) <= 3 * POINTS
    assert curve.last("step") == 2_000_000
    assert len(curve.points("success_heldout")[0]) == 200
    assert curve.seconds() == pytest.approx({"env": 500.0, "learn": 1000.0})
    assert "clip_fraction" not in curve.columns


def test_what_is_said_goes_before_what_the_run_says(tmp_path, run):
    kept = import_results(run, tmp_path, Overrides(seed=4, variant="without-augmentation"))
    assert kept.name == "ppo-image.without-augmentation.s4.csv"
    (run / "config.json").unlink()
    with pytest.raises(ResultsError, match="give --agent and --seed"):
        import_results(run, tmp_path, Overrides())


def test_tables_of_runs(tmp_path, run):
    import_results(run, tmp_path, Overrides())
    curves = read_curves(tmp_path / "curves")
    (row,) = training_table(curves).rows
    assert row[:4] == ("`ppo-image`", "3", "2.00 M", "199.9")
    table = time_table(curves)
    assert (table.head, table.rows) == (("agent", "env", "learn"), (("`ppo-image`", "33", "67"),))


@pytest.mark.parametrize("text", ["", "minutes,reward_mean\n1,2\n", "step\nmany\n"])
def test_what_is_no_progress_is_refused(tmp_path, text):
    path = tmp_path / "progress.csv"
    path.write_text(text)
    with pytest.raises(ResultsError, match=r"give the progress.csv of a training run"):
        read_progress(path, "ppo-image", 1)


def test_a_curve_must_be_called_like_one(tmp_path):
    progress(tmp_path / "progress.csv", 3)
    with pytest.raises(ResultsError, match=r"call it AGENT.sSEED.csv"):
        read_curves(tmp_path)


@pytest.fixture
def pictures(tmp_path):
    return [replace(picture, path=tmp_path / picture.path.name) for picture in PICTURES]


def drawn_words(picture):
    return set(re.findall(r">([^<>]+)</text>", picture.path.read_text("utf-8")))


def test_all_seeds_and_ablations_are_drawn_and_an_outdated_picture_is_found(tmp_path, run, pictures):
    for seed in (1, 2):
        import_results(run, tmp_path, Overrides(seed=seed))
    import_results(run, tmp_path, Overrides(agent="ppo-auxiliary", seed=1))
    import_results(run, tmp_path, Overrides(seed=4, variant="without-augmentation"))
    curves = read_curves(tmp_path / "curves")
    learning = pictures[0]
    assert draw_pictures(curves, pictures) == [learning.path]
    assert {"seed 1", "seed 2", "without augmentation 4", "ppo-image", "ppo-auxiliary"} <= drawn_words(learning)
    drawn = learning.path.read_text("utf-8")
    assert len(drawn) < 300_000
    check_pictures(curves, pictures)
    draw_pictures(curves, pictures)
    assert learning.path.read_text("utf-8") == drawn
    with pytest.raises(OutdatedPageError, match="does not show the stored curves"):
        check_pictures(curves[:2], pictures)
    with pytest.raises(ResultsError, match="no curve is stored"):
        draw_pictures((), pictures)


@pytest.fixture
def imitated(tmp_path):
    """A run of two halves, whose steps are samples. Nothing says where its time went."""
    folder = tmp_path / "lbc-1"
    folder.mkdir()
    (folder / "config.json").write_text(json.dumps({"algorithm": "lbc", "seed": 1, "variant": None}))
    columns = "step,minutes,loss,collected,success_heldout,traffic_success_heldout,steps_per_second"
    (folder / "privileged.csv").write_text(f"{columns}\n512,0.1,4,9,,,100\n300000,1,0.25,9,,,300\n")
    (folder / "progress.csv").write_text(f"{columns}\n512,2,8,9,0.5,,100\n9000,3,2,9,,,300\n2000000,9,0.5,9,1,0.7,\n")
    return folder


def test_both_halves_of_an_imitation_have_curves_of_their_own(tmp_path, run, imitated, pictures):
    assert import_results(imitated, tmp_path, Overrides()).name == "lbc.s1.csv"
    ablation = import_results(imitated, tmp_path, Overrides(variant="without-dagger"))
    assert ablation.name == "lbc.without-dagger.s1.csv"
    curves = read_curves(tmp_path / "curves")
    assert [curve.file_name for curve in curves] == ["lbc.s1.csv", "lbc.without-dagger.s1.csv", "lbc-privileged.s1.csv"]
    assert imitation_table(curves).rows == (
        ("`lbc`", "1", "2.00 M", "9.0", "200", "0.500", "1.00", "0.70"),
        ("`lbc`, without dagger", "1", "2.00 M", "9.0", "200", "0.500", "1.00", "0.70"),
        ("`lbc-privileged`", "1", "0.30 M", "1.0", "200", "0.250", "–", "–"),
    )
    assert draw_pictures(curves, pictures) == [pictures[1].path]
    assert {"lbc", "lbc-privileged", "seed 1", "without dagger 1", "samples, million"} <= drawn_words(pictures[1])
    import_results(run, tmp_path, Overrides())
    every = read_curves(tmp_path / "curves")
    assert [row[0] for row in training_table(every).rows] == ["`ppo-image`"]
    assert [row[0] for row in time_table(every).rows] == ["`ppo-image`"]
    with pytest.raises(OutdatedPageError, match=r"learning-curves.svg"):
        check_pictures(every, pictures)
