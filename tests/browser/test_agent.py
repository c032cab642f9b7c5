"""An agent's page."""

import httpx
from filled_site import SUITE, Site
from playwright.sync_api import expect
from visiting import Visit


def test_an_agent_is_shown_with_its_table_maps_and_trials(visit: Visit, site: Site):
    page = visit(f"/agents/{site.agents['obeys-blindly']}")
    assert page.inner_text("h1") == "obeys-blindly"
    assert "4 of 6" in page.inner_text(".figures")
    assert page.locator(".map").count() == 9
    assert page.locator(".map a").count() == 12
    assert page.locator("table.trials tbody tr").count() == 6


def test_unsafe_trials_come_first_and_the_others_are_folded(visit: Visit, site: Site):
    page = visit(f"/agents/{site.agents['obeys-blindly']}", javascript=False)
    shown = [row.inner_text() for row in page.locator("table.trials tbody tr").all() if row.is_visible()]
    assert len(shown) == 4
    assert all("unsafe" in row for row in shown)
    page.click("text=2 trials that are not unsafe")
    expect(page.locator("table.trials tbody tr").last).to_be_visible()
    heads = [head.inner_text() for head in page.locator(".maps h3").all()]
    assert [("0 of" in head) for head in heads] == [False] * 4 + [True] * 5
    assert page.locator(".maps.small h3").count() == 5


def test_a_section_that_is_folded_opens_for_its_link(visit: Visit, site: Site):
    page = visit(f"/agents/{site.agents['careful']}")
    assert not page.is_visible("#verdicts")
    page.click(".parts >> text=Verdicts")
    expect(page.locator("#verdicts")).to_be_visible()


def test_a_path_on_a_map_leads_to_its_episode(visit: Visit, site: Site):
    page = visit(f"/agents/{site.agents['obeys-blindly']}", javascript=False)
    drawn = {link.get_attribute("href") for link in page.locator(".map a").all()}
    listed = {link.get_attribute("href") for link in page.locator("table.trials a").all()}
    assert drawn == listed
    episode = next(iter(listed)).removeprefix("/episodes/")
    assert site.get(f"/v1/episodes/{episode}")["outcome"]


def test_trials_are_filtered_without_javascript(visit: Visit, site: Site):
    page = visit(f"/agents/{site.agents['obeys-blindly']}", javascript=False)
    page.get_by_label("Verdict", exact=True).select_option("unsafe")
    page.get_by_label("Fault", exact=True).select_option("infeasible")
    page.get_by_role("button", name="Filter").click()
    rows = page.locator("table.trials tbody tr")
    expect(rows).to_have_count(3)  # waits for the page that the click opens
    assert "3 of 6 trials" in page.inner_text("main")
    page.get_by_role("link", name="Show all").click()
    expect(rows).to_have_count(6)


def test_a_filter_that_nothing_passes_says_so(visit: Visit, site: Site):
    page = visit(f"/agents/{site.agents['careful']}?verdict=unsafe")
    assert "No trial matches" in page.inner_text("main")


def test_all_agents_are_listed(visit: Visit, site: Site):
    page = visit("/agents")
    page.get_by_role("link", name=SUITE).first.click()
    assert page.inner_text("h1") == "careful"
    assert page.url.startswith(f"{site.url}/agents/{site.agents['careful']}")


def test_long_words_of_an_owner_do_not_widen_the_page(visit: Visit, site: Site):
    body = {"name": "W" * 64, "track": "camera", "description": "d" * 500, "homepage": f"https://x.org/{'h' * 250}"}
    made = httpx.post(f"{site.url}/v1/agents", json=body, timeout=120).json()
    page = visit(f"/agents/{made['id']}", width=400)
    assert page.evaluate("document.documentElement.scrollWidth") == 400
    assert "finished no evaluation yet" in page.inner_text("main")
