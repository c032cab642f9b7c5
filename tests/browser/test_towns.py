"""The towns' pages."""

import pytest
from filled_site import Site
from visiting import Accessible, Visit

WORDS = {
    "STRAIGHT_LEFT": "straight or left",
    "STRAIGHT_RIGHT": "straight or right",
    "LEFT_RIGHT": "left or right",
    "CROSS": "crossing",
}


def test_the_list_leads_to_each_town(visit: Visit, site: Site):
    page = visit("/towns")
    towns = site.get("/v1/towns")["towns"]
    assert page.locator("main h2 a").all_inner_texts() == [town["name"] for town in towns]
    page.get_by_role("link", name="Town02").click()
    assert page.inner_text("h1") == "Town02"


def test_the_table_lists_every_approach_with_its_type(visit: Visit, site: Site):
    town = site.get("/v1/towns/Town01")
    page = visit("/towns/Town01", javascript=False)
    rows = {row.split("\t")[0]: row for row in page.locator("table tbody tr").all_inner_texts()}
    assert set(rows) == {approach["id"] for approach in town["approaches"]}
    for approach in town["approaches"]:
        assert WORDS[approach["type"]] in rows[approach["id"]]
        assert approach["type"] not in rows[approach["id"]]


def test_the_map_marks_each_approach_before_its_junction(visit: Visit, site: Site):
    town = site.get("/v1/towns/junctions")
    page = visit("/towns/junctions")
    road = page.locator("figure svg.town .road").bounding_box()
    scale = road["width"] / (town["bounds"][2] - town["bounds"][0])
    marks = page.locator("figure svg.town g.type-mark")
    assert marks.count() == len(town["approaches"])
    for approach, mark in zip(town["approaches"], marks.all(), strict=True):
        assert approach["type"] in mark.get_attribute("class")
        box = mark.bounding_box()
        x = (box["x"] + box["width"] / 2 - road["x"]) / scale + town["bounds"][0]
        y = town["bounds"][3] - (box["y"] + box["height"] / 2 - road["y"]) / scale
        metres = ((x - approach["stop_line"][0]) ** 2 + (y - approach["stop_line"][1]) ** 2) ** 0.5
        assert 6 < metres < 12


def test_each_type_has_a_mark_of_another_shape(visit: Visit):
    page = visit("/towns/junctions")
    shapes = page.eval_on_selector_all("figcaption .outline", "marks => marks.map(mark => mark.getAttribute('d'))")
    assert len(set(shapes)) == len(shapes) == 4


def test_an_unknown_town_is_a_page_that_says_so(visit: Visit, accessible: Accessible):
    page = visit("/towns/Atlantis", status=404)
    assert "Atlantis" in page.inner_text("main")
    accessible(page)


@pytest.mark.parametrize(("width", "dark"), [(400, True), pytest.param(1000, False, marks=pytest.mark.soak)])
def test_the_pages_are_accessible(visit: Visit, accessible: Accessible, width: int, dark: bool):
    for path in ("/towns", "/towns/junctions"):
        page = visit(path, width=width, dark=dark)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        accessible(page)
