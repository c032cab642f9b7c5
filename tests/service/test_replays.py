"""The camera's pictures of stored episodes, which the service draws from their trajectories."""

import asyncio
import subprocess
import sys
import threading
from pathlib import Path

import cv2
import httpx
import numpy as np
import pytest
from app_harness import application
from service_harness import GAS, Agent, RunningService, expect, problem
from stored_drive import StoredDrive

from wrongturn_protocol import Track
from wrongturn_protocol.observations import decode
from wrongturn_service import replays as replays_module
from wrongturn_service import service as service_module
from wrongturn_service.episodes.draws import Draws
from wrongturn_service.replays import PICTURE, SHEET, Replays
from wrongturn_service.web.drives import ROWS
from wrongturn_sim.ego import SUB_STEPS

FOLDER = Path(__file__).parent
WARMED = """
import asyncio, gc, sys
from pathlib import Path
from wrongturn_service.episodes.draws import Draws
from wrongturn_service.replays import Replays
from stored_drive import StoredDrive
def compiled():
    if "numba" not in sys.modules:
        return 0
    from numba.core.dispatcher import Dispatcher
    return sum(len(one.signatures) for one in gc.get_objects() if isinstance(one, Dispatcher))
async def main():
    replays = Replays(StoredDrive(), Draws(Path("unused")))
    print(compiled())
    await replays.warm_up()
    print(compiled())
    await replays.sheet("ep_1", 0)
    await replays.picture("ep_1", None)
    await replays.last_view("ep_1", None)
    print(compiled())
asyncio.run(main())
"""


def sheet(http: httpx.Client, episode: str, number: int) -> np.ndarray:
    """The pictures of a sheet, (n, 64, 192, 3)."""
    response = http.get(f"/v1/episodes/{episode}/camera/{number}")
    assert response.status_code == 200, response.text
    assert response.headers["content-type"] == "image/webp"
    pictures = cv2.imdecode(np.frombuffer(response.content, np.uint8), cv2.IMREAD_COLOR)
    return pictures[:, :, ::-1].reshape(-1, 64, 192, 3)


def test_the_sheets_show_what_the_agent_saw(seeing: Agent) -> None:
    reset = seeing.practise(fault="infeasible", weather="WetNoon")
    replies = [reset]
    while not replies[-1].get("terminated"):
        replies.append(expect(seeing.step(reset["id"], len(replies), {**GAS, "steer": 0.02}), 200))
    seen = np.stack([decode(reply["observation"], Track.SEGMENTATION)["rgb"] for reply in replies])
    sheets = [sheet(seeing.http, reset["id"], number) for number in range(-(-len(seen) // SHEET))]
    assert [len(one) for one in sheets[:-1]] == [SHEET] * (len(sheets) - 1)
    shown = np.concatenate(sheets)
    assert shown.shape == seen.shape
    # WebP changes pixels a little; a picture of another decision differs by more.
    off = np.abs(shown.astype(int)[:, None] - seen.astype(int)[None]).mean(axis=(2, 3, 4))
    assert off.diagonal().max() < 6
    assert (off.argmin(axis=1) == np.arange(len(seen))).all()
    problem(seeing.http.get(f"/v1/episodes/{reset['id']}/camera/{len(sheets)}"), 404, "unknown-episode")


def test_pictures_are_shown_to_whom_the_trajectory_is_shown(service: RunningService, agent: Agent) -> None:
    evaluation = agent.evaluate()["id"]
    scored = expect(agent.reset(evaluation), 201)["id"]
    practice = agent.practise()["id"]
    pictures = ("camera/0", "picture.png")
    for picture in pictures:
        problem(agent.http.get(f"/v1/episodes/{scored}/{picture}"), 409, "episode-not-shown")
    steps, _ = agent.drive(scored)
    agent.drive(practice)
    with httpx.Client(base_url=service.url, timeout=60) as stranger, service.agent() as other:
        for picture in pictures:
            problem(agent.http.get(f"/v1/episodes/{scored}/{picture}"), 409, "episode-not-shown")
            assert "private" in agent.http.get(f"/v1/episodes/{practice}/{picture}").headers["cache-control"]
            for episode in (scored, practice):
                problem(stranger.get(f"/v1/episodes/{episode}/{picture}"), 401, "unauthenticated")
                problem(other.http.get(f"/v1/episodes/{episode}/{picture}"), 403, "forbidden")
        assert stranger.get(f"/episodes/{scored}").status_code == 404
        assert stranger.get(f"/episodes/{scored}/drive.json").status_code == 404
        assert stranger.get(f"/episodes/{practice}").status_code == 404, "practice has no page"
        agent.http.delete(f"/v1/evaluations/{evaluation}")
        for picture in pictures:
            shown = stranger.get(f"/v1/episodes/{scored}/{picture}")
            assert "public" in shown.headers["cache-control"]
            known = {"If-None-Match": f"W/{shown.headers['etag']}"}
            assert stranger.get(f"/v1/episodes/{scored}/{picture}", headers=known).status_code == 304
        assert len(sheet(stranger, scored, 0)) == min(SHEET, steps + 1)  # some of its trials are short
        drawn = cv2.imdecode(np.frombuffer(shown.content, np.uint8), cv2.IMREAD_COLOR)
        assert drawn.shape == (PICTURE, PICTURE, 3)
        # Its twin was never driven, so the page shows one drive.
        assert stranger.get(f"/episodes/{scored}").text.count('<canvas class="map"') == 1
        plain = stranger.get(f"/episodes/{scored}/drive.json", headers={"Accept-Encoding": "identity"})
        assert "content-encoding" not in plain.headers
        assert plain.json() == stranger.get(f"/episodes/{scored}/drive.json").json()
        for path in (f"/episodes/{scored}/drive.json", f"/v1/episodes/{scored}/trajectory"):
            known = {"If-None-Match": stranger.get(path).headers["etag"]}
            assert stranger.get(path, headers=known).status_code == 304


async def test_pictures_wait_for_the_warm_up_and_other_things_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, go_on = threading.Event(), threading.Event()
    drawn: list[str] = []

    def draw_a_little() -> None:
        drawn.append("a little")
        begun.set()
        assert go_on.wait(60)
        raise RuntimeError("the pictures will say what is wrong")

    monkeypatch.setattr(replays_module, "_draw_a_little", draw_a_little)
    replays = Replays(StoredDrive(), Draws(Path("unused")))
    background = asyncio.create_task(replays.warm_up())
    await asyncio.to_thread(begun.wait, 60)
    sheets = [asyncio.create_task(replays.sheet(name, 0)) for name in ("ep_1", "ep_2", "ep_3")]
    assert await replays.made("rows", "ep_1", lambda trajectory: bytes(len(trajectory.rows))) == bytes(3)
    assert not any(task.done() for task in (background, *sheets))
    go_on.set()
    assert len(set(await asyncio.gather(*sheets))) == 1
    await background
    assert drawn == ["a little"]


async def test_a_service_warms_up_without_a_request(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn, imported = threading.Event(), []
    monkeypatch.setattr(service_module, "_WARM_UP_AFTER_S", 0.0)
    monkeypatch.setattr(service_module, "import_module", imported.append)
    monkeypatch.setattr(replays_module, "_draw_a_little", drawn.set)

    async with application(tmp_path):
        assert await asyncio.to_thread(drawn.wait, 60)
    assert imported == ["scipy.stats"]


async def test_the_first_picture_warms_up_if_nobody_has(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    monkeypatch.setattr(replays_module, "_draw_a_little", lambda: drawn.append("a little"))

    replays = Replays(StoredDrive(), Draws(Path("unused")))
    await replays.sheet("ep_1", 0)
    await replays.picture("ep_1", None)
    await replays.warm_up()
    assert drawn == ["a little"]


def test_after_the_warm_up_a_picture_compiles_nothing() -> None:
    ran = subprocess.run([sys.executable, "-c", WARMED], capture_output=True, text=True, check=True, cwd=FOLDER)
    before, warm, after = map(int, ran.stdout.split())
    assert before == 0 < warm == after
    assert "WARN" not in ran.stderr, "of OpenCV"


def test_a_page_shows_the_decisions_of_the_simulation() -> None:
    assert ROWS == SUB_STEPS
