"""The page that compares two agents."""

from filled_site import SUITE, Site
from visiting import Accessible, Visit

PATH = f"/leaderboards/{SUITE}/compare"


def test_two_agents_stand_beside_each_other(visit: Visit):
    page = visit(f"{PATH}?a=obeys-blindly&b=careful")
    assert page.inner_text("h1") == "obeys-blindly and careful"
    assert "obeys-blindly was unsafe in 4 of 6 trials, careful in 0 of 6" in page.inner_text("main")
    assert page.locator(".map").count() == 12
    assert page.locator("table.beside tbody tr").count() >= 6


def test_an_agent_is_compared_by_the_form_of_its_page(visit: Visit, site: Site):
    page = visit(f"/agents/{site.agents['obeys-blindly']}", javascript=False)
    page.get_by_label("Compare with").select_option("careful")
    page.get_by_role("button", name="Compare").click()
    assert page.inner_text("h1") == "obeys-blindly and careful"
    page.get_by_label("Show").select_option("only trials that count differently")
    page.get_by_role("button", name="Show").click()
    assert "unsafe" in page.inner_text("table.beside")


def test_without_names_the_page_asks(visit: Visit, accessible: Accessible):
    page = visit(PATH, width=400)
    accessible(page)
    page.get_by_label("Agent", exact=True).select_option("careful")
    page.get_by_label("Other agent").select_option("obeys-blindly")
    page.get_by_role("button", name="Compare").click()
    assert page.inner_text("h1") == "careful and obeys-blindly"
    assert page.evaluate("document.documentElement.scrollWidth") == 400


def test_a_wrong_choice_is_told_above_the_form_which_stays(visit: Visit, site: Site):
    page = visit(f"{PATH}?a=careful&b=nobody", status=404)
    assert "'nobody' has no finished evaluation" in page.get_by_role("alert").inner_text()
    assert page.get_by_label("Agent", exact=True).input_value() == site.agents["careful"]
    page = visit(f"{PATH}?a=careful&b={'x' * 200}", status=404)
    assert "has no finished evaluation" in page.get_by_role("alert").inner_text()
    page = visit(f"{PATH}?a=careful&b={site.agents['careful']}", status=422)
    assert page.get_by_role("alert").inner_text() == "That is the same agent twice. Choose two different ones."
    assert page.get_by_role("button", name="Compare").is_visible()
