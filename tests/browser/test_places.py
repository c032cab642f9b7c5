"""The pages of suites and towns, and the page that says how to hand in an agent."""

from filled_site import Site
from visiting import Visit

WORDS = {
    "STRAIGHT_LEFT": "straight or left",
    "STRAIGHT_RIGHT": "straight or right",
    "LEFT_RIGHT": "left or right",
    "CROSS": "crossing",
}


def test_the_list_has_every_suite(visit: Visit, site: Site):
    page = visit("/suites", javascript=False)
    suites = site.get("/v1/suites")["suites"]
    rows = page.locator("tbody tr").all_inner_texts()
    assert [row.split("\t")[0] for row in rows] == [suite["id"] for suite in suites]
    page.get_by_role("link", name="smoke@3", exact=True).click()
    assert page.inner_text("h1") == "smoke@3"


def test_a_suite_of_cells_says_what_a_draw_takes(visit: Visit, site: Site):
    page = visit("/suites/wrong-command@3")
    suite = site.get("/v1/suites/wrong-command@3")
    rows = page.locator("tbody tr").all_inner_texts()
    assert len(rows) == 6
    assert all(row.endswith("\t10") for row in rows)
    assert sum("straight or left" in row and "infeasible" in row for row in rows) == 1
    assert suite["sha256"] in page.inner_text("main")
    assert "120: 60 trials and 60 twins" in page.inner_text("main")
    page.get_by_role("link", name="Leaderboard").last.click()
    assert page.url.endswith("/leaderboards/wrong-command@3")


def test_a_suite_of_journeys_has_tasks_and_conditions(visit: Visit):
    text = visit("/suites/navigation@1").inner_text("main")
    assert "400 journeys" in text
    assert "one turn" in text
    assert "new town and weather" in text
    assert "twin:" not in text


def test_the_commands_carry_this_services_address(visit: Visit, site: Site):
    commands = visit("/submit").locator("pre").all_inner_texts()
    assert f"wrongturn submit my_agent.onnx --suite wrong-command-unseen@1 --url {site.url}" in commands
    calls = [command for command in commands if any(word in command for word in ("--suite", "curl", "Client("))]
    assert len(calls) == 4
    assert all(site.url in command for command in calls)


def test_the_suite_is_chosen_without_scripts(visit: Visit):
    page = visit("/submit", javascript=False)
    page.get_by_label("Suite").select_option("smoke@3")
    page.get_by_role("button", name="Show the commands").click()
    assert "--suite smoke@3" in page.locator("pre", has_text="wrongturn submit").inner_text()
    assert page.get_by_label("Suite").input_value() == "smoke@3"


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
