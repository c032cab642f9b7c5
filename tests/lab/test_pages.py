"""The tables of the repository's pages: a table comes out right, and a page that says something else is found."""

import json
from pathlib import Path

import pytest
from driven_runs import driven_run
from made_results import keep, progress, wrong_command

from lab.curves import PICTURES, check_pictures, import_curve, read_curves, thinned
from lab.results import Sections, check_page, filled, import_results, sections
from lab.stored_results import Collection
from lab.tables import OutdatedPageError
from wrongturn_agents.errors import ResultsError

PAGE = """# Title

<!-- results: wrong-command -->
<!-- end of results -->

Words between.

<!-- results: order -->
<!-- end of results -->
The end.
"""


def read(directory: Path) -> Collection:
    return Collection.read(directory)


@pytest.fixture
def made(tmp_path: Path) -> Sections:
    directory = tmp_path / "stored"
    directory.mkdir()
    keep(directory, wrong_command("ppo-image", (0, 0, 0, 0, 7, 7), seed=1), shipped={"ppo-image": 1})
    return sections(read(directory))


def test_a_page_shows_what_is_stored_and_the_rest_is_left_alone(tmp_path, made):
    page = tmp_path / "README.md"
    page.write_text(PAGE)
    page.write_text(filled(page, made))
    text = page.read_text()
    assert "|  | ours, seed 1 | 0 · 0 | 0 · 0 | 7 · 7 | 14 (16–33 %) | 14 (16–33 %) | 60/60 |" in text
    assert "cannot be said yet" in text
    assert text.startswith("# Title\n\n<!--")
    assert "\nWords between.\n" in text
    assert text.endswith("<!-- end of results -->\nThe end.\n")
    check_page(page, made)
    assert filled(page, made) == text
    page.write_text(text.replace("7 · 7", "0 · 0"))
    with pytest.raises(OutdatedPageError, match=r"README.md: wrong-command: does not show the stored results"):
        check_page(page, made)
    page.write_text("<!-- results: order -->\n")
    with pytest.raises(ResultsError, match="a section is not whole"):
        filled(page, made)


def test_results_of_either_kind_of_file_are_stored(tmp_path):
    scored = tmp_path / "scored.json"
    scored.write_text(wrong_command("ppo-image", (1, 0, 0, 0, 0, 0), seed=3).model_dump_json())
    stored = import_results(scored, tmp_path, seed=4, variant="masked-classes")
    assert stored.name == "ppo-image.masked-classes.s4.wrong-command@3.in-process.json"
    run = tmp_path / "run.json"
    run.write_text(driven_run(lambda _: {}).model_dump_json())
    assert import_results(run, tmp_path, agent="careful").name == "careful.smoke@3.over-the-service.json"
    with pytest.raises(ResultsError, match="--import: seed: "):
        import_results(scored, tmp_path, seed=-1)


def test_a_curve_is_thinned(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    progress(run / "progress.csv", 1000, evaluated_every=100)
    (run / "config.json").write_text(json.dumps({"algorithm": "ppo-image", "seed": 3}))
    path = import_curve(run, folder=tmp_path)
    (curve,) = read_curves(tmp_path)
    assert (path.name, curve.agent, curve.seed, curve.variant) == ("ppo-image.s3.csv", "ppo-image", 3, None)
    assert 140 < len(curve.rows) < 170
    assert len(curve.points("success_heldout")) == 10
    assert len(thinned(curve.rows)) == pytest.approx(len(curve.rows), abs=75)


def test_a_picture_of_other_curves_is_found():
    curves = read_curves()
    check_pictures(curves)
    with pytest.raises(OutdatedPageError, match="does not show the stored curves"):
        check_pictures([curve for curve in curves if curve.seed != 2])
    assert all(picture.path.is_file() for picture in PICTURES.values())
