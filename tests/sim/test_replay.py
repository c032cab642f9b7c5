"""Replays: the camera's bytes, pictures and films of episodes that were driven."""

import dataclasses
import json

import av
import cv2
import numpy as np
import pytest

from wrongturn_networks import load_town
from wrongturn_protocol import FaultKind, JunctionType, Track, Traffic, Verdict, View, Weather
from wrongturn_protocol.words import name
from wrongturn_sim import Episode, Trajectory, TrajectoryError
from wrongturn_sim.errors import FilmError, ViewError
from wrongturn_sim.replay import Replay
from wrongturn_sim.view import colours
from wrongturn_sim.view.film import FRAMES_A_SECOND, LAST, write_film
from wrongturn_sim.view.scene import fastest_of, whole_window
from wrongturn_sim.view.shown import show

HELD = round(LAST * FRAMES_A_SECOND)
"""Frames for which a film of ten frames a second stays at its end."""


@pytest.fixture(scope="module")
def left(make_trial, drive):
    """A replay of a car that drives off the road: it goes straight on where there is no such exit."""
    town = load_town("junctions")
    approach = next(a.id for a in town.approaches.values() if a.type is JunctionType.LEFT_RIGHT)
    episode = Episode(make_trial(approach, FaultKind.INFEASIBLE, 3), Track.STATE)
    episode.reset()
    while episode.outcome is None:
        episode.step(0.0, 0.6, 0.0)
    assert episode.outcome.verdict in {Verdict.OFF_ROAD, Verdict.COLLISION}
    return Replay.from_json(episode.trajectory.to_json(), episode.outcome)


class TestCamera:
    @pytest.mark.parametrize("weather", [Weather.CLEAR_NOON, Weather.HARD_RAIN_NOON, Weather.SOFT_RAIN_SUNSET])
    @pytest.mark.parametrize("traffic", [Traffic(), Traffic(vehicles=20, pedestrians=20)], ids=["alone", "traffic"])
    def test_it_sees_what_the_agent_saw_byte_for_byte(self, make_trial, weather, traffic):
        episode = Episode(make_trial(weather=weather, traffic=traffic, seed=5), Track.SEGMENTATION)
        seen = [episode.reset()]
        while episode.outcome is None and len(seen) < 25:
            seen.append(episode.step(0.1, 0.7, 0.0).observation)
        replay = Replay.from_json(episode.trajectory.to_json())
        assert len(replay) == len(seen)
        for decision, observation in enumerate(seen):
            rgb, segmentation = replay.camera(decision)
            assert rgb.tobytes() == observation["rgb"].tobytes()
            assert segmentation.tobytes() == observation["segmentation"].tobytes()
        if traffic.vehicles:
            # A test of traffic shows some.
            assert np.isin(np.stack([o["segmentation"] for o in seen]), [9, 10, 7, 8]).any()
            assert replay.trajectory.road_user_numbers
            assert replay.notes == ()

    def test_the_last_picture_of_a_step_that_ended_early_is_the_agents(self, left):
        trial = left.trajectory.trial
        episode = Episode(trial, Track.CAMERA)
        episode.reset()
        while episode.outcome is None:
            observation = episode.step(0.0, 0.6, 0.0).observation
        assert np.array_equal(left.camera(len(left) - 1)[0], observation["rgb"])

    def test_an_old_trajectory_with_traffic_is_drawn_with_a_guess_and_says_so(self, make_trial):
        episode = Episode(make_trial(traffic=Traffic(vehicles=20, pedestrians=20)), Track.STATE)
        episode.reset()
        message = json.loads(episode.trajectory.to_json())
        numbers, appearances = message.pop("road_user_numbers"), message.pop("appearances")
        old = json.dumps(message, separators=(",", ":"))
        replay = Replay.from_json(old)
        assert replay.trajectory.to_json() == old.encode(), "its checksum stays"
        assert "guesses" in replay.notes[0]
        assert replay.camera(0)[0].any()
        message |= {"appearances": appearances, "road_user_numbers": [*numbers[:-1], []]}
        with pytest.raises(TrajectoryError, match="road_user_numbers"):
            Replay.from_json(json.dumps(message))

    def test_a_decision_that_does_not_exist_is_named(self, left):
        with pytest.raises(IndexError, match=f"{len(left)} is not one of 0 to {len(left) - 1}"):
            left.camera(len(left))


class TestPicture:
    def test_the_car_is_where_the_trajectory_says(self, left):
        for decision in (0, len(left) // 2, len(left) - 2):
            row, image = left.row(decision), left.top(decision, 400)
            window = whole_window(left.town, left.trajectory.rows, left.trajectory.trial.approach, 400)
            ahead = (row.x + 1.7 * np.cos(row.yaw), row.y + 1.7 * np.sin(row.yaw))
            behind = (row.x - 1.5 * np.cos(row.yaw), row.y - 1.5 * np.sin(row.yaw))
            for place in (ahead, behind):
                u, v = window.pixels(np.array([place]))[0].round().astype(int)
                assert tuple(image[v, u].tolist()) == colours.CAR

    def test_the_whole_way_is_coloured_by_speed(self, left):
        image = left.picture(600)
        assert image.shape == (600, 600, 3)
        rows = left.trajectory.rows
        window = whole_window(left.town, rows, left.trajectory.trial.approach, 600)
        found = 0
        for row in rows[10:-60:10]:
            u, v = window.pixels(np.array([(row.x, row.y)]))[0].round().astype(int)
            colour = np.array(colours.of_speed(row.v, fastest_of(rows)))
            found += bool(np.abs(image[v - 1 : v + 2, u - 1 : u + 2].astype(int) - colour).sum(-1).min() < 30)
        assert found >= len(rows[10:-60:10]) - 2, "a label may hide a place"

    def test_the_verdict_is_shown_at_its_moment_only(self, left):
        unsafe = np.array([184, 67, 11])
        shown = [(left.top(decision, 400)[:400] == unsafe).all(-1).sum() for decision in (len(left) - 2, len(left) - 1)]
        assert shown[0] == 0
        assert shown[1] > 50

    def test_beside_the_view_from_above_stands_the_cameras_picture(self, left):
        image = left.both(4, 480)
        assert image.shape == (480, 864, 3)
        assert np.array_equal(image[:128:2, 480::2], left.camera(4)[0])

    def test_a_size_that_cannot_be_is_refused(self, left):
        for size in (0, 5000):
            with pytest.raises(ViewError, match=f"size: is {size}; give pixels, 160 to 2160"):
                left.picture(size)


class TestFilm:
    @pytest.mark.parametrize("view", View)
    def test_it_has_a_frame_for_each_decision_and_stays_at_its_end(self, left, tmp_path, view):
        file = tmp_path / "film.mp4"
        assert left.video(file, view, 160) == len(left) + HELD
        with av.open(str(file)) as film:
            stream = film.streams.video[0]
            assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
            assert stream.width % 2 == stream.height % 2 == 0
            frames = list(film.decode(stream))
        assert len(frames) == len(left) + HELD
        assert frames[-1].time == pytest.approx((len(frames) - 1) / FRAMES_A_SECOND)
        expected = list(left.frames(view, 160))[3]
        assert np.abs(frames[3].to_ndarray(format="rgb24").astype(int) - expected).mean() < 10

    def test_a_webp_is_animated_and_the_bytes_are_always_the_same(self, left, tmp_path):
        files = [tmp_path / "a.webp", tmp_path / "b.webp"]
        for file in files:
            left.video(file, "top", 160)
        assert files[0].read_bytes() == files[1].read_bytes()
        read, animation = cv2.imreadanimation(str(files[0]))
        assert read
        assert sum(animation.durations) == pytest.approx(100 * (len(left) + HELD), abs=100)

    def test_a_part_shows_the_way_from_there_on_and_ends_with_the_verdict(self, left):
        first = len(left) - 12
        whole, part = list(left.frames("top", 160)), list(left.frames("top", 160, first=first, every=2))
        assert len(part) == len(range(first, len(left) - 1, 2)) + 1
        assert not np.array_equal(part[-1], whole[-1]), "the window is another one"
        assert np.array_equal(part[-1][160:], whole[-1][160:]), "the words are the same"
        with pytest.raises(IndexError, match=f"{len(left)} is not one of"):
            left.frames("top", 160, first=len(left))

    def test_a_small_film_is_smaller(self, left, tmp_path):
        pictures = list(left.frames("both", 160, every=4))
        assert write_film(tmp_path / "film.webp", pictures, rate=5) == len(pictures) + round(5 * LAST)
        write_film(tmp_path / "small.webp", pictures, rate=5, small=True)
        assert (tmp_path / "small.webp").stat().st_size < (tmp_path / "film.webp").stat().st_size

    def test_a_name_that_is_no_film_and_a_folder_that_is_not_there_are_named(self, left, tmp_path):
        with pytest.raises(FilmError, match=r"'film.avi' is not a film; give a name that ends in .mp4 or .webp"):
            left.video(tmp_path / "film.avi")
        with pytest.raises(FilmError, match=r"none/film.mp4 cannot be written \(No such file or directory\)"):
            left.video(tmp_path / "none" / "film.mp4", "top", 160)
        with pytest.raises(ViewError, match="view: 'side' is not known; take top, camera, both"):
            left.video(tmp_path / "film.mp4", "side")
        assert not list(tmp_path.iterdir())

    def test_the_car_drives_up_and_the_agents_name_is_shown(self, make_trial):
        town = load_town("junctions")
        approach = next(one for one in town.approaches.values() if abs(np.sin(one.heading)) < 0.5)
        episode = Episode(make_trial(approach.id), Track.STATE)
        episode.reset()
        for _ in range(20):
            episode.step(0.0, 0.6, 0.0)
        first, *_, last = Replay(episode.trajectory).frames("top", 400)
        named = next(Replay(episode.trajectory, None, "me").frames("top", 400))
        assert not np.array_equal(first[:60], named[:60])
        assert np.array_equal(first[60:], named[60:])
        before, after = (np.argwhere((image == colours.CAR).all(-1)).mean(axis=0) for image in (first, last))
        assert after[0] < before[0] - 20
        assert after[1] == pytest.approx(before[1], abs=15)

    def test_a_twin_drives_on_the_right_and_the_shorter_film_stays_at_its_end(self, left, tmp_path):
        short = Replay(dataclasses.replace(left.trajectory, rows=left.trajectory.rows[:21]))
        assert left.video(tmp_path / "film.mp4", "top", 160, short) == len(left) + HELD
        with av.open(str(tmp_path / "film.mp4")) as film:
            last = list(film.decode(video=0))[-1].to_ndarray(format="rgb24").astype(int)
        assert last.shape[1] == 320
        assert np.abs(last[:, 160:] - list(short.frames("top", 160))[-1]).mean() < 10

    def test_on_a_long_way_the_window_follows_the_car(self, left):
        rows = left.trajectory.rows
        long = [row._replace(x=row.x + 2.0 * k) for k, row in enumerate(rows * 6)]
        replay = Replay(Trajectory(left.trajectory.trial, left.trajectory.town_sha256, long))
        middle = replay.top(len(replay) // 2, 200)[:200]
        assert (middle[80:120, 80:120] == colours.CAR).all(-1).any()
        end = replay.top(len(replay) - 1, 200)[:200]  # beyond the town's last road
        assert (end[80:120, 80:120] == colours.CAR).all(-1).any()


class TestShown:
    def test_it_says_what_it_made(self, left, tmp_path):
        files = {"video": tmp_path / "f.mp4", "picture": tmp_path / "p.png"}
        lines = show(left.trajectory.to_json(), left.outcome, view=View.TOP, size=160, **files)
        assert f"{left.trajectory.trial.id}, {name(left.outcome.verdict)}" in lines[0]
        assert f"{len(left) + HELD} frames" in lines[1]
        assert np.array_equal(cv2.imread(str(tmp_path / "p.png"))[:, :, ::-1], left.picture(160))

    @pytest.mark.parametrize(
        ("change", "said"),
        [*(({"x": bad}, "columns of equal length") for bad in ([], ["a", "b"])), ({"town": "Nowhere"}, "Nowhere")],
    )
    def test_a_broken_trajectory_is_refused(self, left, tmp_path, change, said):
        message = json.loads(left.trajectory.to_json()) | change
        with pytest.raises(Exception, match=said) as refused:
            show(json.dumps(message).encode(), None, picture=tmp_path / "p.png")
        assert type(refused.value).__module__.startswith("wrongturn_")

    @pytest.mark.parametrize("value", ["a", None, [1]])
    def test_a_value_that_is_no_number_is_named(self, left, tmp_path, value):
        message = json.loads(left.trajectory.to_json())
        message["yaw"][3] = value
        with pytest.raises(TrajectoryError, match=r"trajectory.yaw: not all values are finite numbers"):
            show(json.dumps(message).encode(), None, picture=tmp_path / "p.png")

    def test_without_rows_there_is_nothing_to_draw(self, left):
        with pytest.raises(TrajectoryError, match="has no rows"):
            Replay(Trajectory(left.trajectory.trial, left.trajectory.town_sha256))
