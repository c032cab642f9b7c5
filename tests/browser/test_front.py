"""The leaderboard's pages."""

from visiting import Accessible, Visit


def test_the_address_of_the_service_shows_the_leaderboard(visit: Visit, accessible: Accessible):
    page = visit("/")
    assert "benchmark" in page.inner_text("h1")
    accessible(page)


def test_an_unknown_page_is_a_page_that_says_so(visit: Visit, accessible: Accessible):
    page = visit("/leaderboards/nothing@1", status=404)
    assert "nothing@1" in page.inner_text("main")
    accessible(page)
