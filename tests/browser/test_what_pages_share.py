"""Tables can be sorted and saved, and each page says what this is and how to cite it."""

import csv
import io
from pathlib import Path
from urllib.parse import unquote

import httpx
import yaml
from filled_site import SUITE, Site
from visiting import Accessible, Visit

BOARD = f"/leaderboards/{SUITE}"
CITATION = yaml.safe_load((Path(__file__).parents[2] / "CITATION.cff").read_text("utf-8"))


def test_a_column_sorts_by_the_keyboard_and_back(visit: Visit):
    page = visit("/leaderboards/wrong-command@3")
    page.get_by_text("The paper's agents, in CARLA").click()
    table = page.locator("table", has=page.locator("tbody.paper"))
    head = table.get_by_role("button", name="Paper's")
    column = head.evaluate("button => button.parentElement.cellIndex")
    shares = []
    for order in ("ascending", "descending"):
        head.press("Enter")
        assert head.evaluate("button => button.parentElement.getAttribute('aria-sort')") == order
        texts = [row.locator("th, td").nth(column).inner_text() for row in table.locator("tbody tr").all()]
        shares.append([int(text.split("/")[0]) for text in texts if "/" in text])
    assert shares[0] == sorted(shares[0])
    assert shares[1] == shares[0][::-1]
    assert len(set(shares[0])) > 1


def test_every_table_is_saved_as_csv(visit: Visit, site: Site):
    page = visit(f"/agents/{site.agents['obeys-blindly']}")
    assert page.locator("p.csv a").count() == page.locator(".scroll > table").count() > 1
    link = page.locator("p.csv a").last
    link.evaluate("link => link.addEventListener('click', event => event.preventDefault())")
    link.click()
    rows = list(csv.reader(io.StringIO(unquote(link.get_attribute("href").partition(",")[2]))))
    assert rows[0][0] == "Suite"
    assert rows[1][0] == SUITE


def test_the_leaderboard_has_a_csv_without_scripts(site: Site):
    reply = httpx.get(f"{site.url}{BOARD}/table.csv")
    assert reply.headers["content-type"].startswith("text/csv")
    assert {row["agent"] for row in csv.DictReader(io.StringIO(reply.text))} >= {"careful", "obeys-blindly"}
    assert httpx.get(f"{site.url}/leaderboards/none@1/table.csv").status_code == 404


def test_every_page_leads_to_the_citation(visit: Visit, accessible: Accessible):
    page = visit("/suites", width=400)
    said = page.locator("meta[name=description]").get_attribute("content")
    assert said
    assert said == page.locator("meta[property='og:description']").get_attribute("content")
    assert page.locator("meta[property='og:title']").get_attribute("content") == page.title()
    page.get_by_role("link", name="Cite").click()
    accessible(page)
    shown = page.locator("pre").inner_text()
    paper = CITATION["references"][0]
    assert CITATION["title"] in shown
    assert f"version = {{{CITATION['version']}}}" in shown
    assert CITATION["license"] in shown
    assert paper["title"] in shown
    assert str(paper["year"]) in shown
    assert paper["url"] in shown
    assert page.locator(f"a[href='{paper['url']}']").count() == 1
    assert all(f"{author['family-names']}, {author['given-names']}" in shown for author in paper["authors"])


def test_pages_are_compressed_and_steps_are_not(site: Site):
    page = httpx.get(f"{site.url}{BOARD}", headers={"Accept-Encoding": "gzip"})
    assert page.headers["content-encoding"] == "gzip"
    assert "Accept-Encoding" in page.headers["vary"]
    again = httpx.get(f"{site.url}{BOARD}", headers={"Accept-Encoding": "gzip", "If-None-Match": page.headers["etag"]})
    assert again.status_code == 304
    plain = httpx.get(f"{site.url}{BOARD}", headers={"Accept-Encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert plain.text == page.text
    call = httpx.get(f"{site.url}/v1/evaluations/{site.evaluations['careful']}", headers={"Accept-Encoding": "gzip"})
    assert "content-encoding" not in call.headers


def test_a_running_evaluation_shows_how_far_it_is_and_nothing_of_its_verdicts(visit: Visit, site: Site):
    body = {"name": "on its way", "track": "privileged"}
    owner = httpx.post(f"{site.url}/v1/owners", json={"name": "somebody"}).json()
    mine = {"Authorization": f"Bearer {owner['token']}"}
    agent = httpx.post(f"{site.url}/v1/agents", json=body, headers=mine).json()
    its = {"Authorization": f"Bearer {agent['token']}"}
    begun = httpx.post(f"{site.url}/v1/evaluations", json={"suite": SUITE}, headers=its).json()
    text = visit(f"/agents/{agent['id']}").inner_text("main")
    assert f"An evaluation on {SUITE} is running: 0 of 12 episodes are driven." in text
    assert begun["id"] not in text
    httpx.delete(f"{site.url}/v1/evaluations/{begun['id']}", headers=its)


def test_a_failed_trial_loops_beside_the_question_and_can_be_stopped(visit: Visit):
    page = visit("/")
    figure = page.locator("figure.failed")
    assert "obeys-blindly" in figure.inner_text()
    assert not figure.locator(".car").is_visible()  # the tests' browser wants no motion
    page.emulate_media(reduced_motion="no-preference")
    figure.locator("svg").evaluate("picture => picture.setCurrentTime(0)")
    whole, car = (figure.locator(part).bounding_box() for part in ("svg", ".car rect"))
    assert car["y"] < whole["y"] + whole["height"]  # the loop begins where the car comes into the picture
    figure.get_by_role("button", name="Pause").click()
    assert figure.locator("svg").evaluate("picture => picture.animationsPaused()")
