"""The documentation of every call, and its forms."""

import re

from filled_site import SUITE, Site
from playwright.sync_api import Page, expect
from visiting import Accessible, Visit


def opened(page: Page, call: str) -> Page:
    """Open a call of the page by the keyboard."""
    page.locator(f"#{call} > summary").focus()
    page.keyboard.press("Enter")
    assert page.locator(f"#{call}").get_attribute("open") is not None
    return page


def test_every_call_is_there_and_readable(visit: Visit, accessible: Accessible, site: Site):
    page = visit("/docs", width=400, dark=True)
    calls = {
        f"{method.upper()} {path}"
        for path, operations in site.get("/openapi.json")["paths"].items()
        for method in operations
    }
    summaries = [re.sub(r"\s+", " ", text) for text in page.locator("details.call > summary").all_inner_texts()]
    assert len(summaries) == len(calls)
    for call in calls:
        assert any(text.startswith(f"{call} ") for text in summaries), call
    page.evaluate("for (const part of document.querySelectorAll('details')) part.open = true")
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    # axe-core would take half a minute for all of them.
    page.evaluate("for (const part of document.querySelectorAll('details')) part.open = false")
    for call in ("post-v1-episodes", "post-v1-submissions", "get-v1-evaluations-evaluation-episodes"):
        opened(page, call)
    accessible(page)


def test_without_javascript_the_examples_can_be_read(visit: Visit):
    page = opened(visit("/docs", javascript=False), "post-v1-episodes-episode-step")
    assert "curl -X POST" in page.inner_text("#post-v1-episodes-episode-step")
    assert '"terminated": false' in page.inner_text("#post-v1-episodes-episode-step")
    assert page.locator("form.try:visible").count() == 0
    assert "The commands do the same" in page.inner_text("main")


def test_a_form_shows_what_the_service_replies(visit: Visit):
    page = opened(visit("/docs", refusals=True), "get-v1-suites-suite")
    form = page.locator("#get-v1-suites-suite form")
    form.get_by_label("suite").fill(SUITE)
    form.get_by_role("button").press("Enter")
    expect(form.get_by_role("status")).to_contain_text("200")
    expect(form.locator("pre")).to_contain_text(f'"id": "{SUITE}"')
    opened(page, "post-v1-evaluations")
    form = page.locator("#post-v1-evaluations form")
    form.get_by_role("button").click()
    expect(form.get_by_role("status")).to_contain_text("401")
    expect(form.locator("pre")).to_contain_text("/problems/unauthenticated")


def test_ids_and_tokens_go_into_the_other_forms(visit: Visit):
    page = opened(visit("/docs"), "post-v1-agents")
    form = page.locator("#post-v1-agents form")
    form.get_by_label("Body").fill('{"name": "from the forms", "track": "state"}')
    form.get_by_role("button").click()
    expect(form.get_by_role("status")).to_contain_text("201")
    assert page.get_by_label("Token for the forms").input_value().startswith("wt_")
    page = opened(page, "get-v1-agents-agent")
    form = page.locator("#get-v1-agents-agent form")
    form.get_by_role("button").click()
    expect(form.locator("pre")).to_contain_text('"name": "from the forms"')


def test_an_address_opens_its_call(visit: Visit):
    page = visit("/docs#post-v1-evaluations")
    expect(page.locator("#post-v1-evaluations")).to_have_attribute("open", "")
