"""Pictures are the same however they are made, and errors are clear."""

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from wrongturn_networks import read_town
from wrongturn_protocol import Weather
from wrongturn_sim.camera import LOOKS, Camera, CameraError, Renderer, UnknownWeatherError, World, look_of, render_batch

SCRIPT = """
import hashlib, sys
from wrongturn_networks import load_town
from wrongturn_sim.camera import Renderer, World
town = load_town("junctions")
digest = hashlib.sha256()
for weather in ("ClearNoon", "HardRainNoon", "ClearSunset"):
    for image in Renderer(World.of(town), weather=weather, seed=5).render(-40.0, -2.0, 0.02, 3):
        digest.update(image.tobytes())
print(digest.hexdigest())
"""


def poses_of(town, before, count):
    approaches = list(town.approaches.values())
    return np.array([before(approaches[i % len(approaches)], 3.0 * i) for i in range(count)])


def test_the_same_in_another_process_and_as_ever():
    """Golden: if pictures change, it must be on purpose and stand in the change log."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == GOLDEN


GOLDEN = "a00e59cc8d7471cbc75ede3929059f1b7810eb8e87415a4162e1e480ad05a3dc"


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_a_batch_is_what_each_sees_alone(world, town, before, threads):
    poses = poses_of(town, before, 12)
    weathers = [list(Weather)[i % 6] for i in range(12)]
    seeds = np.arange(12) * 2**40 + 7
    ticks = np.arange(12) * 3
    rgb, segmentation = np.empty((12, 64, 192, 3), np.uint8), np.empty((12, 64, 192), np.uint8)
    looks = np.stack([look_of(weather) for weather in weathers])
    render_batch(world, Camera(), looks, seeds, poses, ticks, rgb, segmentation, threads)
    for i in range(12):
        alone = Renderer(world, weather=weathers[i], seed=int(seeds[i])).render(*poses[i], int(ticks[i]))
        assert np.array_equal(rgb[i], alone[0])
        assert np.array_equal(segmentation[i], alone[1])


def test_weathers_differ_and_classes_do_not(world, town, before):
    pose = before(next(iter(town.approaches.values())), 15.0)
    pictures = {weather: Renderer(world, weather=weather).render(*pose) for weather in Weather}
    assert set(LOOKS) == set(Weather)
    assert len({picture[0].tobytes() for picture in pictures.values()}) == 6
    assert len({picture[1].tobytes() for picture in pictures.values()}) == 1
    means = [picture[0].mean((0, 1)) for picture in pictures.values()]
    for i in range(6):
        for j in range(i):
            assert np.abs(means[i] - means[j]).max() > 4.0


def test_rain_falls_by_seed_and_tick_and_only_rain_does(world, town, before):
    pose = before(next(iter(town.approaches.values())), 15.0)

    def picture(weather, seed, tick):
        return Renderer(world, weather=weather, seed=seed).render(*pose, tick)[0].tobytes()

    assert len({picture("HardRainNoon", seed, tick) for seed in (1, 2) for tick in (1, 2)}) == 4
    assert len({picture("ClearNoon", seed, tick) for seed in (1, 2) for tick in (1, 2)}) == 1
    assert picture("HardRainNoon", 2**62 + 1, 1) == picture("HardRainNoon", 2**62 + 1, 1)


def test_textures_stick_to_the_world(bare):
    """A small move changes the picture a little: nothing flickers."""
    renderer = Renderer(bare)
    last = renderer.render(-60.0, -2.0, 0.0)[0].astype(int)
    for step in range(1, 20):
        now = renderer.render(-60.0 + 0.01 * step, -2.0, 0.0)[0].astype(int)
        assert np.abs(now - last).mean() < 4.0
        last = now


def test_unknown_weathers_are_named(world):
    with pytest.raises(UnknownWeatherError, match=r"Sunny.*ClearNoon"):
        Renderer(world, weather="Sunny")


def test_far_outside_the_town_there_is_grass(world):
    for pose in ((5000.0, -7000.0, 1.0), (-1e6, 1e6, 0.0)):
        _, segmentation = Renderer(world).render(*pose)
        assert set(np.unique(segmentation)) == {4, 10}


@pytest.mark.parametrize("pose", [(np.nan, 0.0, 0.0), (0.0, np.inf, 0.0), (1e9, 0.0, 0.0)])
def test_a_pose_must_be_finite(world, pose):
    with pytest.raises(CameraError, match="pose"):
        Renderer(world).render(*pose)


def test_arrays_must_fit(world):
    renderer = Renderer(world)
    segmentation = np.empty((64, 192), np.uint8)
    with pytest.raises(CameraError, match="others"):
        renderer.render(0.0, 0.0, 0.0, 0, np.zeros((1, 5)))
    with pytest.raises(CameraError, match="length"):
        renderer.render(0.0, 0.0, 0.0, 0, np.zeros((1, 8)))
    with pytest.raises(CameraError, match="seed"):
        Renderer(world, seed=1.5)
    looks, poses = look_of("ClearNoon")[None], np.zeros((1, 3))
    rgb = np.empty((1, 64, 192, 3), np.uint8)
    with pytest.raises(CameraError, match="rgb"):
        render_batch(world, Camera(), looks, [0], poses, [0], rgb[:, :32], segmentation[None])
    with pytest.raises(CameraError, match="looks"):
        render_batch(world, Camera(), looks[:, :5], [0], poses, [0], rgb, segmentation[None])
    with pytest.raises(CameraError, match="threads"):
        render_batch(world, Camera(), looks, [0], poses, [0], rgb, segmentation[None], 0)
    with pytest.raises(CameraError, match="seeds"):
        render_batch(world, Camera(), looks, [0, 1], poses, [0], rgb, segmentation[None])


def test_many_road_users_fit(world):
    others = np.array([[10.0 * i - 60, 3.0, 0.0, 4.5, 1.8, 1.5, i % 2, i] for i in range(1, 60)], np.float64)
    renderer = Renderer(world)
    several = renderer.render(-70.0, -2.0, 0.0, 0, others)
    again = Renderer(world).render(-70.0, -2.0, 0.0, 0, others)
    assert hashlib.sha256(several[0]).digest() == hashlib.sha256(again[0]).digest()
    assert (several[1] == 7).any()
    assert (renderer.render(-70.0, -2.0, 0.0)[1] != 7).all()


def test_a_ground_is_kept_and_a_broken_copy_made_again(town, tmp_path, monkeypatch):
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path))
    made = World.of(read_town(town.directory))
    (file,) = (tmp_path / "camera").glob("*.npz")
    assert town.sha256 in file.name
    assert np.array_equal(World.of(read_town(town.directory)).ground, made.ground)
    for broken in (b"", b"no archive", file.read_bytes()[:1000], file.read_bytes()[:-2000] + bytes(2000)):
        file.write_bytes(broken)
        assert np.array_equal(World.of(read_town(town.directory)).ground, made.ground)
    assert not made.ground.flags.writeable
    file.unlink()
    file.parent.rmdir()
    tmp_path.chmod(0o500)
    try:
        assert np.array_equal(World.of(read_town(town.directory)).ground, made.ground)
    finally:
        tmp_path.chmod(0o700)
