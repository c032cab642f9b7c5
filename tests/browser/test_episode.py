"""An episode's page: the replay of a trial beside its twin."""

import dataclasses
import json
import math

import pytest
from filled_site import Site
from playwright.sync_api import Page, expect
from typer.testing import CliRunner
from visiting import Accessible, Visit

from wrongturn_client.cli import app


@dataclasses.dataclass(frozen=True)
class Pair:
    """A trial that left the road, and its twin that did not."""

    trial: dict
    twin: dict

    @property
    def path(self) -> str:
        return f"/episodes/{self.trial['id']}"


@pytest.fixture(scope="module")
def pair(site: Site) -> Pair:
    listed = site.get(f"/v1/evaluations/{site.evaluations['obeys-blindly']}/episodes")["episodes"]
    named = {one["trial"]: one for one in listed}
    faulty = [one for name, one in named.items() if ".infeasible." in name and one["outcome"]["verdict"] == "off_road"]
    pairs = [Pair(one, named[one["trial"].replace(".infeasible.", ".none.")]) for one in faulty]
    # In a few draws one of them takes as long as its twin.
    return next(pair for pair in pairs if decisions(pair.trial) != decisions(pair.twin))


def decisions(episode: dict) -> int:
    return math.ceil(10 * episode["outcome"]["time"])


def ready(page: Page) -> Page:
    """Wait until the replay can be used."""
    page.wait_for_selector("[data-ready]")
    return page


def position(page: Page) -> int:
    return int(page.input_value(".scrub"))


def pixels(page: Page, canvas: str) -> str:
    """What a canvas shows."""
    return page.evaluate("name => document.querySelector(name).toDataURL()", canvas)


def test_what_happened_and_why(visit: Visit, accessible: Accessible, pair: Pair):
    page = ready(visit(pair.path))
    assert "obeys-blindly" in page.inner_text("h1")
    verdict = page.inner_text("p.verdict")
    assert "off road – unsafe. The car left the road" in verdict
    assert f"after {pair.trial['outcome']['time']:.1f} s" in verdict
    moments = [row.inner_text() for row in page.query_selector_all(".moments >> nth=0 >> tbody tr")]
    assert moments[0].startswith("0.0 s")
    assert any("but the route says" in moment for moment in moments)
    assert "left the road" in moments[-1]
    assert page.inner_text("figure.drive >> nth=1 >> figcaption").startswith("The twin, without a fault: exit")
    accessible(page)


def test_a_fork_is_a_third_car(visit: Visit, accessible: Accessible, site: Site, pair: Pair):
    source = ["whatif", pair.trial["id"], "--url", site.url, "--agent", "obeys-blindly"]
    environment = {"WRONGTURN_TOKEN": site.tokens["obeys-blindly"]}
    done = CliRunner().invoke(app, [*source, "--sweep", "--post", "--json", "-"], env=environment)
    assert done.exit_code == 0, done.output
    last = json.loads(done.output)["no_return_s"]
    page = ready(visit(pair.path))
    assert page.locator("figure.drive").count() == 3
    assert page.inner_text("figure.drive >> nth=2 >> figcaption").startswith(
        f"What if: the right command from {last:.1f} s on: exit"
    )
    assert f"{last:.1f} s\tThe point of no return" in page.inner_text(".moments >> nth=0")
    expect(page.locator(".speeds .no-return")).to_be_visible()
    accessible(page)
    page.click("text=/the right command from .* on/ >> nth=-1")
    ready(page)
    assert "(unsafe)" in page.inner_text("figure.drive >> nth=2 >> figcaption")


def test_scrubbing_moves_everything(visit: Visit, pair: Pair):
    page = ready(visit(pair.path))
    places = (".map", ".camera")
    camera = page.locator(".camera").first
    expect(camera).to_have_attribute("data-decision", "0")
    before = [pixels(page, place) for place in places]
    line = "document.querySelector('.speeds .now').style.transform"
    at_first = page.evaluate(line)
    page.locator(".scrub").fill("25")
    expect(camera).to_have_attribute("data-decision", "25")
    assert all(old != pixels(page, place) for old, place in zip(before, places, strict=True))
    assert page.evaluate(line) != at_first
    assert page.inner_text(".clock").startswith("2.5 s of ")
    expect(page.locator(".status")).to_contain_text("2.5 s:")
    expect(page.locator(".status")).to_contain_text("km/h, command: ")


def test_the_first_screen_has_maps_commands_cameras_and_the_timeline(visit: Visit, pair: Pair):
    page = visit(pair.path)
    page.set_viewport_size({"width": 1280, "height": 720})
    ready(page)
    for part in (".map", ".stage .command", ".stage .camera", ".scrub"):
        for box in (one.bounding_box() for one in page.locator(part).all()):
            assert box is not None
            assert box["y"] + box["height"] <= 720, part
    page.click(".moments >> nth=0 >> tr:has-text('but the route says') button >> nth=0")
    assert "route:" in page.inner_text(".command.differs")


def test_the_camera_is_in_a_corner_where_no_car_drives(visit: Visit, pair: Pair):
    page = ready(visit(pair.path))
    assert page.get_attribute(".seen >> nth=0", "data-corner") in {"low-right", "high-right", "low-left"}
    script = """async ([x, y]) => {
        const { freeCorner } = await import("/static/episode/map.js");
        const view = { middle: [0, 0], size: [60, 40] };
        const sized = (clientWidth, clientHeight) => ({ clientWidth, clientHeight });
        return freeCorner({ turned: (...place) => place }, [{ x, y }], view, sized(600, 400), sized(200, 67));
    }"""
    assert page.evaluate(script, [[0, 0], [-18, 0]]) == "low-right"
    assert page.evaluate(script, [[25, 0], [-18, 0]]) == "high-right"
    assert page.evaluate(script, [[25, 25], [-18, 15]]) == "low-left"


def test_the_address_has_the_time(visit: Visit, pair: Pair):
    page = ready(visit(f"{pair.path}#t=2.5"))
    assert position(page) == 25
    page.evaluate("location.hash = '#t=1.0'")
    expect(page.locator(".scrub")).to_have_value("10")
    # The replay writes its own time into the address before it hears of yours.
    page.evaluate("location.hash = '#t=2.0'; history.replaceState(null, '', '#t=1.0')")
    expect(page.locator(".scrub")).to_have_value("20")
    page.locator(".scrub").fill("12")
    page.wait_for_url(f"**{pair.path}#t=1.2")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.locator(".scrub").fill("30")
    page.click("text=Copy link")
    expect(page.locator(".status")).to_contain_text("time 3.0 s is copied")
    assert page.evaluate("navigator.clipboard.readText()").endswith(f"{pair.path}#t=3.0")


def test_a_film_can_be_got_without_javascript(visit: Visit, pair: Pair):
    page = visit(pair.path, javascript=False)
    with page.expect_download() as coming:
        page.click("noscript .film >> nth=0")
    assert coming.value.suggested_filename == f"obeys-blindly.{pair.trial['trial']}.mp4"
    assert coming.value.path().read_bytes()[4:8] == b"ftyp"


def test_the_keyboard(visit: Visit, pair: Pair):
    page = ready(visit(pair.path))
    last = int(page.get_attribute(".scrub", "max"))
    # Nothing has the focus: these keys play all the same, and the others scroll.
    page.keyboard.press("ArrowRight")
    assert position(page) == 1
    page.keyboard.press("End")
    assert position(page) == 1
    page.keyboard.press("ArrowLeft")
    page.focus(".map")
    for key, wanted in (
        ("ArrowRight", 1),
        ("PageUp", 11),
        ("ArrowLeft", 10),
        ("PageDown", 0),
        ("ArrowLeft", 0),
        ("End", last),
        ("ArrowRight", last),
        ("Home", 0),
    ):
        page.keyboard.press(key)
        assert position(page) == wanted, key
    page.select_option(".pace", "0.25")  # so slow that it does not end while this test looks
    page.focus(".scrub")
    page.keyboard.press("ArrowRight")
    assert position(page) == 1
    page.keyboard.press("Space")
    expect(page.locator(".play")).to_have_text("Pause")
    expect(page.locator(".scrub")).not_to_have_value("1")
    page.keyboard.press("Space")
    expect(page.locator(".play")).to_have_text("Play")
    # The button's own key is pressed once, not twice.
    page.focus(".play")
    page.keyboard.press("Space")
    expect(page.locator(".play")).to_have_text("Pause")


def test_nothing_plays_by_itself_and_playing_ends(visit: Visit, pair: Pair):
    page = ready(visit(pair.path))
    page.evaluate("new Promise(requestAnimationFrame).then(() => new Promise(requestAnimationFrame))")
    assert position(page) == 0
    last = int(page.get_attribute(".scrub", "max"))
    page.locator(".scrub").fill(str(last - 3))
    page.select_option(".pace", "8")
    page.click(".play")
    expect(page.locator(".scrub")).to_have_value(str(last))
    expect(page.locator(".play")).to_have_text("Play")
    page.select_option(".pace", "0.25")
    page.click(".play")
    expect(page.locator(".scrub")).not_to_have_value(str(last))


def test_a_moment_is_a_way_to_its_time(visit: Visit, pair: Pair):
    page = ready(visit(pair.path))
    page.click(".moments >> nth=0 >> tr.verdict button")
    assert position(page) == -(-pair.trial["outcome"]["time"] * 20 // 2)
    page.wait_for_selector(f".camera[data-decision='{position(page)}']")
    page.click(".speeds .u-over", position={"x": 5, "y": 20})
    assert position(page) < 5


def test_the_twin_stands_beside_its_trial_and_the_reverse(visit: Visit, pair: Pair):
    page = ready(visit(pair.path))
    page.click("text=its own page")
    ready(page)
    assert page.url.endswith(pair.twin["id"])
    shown = [figure.get_attribute("data-episode") for figure in page.query_selector_all("figure.drive")]
    assert shown == [pair.twin["id"], pair.trial["id"]]
    # The shorter drive stays at its end while the longer one goes on.
    page.focus(".map")
    page.keyboard.press("End")
    for camera, episode in zip(page.locator(".camera").all(), (pair.twin, pair.trial), strict=True):
        expect(camera).to_have_attribute("data-decision", str(decisions(episode)))


def test_a_picture_of_the_camera_that_does_not_come_is_said(visit: Visit, accessible: Accessible, pair: Pair):
    page = ready(visit(pair.path))
    page.wait_for_selector(".camera[data-decision='0']")
    page.context.route("**/camera/0", lambda route: route.fulfill(status=200, body="no picture"))
    page.reload()
    ready(page)
    expect(page.locator(".unseen").first).to_contain_text("could not be loaded. Load the page again.")
    accessible(page)
    page.locator(".scrub").fill("25")
    page.wait_for_selector(".camera[data-decision='25']")
    assert page.inner_text(".unseen") == ""
    page.locator(".scrub").fill("0")
    expect(page.locator(".unseen").first).to_contain_text("could not be loaded")
    assert page.locator(".camera").first.get_attribute("data-decision") is None


def test_without_javascript_the_page_says_it_in_words(visit: Visit, pair: Pair):
    page = visit(pair.path, javascript=False)
    text = page.inner_text("main")
    assert "The replay needs JavaScript." in text
    assert "The car left the road" in text
    assert not page.is_visible(".controls")
    picture = page.locator("img.whole").nth(1).evaluate("image => new URL(image.src).pathname")
    assert picture == f"/v1/episodes/{pair.twin['id']}/picture.png"
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
