"""The suites' pages."""

import pytest
from filled_site import Site
from visiting import Accessible, Visit


def test_the_list_has_every_suite(visit: Visit, site: Site):
    page = visit("/suites", javascript=False)
    suites = site.get("/v1/suites")["suites"]
    rows = page.locator("tbody tr").all_inner_texts()
    assert [row.split("\t")[0] for row in rows] == [suite["id"] for suite in suites]
    page.get_by_role("link", name="smoke@2", exact=True).click()
    assert page.inner_text("h1") == "smoke@2"


def test_a_suite_of_cells_says_what_a_draw_takes(visit: Visit, site: Site):
    page = visit("/suites/wrong-command@2")
    suite = site.get("/v1/suites/wrong-command@2")
    rows = page.locator("tbody tr").all_inner_texts()
    assert len(rows) == 6
    assert all(row.endswith("\t10") for row in rows)
    assert sum("straight or left" in row and "infeasible" in row for row in rows) == 1
    assert suite["sha256"] in page.inner_text("main")
    assert "120: 60 trials and 60 twins" in page.inner_text("main")
    page.get_by_role("link", name="Leaderboard").last.click()
    assert page.url.endswith("/leaderboards/wrong-command@2")


def test_a_suite_of_journeys_has_tasks_and_conditions(visit: Visit):
    text = visit("/suites/navigation@1").inner_text("main")
    assert "400 journeys" in text
    assert "one turn" in text
    assert "new town and weather" in text
    assert "twin:" not in text


def test_an_unknown_suite_is_a_page_that_says_so(visit: Visit):
    assert "nothing@9" in visit("/suites/nothing@9", status=404).inner_text("main")


@pytest.mark.parametrize(("width", "dark"), [(400, False), pytest.param(1000, True, marks=pytest.mark.soak)])
def test_the_pages_are_accessible(visit: Visit, accessible: Accessible, width: int, dark: bool):
    for path in ("/suites", "/suites/wrong-command@2"):
        page = visit(path, width=width, dark=dark)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        accessible(page)
