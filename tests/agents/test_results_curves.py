import json
import re

import pytest
from made_results import progress

from wrongturn_agents.errors import OutdatedPageError, ResultsError
from wrongturn_agents.reporting.curves import (
    POINTS,
    check_picture,
    draw,
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


def test_all_seeds_are_drawn_and_an_outdated_picture_is_found(tmp_path, run):
    for seed in (1, 2):
        import_results(run, tmp_path, Overrides(seed=seed))
    import_results(run, tmp_path, Overrides(agent="ppo-auxiliary", seed=1))
    curves = read_curves(tmp_path / "curves")
    picture = tmp_path / "curves.svg"
    draw(curves, picture)
    drawn = picture.read_text("utf-8")
    assert {"seed 1", "seed 2", "ppo-image", "ppo-auxiliary"} <= set(re.findall(r">([^<>]+)</text>", drawn))
    assert len(drawn) < 300_000
    check_picture(curves, picture)
    draw(curves, picture)
    assert picture.read_text("utf-8") == drawn
    with pytest.raises(OutdatedPageError, match="does not show the stored curves"):
        check_picture(curves[:2], picture)
    with pytest.raises(ResultsError, match="no curve is stored"):
        draw((), picture)
