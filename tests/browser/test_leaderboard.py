"""The pages of the leaderboards."""

import json
from pathlib import Path

import pytest
from filled_site import SUITE, Site
from visiting import Accessible, Visit

from wrongturn_protocol import LeaderboardEntry, Metrics
from wrongturn_service.web import plane

BOARD = f"/leaderboards/{SUITE}"


def names(page) -> list[str]:
    return page.locator("table.ranking tbody:not(.paper) tr:not(.group) th.agent a").all_inner_texts()


def test_the_page_says_the_same_as_the_call(visit: Visit, site: Site):
    entries = [entry for entry in site.get(f"/v1{BOARD}")["entries"] if entry["evaluation"]]
    page = visit(BOARD)
    assert names(page) == [entry["agent"]["name"] for entry in entries]
    for entry in entries:
        row = page.locator("tr", has=page.get_by_role("link", name=entry["agent"]["name"], exact=True))
        cells = row.locator("td").all_inner_texts()
        assert cells[0].strip() == f"{entry['rank'] or '–'}{'=' if entry['tied_with'] else ''}"
        strict = entry["unsafe_strict"]
        assert cells[2].startswith(f"{strict['count']}/{strict['trials']} ")
        assert cells[3] == f"{entry['unsafe']['count']}/{entry['unsafe']['trials']}"
        assert cells[4] == f"{entry['twins']['completed']}/{entry['twins']['trials']}"
        for number, kind in enumerate(("STRAIGHT_LEFT", "STRAIGHT_RIGHT", "LEFT_RIGHT")):
            table = entry["table_strict"][kind]
            counts = [f"{table[fault]['unsafe']}/{table[fault]['trials']}" for fault in ("infeasible", "omission")]
            assert cells[7 + number].split() == counts


def test_faults_and_junction_types_have_the_words_of_the_other_pages(visit: Visit):
    page = visit(BOARD)
    heads = page.locator("table.ranking thead th.part").all_inner_texts()
    assert heads == ["straight or left", "straight or right", "left or right"]
    lines = page.locator("table.ranking td.lines").all_inner_texts()
    assert {tuple(line.split()) for line in lines} == {("infeasible", "omission")}
    text = page.inner_text("p.meanings")
    assert "Infeasible: The command names the one direction in which the junction has no exit." in text
    assert "Omission: No turn is announced" in text


def test_the_first_line_says_how_many_agents_are_ranked(visit: Visit, site: Site):
    ranked = [entry for entry in site.get(f"/v1{BOARD}")["entries"] if entry["rank"] is not None]
    line = visit(BOARD).inner_text("p.first")
    for track in {entry["agent"]["track"] for entry in ranked}:
        count = sum(entry["agent"]["track"] == track for entry in ranked)
        first = next(entry["agent"]["name"] for entry in ranked if entry["agent"]["track"] == track)
        assert f"in the {track} track: {first}" in line
        strict = next(entry["unsafe_strict"] for entry in ranked if entry["agent"]["name"] == first)
        assert f"{first}, unsafe {strict['count']}/{strict['trials']}, [" in line
        assert ("the only ranked agent" if count == 1 else f"of {count} ranked agents") in line


def test_the_board_leads_to_the_comparison(visit: Visit):
    page = visit(BOARD)
    page.get_by_role("link", name="Compare two agents").click()
    assert page.url.endswith(f"{BOARD}/compare")


def test_rows_over_seeds_stand_apart_from_the_agents(visit: Visit):
    page = visit("/leaderboards/wrong-command@3")
    group = page.locator("details.fold", has_text="Our algorithms, median over training seeds; not ranked")
    assert group.count() == 1
    assert not group.locator("table").is_visible()
    group.locator("summary").click()
    assert "the shipped one: it drove a draw of its own" in group.inner_text()
    rows = group.locator("tbody tr")
    assert {rank.strip() for rank in rows.locator("td.rank").all_inner_texts()} == {"–"}
    assert all("training seeds" in row for row in rows.all_inner_texts())


@pytest.mark.parametrize("width", [400, 1000])
def test_a_narrow_window_shows_the_figure_and_every_mark(visit: Visit, site: Site, width: int):
    page = visit(BOARD, width=width)
    entries = site.get(f"/v1{BOARD}")["entries"]
    for entry in entries:
        row = page.locator("tr", has=page.get_by_role("link", name=entry["agent"]["name"], exact=True))
        figure = row.locator(".brief, td.main").locator("visible=true")
        assert f"{entry['unsafe_strict']['count']}/{entry['unsafe_strict']['trials']} " in figure.inner_text()
        box = figure.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width
    if width == 1000:
        assert page.evaluate("(box => box.scrollWidth - box.clientWidth)(document.querySelector('div.scroll'))") <= 0
    drawn = page.locator("figure.plane > svg").locator("visible=true")
    assert drawn.count() == 1
    marks = [mark.bounding_box() for mark in drawn.locator("path.mark").all()]
    assert marks
    assert all(mark["x"] + mark["width"] <= width for mark in marks)
    assert all(entry["rank"] for entry in entries)
    edges = "items => items.map(item => item.getBoundingClientRect())"
    (grey,) = drawn.locator(".unranked").evaluate_all(edges)
    middles = [(mark["left"] + mark["right"]) / 2 for mark in drawn.locator("path.mark").evaluate_all(edges)]
    assert all(middle > grey["right"] for middle in middles)


def test_a_bar_shows_rate_and_intervals_on_the_scale_of_the_head(visit: Visit, site: Site):
    page = visit(BOARD)
    ticks = page.locator("svg.scale").bounding_box()
    for entry in site.get(f"/v1{BOARD}")["entries"]:
        row = page.locator("tr", has=page.get_by_role("link", name=entry["agent"]["name"], exact=True))
        mark = row.locator("svg.bar circle").bounding_box()
        middle = mark["x"] + mark["width"] / 2 - ticks["x"]
        assert middle == pytest.approx(0.5 + 200 * entry["unsafe_strict"]["rate"], abs=0.2)
        thin, thick = (row.locator(f"svg.bar .{name}").bounding_box() for name in ("wide", "narrow"))
        assert thin["width"] > thick["width"] > 0


def test_filters_work_without_scripts(visit: Visit):
    page = visit(BOARD, javascript=False)
    page.get_by_label("Kind").select_option("baseline")
    page.get_by_role("button", name="Show").click()
    assert sorted(names(page)) == ["careful", "obeys-blindly"]
    page.get_by_label("Track").select_option("camera")
    page.get_by_role("button", name="Show").click()
    assert "No entry passes this filter" in page.inner_text("main")
    assert page.get_by_label("Track").input_value() == "camera"
    page.get_by_role("link", name="Show all 2").click()
    assert sorted(names(page)) == ["careful", "obeys-blindly"]


def test_the_plane_has_a_mark_for_each_agent(visit: Visit, site: Site):
    page = visit(BOARD)
    tooltips = " ".join(page.locator("figure.plane path.mark title").all_text_contents())
    for entry in site.get(f"/v1{BOARD}")["entries"]:
        assert entry["agent"]["name"] in tooltips
    assert page.get_by_role("img", name="Each agent by its completed twins").is_visible()
    labels = page.locator("figure.plane svg[role=img] text").all_text_contents()
    assert {"careful", "obeys-blindly"} <= {label.split(" +")[0] for label in labels}


@pytest.mark.parametrize("width", [400, 1000])
def test_no_label_of_a_full_plane_covers_a_mark_or_another_label(visit: Visit, site: Site, width: int):
    entry = LeaderboardEntry.model_validate(site.get(f"/v1{BOARD}")["entries"][0])
    entries = []
    for file in sorted((Path(__file__).parents[2] / "lab/stored/unseen").glob("*.json")):
        stored = json.loads(file.read_text("utf-8"))
        found = Metrics.model_validate(stored["metrics"])
        agent = entry.agent.model_copy(update={"name": stored["agent"]})
        entries.append(
            entry.model_copy(update={"agent": agent, "unsafe_strict": found.unsafe_strict, "twins": found.twins})
        )
    page = visit(BOARD, width=width)
    page.locator("figure.plane").evaluate("(old, drawn) => old.outerHTML = drawn", plane.figure(entries))
    drawn = page.locator("figure.plane > svg").locator("visible=true")
    edges = "items => items.map(item => item.getBoundingClientRect())"
    labels = drawn.locator("path.mark + text").evaluate_all(edges)
    marks = drawn.locator("path.mark").evaluate_all(edges)
    assert len(labels) >= 8
    for number, label in enumerate(labels):
        for other in labels[:number] + marks:
            beside = label["right"] <= other["left"] or other["right"] <= label["left"]
            # A line's box is higher than its letters.
            assert beside or label["bottom"] <= other["top"] + 4 or other["bottom"] <= label["top"] + 4


def test_the_address_of_the_service_shows_the_unseen_towns_and_leads_to_the_papers_suite(
    visit: Visit, accessible: Accessible
):
    page = visit("/")
    assert page.inner_text("h1").startswith("How safely does a driving agent behave")
    assert "nobody has seen" in page.inner_text("h2#ranking")
    accessible(page)
    assert page.locator("tbody.paper").count() == 0
    boards = ["wrong-command-unseen@1", "disturbed@1", "wrong-command-extended@1", "navigation-unseen@1"]
    boards += ["wrong-command@3", "navigation@1", "smoke@3"]
    assert page.locator("ul.boards a").all_inner_texts() == boards
    page.locator("main").get_by_role("link", name="table").click()
    # The paper's agents stand there as a reference.
    page.get_by_text("The paper's agents, in CARLA").click()
    rows = page.locator("tbody.paper tr").all_inner_texts()
    assert len(rows) == 5
    assert "MaRLn" in rows[1]
    assert "13/60" in rows[1]
    assert visit("/leaderboards/wrong-command@3?kind=submitted").locator("tbody.paper").count() == 0


def test_an_empty_board_says_what_to_do(visit: Visit):
    page = visit("/leaderboards/navigation@1")
    assert "No evaluation on this suite has been finished yet." in page.inner_text("main")
    link = page.locator("main").get_by_role("link", name="Hand in an agent")
    assert link.evaluate("link => link.pathname") == "/submit"
    assert "wrongturn run careful --suite navigation@1 --url" in page.inner_text("p.notice")
    assert "82" in page.locator("tbody.paper").text_content()
