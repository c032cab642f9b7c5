"""The page that says how to hand in an agent."""

import pytest
from filled_site import Site
from visiting import Accessible, Visit


def test_the_commands_carry_this_services_address(visit: Visit, site: Site):
    commands = visit("/submit").locator("pre").all_inner_texts()
    assert f"wrongturn submit my_agent.onnx --suite wrong-command@2 --url {site.url}" in commands[0]
    assert all(site.url in command for command in commands)


def test_the_suite_is_chosen_without_scripts(visit: Visit):
    page = visit("/submit", javascript=False)
    page.get_by_label("Suite").select_option("smoke@2")
    page.get_by_role("button", name="Show the commands").click()
    assert "--suite smoke@2" in page.locator("pre").first.inner_text()
    assert page.get_by_label("Suite").input_value() == "smoke@2"


def test_an_unknown_suite_is_refused(visit: Visit):
    assert "nothing@1" in visit("/submit?suite=nothing@1", status=404).inner_text("main")


@pytest.mark.parametrize(("width", "dark"), [(400, True), pytest.param(1000, False, marks=pytest.mark.soak)])
def test_the_page_is_accessible(visit: Visit, accessible: Accessible, width: int, dark: bool):
    page = visit("/submit", width=width, dark=dark)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    accessible(page)
