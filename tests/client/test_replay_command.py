"""``wrongturn replay``: where its episode comes from. What it draws is tested with the simulation."""

import gzip
import json
from pathlib import Path
from typing import Any

import cv2
import httpx
import pytest
from typer.testing import CliRunner, Result

from wrongturn_client import Client, WrongturnError, cli, plugins, replayed
from wrongturn_networks import draw_trial, load_town
from wrongturn_protocol import FaultKind, Track
from wrongturn_protocol.installing import install
from wrongturn_protocol.run_file import RunFormatError
from wrongturn_sim import Episode

JSON = {"Content-Type": "application/json"}
COUNT = {"count": 0, "trials": 2, "rate": 0.0, "ci95": [0.0, 1.0]}
METRICS = {
    "unsafe": COUNT,
    "unsafe_strict": COUNT,
    "twins": {"unsafe": 0, "completed": 0, "trials": 1},
    "excess_unsafe_rate": None,
    "table": {},
    "reactions": {},
    "verdicts": {},
}


@pytest.fixture(scope="module")
def driven() -> Episode:
    town = load_town("junctions")
    episode = Episode(draw_trial(town, min(town.approaches), FaultKind.NONE, 1), Track.STATE)
    episode.reset()
    for _ in range(5):
        episode.step(0.0, 0.5, 0.0)
    episode.abort()
    return episode


@pytest.fixture(scope="module")
def run(driven: Episode) -> dict[str, Any]:
    """The file of ``run --json`` with two episodes, the second without a trajectory."""
    assert driven.outcome is not None
    trial = driven.trial.id
    one = {
        "id": "e1",
        "trial": trial,
        "outcome": driven.outcome.model_dump(mode="json"),
        "trajectory": json.loads(driven.trajectory.to_json()),
    }
    driver = {"id": "a1", "name": "me", "track": "state", "kind": "submitted"}
    return {
        "id": "v1",
        "agent": "a1",
        "suite": "smoke@3",
        "state": "finished",
        "trials": 2,
        "finished": 2,
        "max_parallel": 1,
        "suite_sha256": "0" * 64,
        "metrics": METRICS,
        "driver": driver,
        "episodes": [one, {**one, "id": "e2", "trial": "other", "trajectory": None}],
    }


def replay(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli.app, ["replay", *map(str, arguments)], env={"WRONGTURN_URL": ""})


def refused(*arguments: str | Path) -> str:
    done = replay(*arguments)
    assert isinstance(done.exception, WrongturnError | RunFormatError), done.output
    return str(done.exception)


def test_a_trajectory_becomes_a_picture(driven, tmp_path):
    file = tmp_path / "trajectory.json"
    file.write_bytes(driven.trajectory.to_json())
    done = replay(file, "--picture", tmp_path / "p.png", "--size", 200)
    assert done.exit_code == 0, done.output
    assert driven.trial.id in done.output
    assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["run.json", "run.json.gz"])
@pytest.mark.parametrize("chosen", ["e1", "its trial"])
def test_an_episode_of_a_run_becomes_a_film(driven, run, tmp_path, name, chosen):
    data = json.dumps(run).encode()
    (tmp_path / name).write_bytes(gzip.compress(data) if name.endswith("gz") else data)
    episode = driven.trial.id if chosen == "its trial" else chosen
    film = tmp_path / "f.mp4"
    done = replay(tmp_path / name, "--episode", episode, "--view", "top", "--video", film, "--size", 160)
    assert done.exit_code == 0, done.output
    assert "aborted, 18 frames, 1.8 s" in done.output.replace("\n", "")
    assert film.stat().st_size > 1000


def test_a_twin_is_shown_beside_its_trial(driven, run, tmp_path):
    name = driven.trial.id.replace(".none.", ".omission.")
    faulty = {**run["episodes"][0], "id": "e3", "trial": name}
    faulty["trajectory"] = {**faulty["trajectory"], "trial": name, "fault": {"kind": "omission"}}
    file, film = tmp_path / "run.json", ("--video", tmp_path / "f.webp", "--size", 160, "--view", "top")
    file.write_text(json.dumps({**run, "episodes": [*run["episodes"], faulty]}))
    done = replay(file, "--episode", "e3", "--twin", *film)
    assert done.exit_code == 0, done.output
    assert cv2.imreadanimation(str(film[1]))[1].frames[0].shape[1] == 320
    assert "only trials with a fault have one" in refused(file, "--episode", "e1", "--twin", *film)
    assert "give --video FILE.mp4 too" in refused(file, "--twin", "--picture", tmp_path / "p.png")
    file.write_bytes(driven.trajectory.to_json())
    assert "is a single trajectory" in refused(file, "--twin", *film)


def test_an_episode_of_a_service_becomes_a_picture(driven, tmp_path, monkeypatch):
    def answer(request: httpx.Request) -> httpx.Response:
        if request.url.path == "/v1/episodes/e1/trajectory":
            return httpx.Response(
                200, content=driven.trajectory.to_json(), headers={"Content-Type": "application/json"}
            )
        if request.url.path == "/v1/episodes/e1":
            outcome = driven.outcome.model_dump(mode="json")
            return httpx.Response(200, json={"id": "e1", "state": "finished", "seq": 5, "outcome": outcome})
        return httpx.Response(
            404, json={"type": "unknown-episode", "title": "no", "status": 404, "detail": "no such episode"}
        )

    def client(url: str, **options: Any) -> Client:
        return Client(url, transport=httpx.MockTransport(answer), **options)

    monkeypatch.setattr(replayed, "Client", client)
    done = replay("e1", "--url", "http://fake", "--picture", tmp_path / "p.png", "--size", 200)
    assert done.exit_code == 0, done.output
    assert "aborted" in done.output
    assert "no such episode" in refused("e2", "--picture", tmp_path / "p.png")


def test_what_is_missing_or_broken_is_named(run, tmp_path, monkeypatch):
    picture = ("--picture", tmp_path / "p.png")
    file = tmp_path / "run.json"
    file.write_text(json.dumps(run))
    assert "give --video FILE.mp4, --picture FILE.png, or both" in refused(file)
    assert "has 2 such episodes" in refused(file, *picture)
    assert "has no episode 'e3'; it has" in refused(file, *picture, "--episode", "e3")
    assert "ended without a trajectory" in refused(file, *picture, "--episode", "e2")
    assert "there is no such file" in refused(tmp_path / "none.json", *picture)
    assert "leave it out" in refused("e1", *picture, "--episode", "e1")
    for content, said in (("{}", "is neither"), ("[]", "is neither"), ("{", "not JSON"), ("[" * 200_000, "not JSON")):
        file.write_text(content)
        assert said in refused(file, *picture)
    file.write_text(json.dumps({**run, "trials": "many"}))
    assert "trials" in refused(file, *picture)
    packed = tmp_path / "run.json.gz"
    packed.write_bytes(gzip.compress(b"{}" * 99)[:-9])
    assert "cannot be read" in refused(packed, *picture)
    assert "cannot be read" in refused(tmp_path, *picture)
    monkeypatch.setattr(plugins, "entry_points", lambda group: {})
    assert install("wrongturn-service") in refused(file, *picture)


def test_a_picture_that_cannot_be_written_is_named(driven, tmp_path):
    file = tmp_path / "trajectory.json"
    file.write_bytes(driven.trajectory.to_json())
    done = replay(file, "--picture", tmp_path / "p.gif")
    assert "give a name that ends in .png" in str(done.exception)
    done = replay(file, "--picture", tmp_path / "none" / "p.png")
    assert "cannot be written" in str(done.exception)
