"""How many pictures a second one core makes: RGB and segmentation, 64 x 192.

    python benchmarks/frames.py [--rounds 9] [--town Town01] [--json FILE]

Ego alone, with 20 cars in sight, in rain, and a batch of 32 egos by turns in one process, timed by the processor
time of their thread. Figures are of the median round, and of the best, which other programs on the machine spoil
least. In the same run, where they can be imported, highway-env's grayscale observation and MetaDrive's RGB camera:

    python -m venv others && others/bin/pip install highway-env metadrive-simulator
    PYTHONPATH=others/lib/python3.11/site-packages python benchmarks/frames.py
"""

import argparse
import json
import math
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from wrongturn_networks import load_town
from wrongturn_protocol import Weather
from wrongturn_sim.camera import Camera, Renderer, World, look_of, render_batch
from wrongturn_sim.camera.palette import pose_before

FRAMES = 64
"""Of each round: two of each of 32 poses."""
BATCH = 32


def poses(town_name: str) -> np.ndarray:
    """Thirty-two poses before junctions, all types, 3 to 40 m away."""
    approaches = list(load_town(town_name).approaches.values())
    return np.array([pose_before(approaches[i * 7 % len(approaches)], 3.0 + 1.2 * i) for i in range(BATCH)])


def cars_before(pose: np.ndarray) -> np.ndarray:
    """Twenty cars ahead, in both lanes."""
    x, y, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    rows = []
    for i in range(20):
        ahead, left = 8.0 + 4.5 * (i // 2 * 2), 4.0 * (i % 2)
        rows.append((x + ahead * cos - left * sin, y + ahead * sin + left * cos, yaw, 4.5, 1.8, 1.5, 0, i))
    return np.array(rows, np.float64)


def singly(town_name: str, weather: Weather, cars: bool) -> Callable[[], None]:
    """Draws each pose by a call of its own."""
    renderer = Renderer(World.of(load_town(town_name)), weather=weather, seed=1)
    places = poses(town_name)
    others = [cars_before(pose) if cars else None for pose in places]
    rgb, segmentation = np.empty((64, 192, 3), np.uint8), np.empty((64, 192), np.uint8)

    def draw() -> None:
        for tick in range(FRAMES):
            i = tick % BATCH
            renderer.render_into(*places[i], tick, others[i], rgb, segmentation)

    return draw


def together(town_name: str) -> Callable[[], None]:
    """Draws them in batches of 32."""
    world, places = World.of(load_town(town_name)), poses(town_name)
    looks = np.stack([look_of(Weather.CLEAR_NOON)] * BATCH)
    seeds = ticks = np.zeros(BATCH, np.int64)
    rgb, segmentation = np.empty((BATCH, 64, 192, 3), np.uint8), np.empty((BATCH, 64, 192), np.uint8)

    def draw() -> None:
        for _ in range(FRAMES // BATCH):
            render_batch(world, Camera(), looks, seeds, places, ticks, rgb, segmentation)

    return draw


def highway() -> Callable[[], None]:
    import gymnasium  # noqa: PLC0415
    import highway_env  # noqa: F401, PLC0415

    shape = {
        "type": "GrayscaleObservation",
        "observation_shape": (192, 64),
        "stack_size": 1,
        "weights": [0.2989, 0.5870, 0.1140],
        "scaling": 1.75,
    }
    env = gymnasium.make("highway-v0", config={"observation": shape, "offscreen_rendering": True}).unwrapped
    env.reset(seed=0)

    def draw() -> None:
        for _ in range(FRAMES):
            env.observation_type.observe()

    return draw


def metadrive() -> Callable[[], None]:
    from metadrive import MetaDriveEnv  # noqa: PLC0415
    from metadrive.component.sensors.rgb_camera import RGBCamera  # noqa: PLC0415

    env = MetaDriveEnv(
        {
            "image_observation": True,
            "image_on_cuda": False,
            "use_render": False,
            "log_level": 50,
            "sensors": {"rgb_camera": (RGBCamera, 192, 64)},
            "vehicle_config": {"image_source": "rgb_camera"},
        }
    )
    env.reset(seed=0)
    camera = env.engine.get_sensor("rgb_camera")

    def draw() -> None:
        for _ in range(FRAMES):
            env.engine.graphicsEngine.renderFrame()
            camera.perceive(to_float=False)

    return draw


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--town", default="Town01")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()

    begin = time.perf_counter()
    Renderer(World.of(load_town(options.town))).render(0.0, 0.0, 0.0)
    started = time.perf_counter() - begin
    tasks = {
        "ego alone": singly(options.town, Weather.CLEAR_NOON, False),
        "with 20 cars": singly(options.town, Weather.CLEAR_NOON, True),
        "in rain": singly(options.town, Weather.HARD_RAIN_NOON, False),
        "batch of 32": together(options.town),
    }
    absent = {}
    for name, make in (("highway-env, grayscale", highway), ("MetaDrive, RGB", metadrive)):
        try:
            tasks[name] = make()
        except Exception as error:  # what is not there, or has no screen, is told and left out
            absent[name] = f"{type(error).__name__}: {error}".splitlines()[0][:100]
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(options.rounds):
        for name, draw in tasks.items():
            begin = time.thread_time()
            draw()
            times[name].append((time.thread_time() - begin) / FRAMES)
    print(f"town, kernels and first picture after {started:.2f} s (compiled before, or not)")
    print(f"{'':24}{'median':>12}{'best':>12}   frames a second, one core")
    figures = {"start_s": started}
    for name, spent in times.items():
        median, best = 1 / statistics.median(spent), 1 / min(spent)
        figures[name] = median
        print(f"{name:24}{median:12,.0f}{best:12,.0f}")
    for name, why in absent.items():
        print(f"{name:24}   not measured: {why}")
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", "utf-8")


if __name__ == "__main__":
    main()
