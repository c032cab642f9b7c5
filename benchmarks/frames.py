"""Measure how many pictures a second one core makes (RGB and segmentation, 64 x 192), and how many steps with them.

    python benchmarks/frames.py [--rounds 9] [--town Town01] [--metadrive top-down] [--json FILE]

The tasks take turns: the ego alone, with 20 cars in sight, in rain, a batch of 32 egos, and a pitched camera. Each is
timed by the processor time of its thread. The table shows the median round and the best one, which other programs on
the machine disturb least. The bare libsumo calls of a decision, before and after, show how fast the machine was.

Other simulators run in the same rounds if they can be imported: highway-env with its grayscale observation, 192 x 64,
of 20 cars, and MetaDrive with its ``top-down`` observation (84 x 84 x 5), its ``state`` (lidar) or its ``rgb`` camera.
The observation is timed by itself and as part of ``env.step``. A decision is 0.1 s. Resets are not timed.
MetaDrive downloads models at its first start. Only ``rgb`` shows them, so the other two run without them.

    python -m venv others
    others/bin/pip install --no-deps highway-env==1.12.1 metadrive-simulator==0.4.3 panda3d==1.10.13 \\
        panda3d-gltf==0.13 panda3d-simplepbr pygame matplotlib contourpy cycler fonttools kiwisolver pyparsing pillow \\
        tqdm progressbar lxml mediapy seaborn yapf
    PYTHONPATH=others/lib/python3.11/site-packages python benchmarks/frames.py

The environment that python runs in provides the rest (Gymnasium, NumPy, SciPy, OpenCV, Shapely).
Do not set SDL_VIDEODRIVER to ``dummy``: highway-env would draw nothing and return a black picture.
"""

import math
import os
import statistics
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from common import finish, parser
from decision import measure

from wrongturn_networks import load_town
from wrongturn_protocol import Traffic, Weather
from wrongturn_sim.camera import Camera, Renderer, World, look_of, render_batch
from wrongturn_sim.camera.palette import pose_before

FRAMES = 64
"""Pictures of a round: two of each of 32 poses."""
BATCH = 32
CARS = 20
PITCH = 0.1
"""Radians; with any pitch but 0 the camera casts pixel by pixel."""

Task = Callable[[], float]
"""Runs one round and returns the seconds of a picture or of a step."""


def poses(town_name: str) -> np.ndarray:
    """Return 32 poses before junctions of all types, 3 to 40 m away."""
    approaches = list(load_town(town_name).approaches.values())
    return np.array([pose_before(approaches[i * 7 % len(approaches)], 3.0 + 1.2 * i) for i in range(BATCH)])


def cars_before(pose: np.ndarray) -> np.ndarray:
    """Return twenty cars ahead, in both lanes."""
    x, y, yaw = pose
    cos, sin = math.cos(yaw), math.sin(yaw)
    rows = []
    for i in range(CARS):
        ahead, left = 8.0 + 4.5 * (i // 2 * 2), 4.0 * (i % 2)
        rows.append((x + ahead * cos - left * sin, y + ahead * sin + left * cos, yaw, 4.5, 1.8, 1.5, 0, i))
    return np.array(rows, np.float64)


def repeated(draw: Callable[[int], object], count: int = FRAMES) -> Task:
    """Return a task that calls with 0, 1, ... and times all calls together."""

    def run() -> float:
        begin = time.thread_time()
        for i in range(count):
            draw(i)
        return (time.thread_time() - begin) / count

    return run


def stepping(env: gymnasium.Env[Any, Any], action: Any) -> Task:
    """Return a task that repeats one action; resets are not timed."""

    def run() -> float:
        env.reset(seed=0)
        spent = 0.0
        for _ in range(FRAMES):
            begin = time.thread_time()
            _, _, terminated, truncated, _ = env.step(action)
            spent += time.thread_time() - begin
            if terminated or truncated:
                env.reset(seed=0)
        return spent / FRAMES

    return run


def singly(town_name: str, weather: Weather, cars: bool = False, pitch: float = 0.0) -> Task:
    """Return a task that draws each pose with its own call."""
    renderer = Renderer(World.of(load_town(town_name)), Camera(pitch=pitch), weather=weather, seed=1)
    places = poses(town_name)
    others = [cars_before(pose) if cars else None for pose in places]

    def draw(tick: int) -> None:
        i = tick % BATCH
        renderer.render(*places[i], tick, others[i])

    return repeated(draw, BATCH if pitch else FRAMES)


def together(town_name: str) -> Task:
    """Return a task that draws the poses in batches of 32."""
    world, places = World.of(load_town(town_name)), poses(town_name)
    looks = np.stack([look_of(Weather.CLEAR_NOON)] * BATCH)
    seeds = ticks = np.zeros(BATCH, np.int64)
    rgb, segmentation = np.empty((BATCH, 64, 192, 3), np.uint8), np.empty((BATCH, 64, 192), np.uint8)
    rounds = repeated(
        lambda _: render_batch(world, Camera(), looks, seeds, places, ticks, rgb, segmentation), FRAMES // BATCH
    )
    return lambda: rounds() / BATCH


def driving(town_name: str) -> dict[str, Task]:
    """Return the task that steps our environment with pictures."""
    env = gymnasium.make(
        "wrongturn_sim:WrongturnSim-v0", town=town_name, track="segmentation", traffic={"vehicles": CARS}
    ).unwrapped
    return {"step, camera, 20 cars": stepping(env, np.array([0.0, 0.3, 0.0], np.float32))}


def highway() -> dict[str, Task]:
    import highway_env  # noqa: F401, PLC0415

    if os.environ.get("SDL_VIDEODRIVER") == "dummy":
        raise RuntimeError("draws nothing where SDL_VIDEODRIVER is dummy; unset it")
    observation = {
        "type": "GrayscaleObservation",
        "observation_shape": (192, 64),
        "stack_size": 1,
        "weights": [0.2989, 0.5870, 0.1140],
        "scaling": 1.75,
    }
    config = {
        "observation": observation,
        "offscreen_rendering": True,
        "vehicles_count": CARS,
        "simulation_frequency": 20,
        "policy_frequency": 10,
    }
    env: Any = gymnasium.make("highway-v0", config=config).unwrapped
    picture, _ = env.reset(seed=0)
    if picture.min() == picture.max():
        raise RuntimeError("shows an empty picture")
    idle = 1
    return {
        "highway-env, grayscale": repeated(lambda _: env.observation_type.observe()),
        "step, highway-env": stepping(env, idle),
    }


def metadrive(kind: str) -> dict[str, Task]:
    from metadrive import MetaDriveEnv  # noqa: PLC0415
    from metadrive.component.sensors.rgb_camera import RGBCamera  # noqa: PLC0415
    from metadrive.engine.base_engine import BaseEngine  # noqa: PLC0415
    from metadrive.envs.top_down_env import TopDownMetaDrive  # noqa: PLC0415

    config: dict[str, Any] = {"use_render": False, "log_level": 50}
    if kind == "rgb":
        config |= {
            "image_observation": True,
            "image_on_cuda": False,
            "sensors": {"rgb_camera": (RGBCamera, 192, 64)},
            "vehicle_config": {"image_source": "rgb_camera"},
        }
    else:
        BaseEngine.try_pull_asset = staticmethod(lambda: None)
    env = (TopDownMetaDrive if kind == "top-down" else MetaDriveEnv)(config)
    picture, _ = env.reset(seed=0)
    if isinstance(picture, np.ndarray) and picture.min() == picture.max():
        raise RuntimeError("shows an empty picture")
    return {
        f"MetaDrive, {kind}": repeated(lambda _: next(iter(env.observations.values())).observe(env.agent)),
        f"step, MetaDrive, {kind}": stepping(env, [0.0, 0.3]),
    }


def main() -> None:
    options_of = parser(__doc__)
    options_of.add_argument("--rounds", type=int, default=9)
    options_of.add_argument("--town", default="Town01")
    options_of.add_argument("--metadrive", choices=("top-down", "state", "rgb"), default="top-down")
    options = options_of.parse_args()
    rounds = 1 if options.short else options.rounds

    begin = time.perf_counter()
    Renderer(World.of(load_town(options.town))).render(0.0, 0.0, 0.0)
    started = time.perf_counter() - begin
    bare = [measure("junctions", 20, Traffic())["bare_us"]]
    tasks = {
        "ego alone": singly(options.town, Weather.CLEAR_NOON),
        "with 20 cars": singly(options.town, Weather.CLEAR_NOON, cars=True),
        "in rain": singly(options.town, Weather.HARD_RAIN_NOON),
        "batch of 32": together(options.town),
        "pitched": singly(options.town, Weather.CLEAR_NOON, pitch=PITCH),
        **driving(options.town),
    }
    absent = {}
    for name, make in (("highway-env", highway), ("MetaDrive", lambda: metadrive(options.metadrive))):
        try:
            tasks |= make()
        except Exception as error:  # what is missing or has no screen is reported and left out
            absent[name] = f"{type(error).__name__}: {error}".splitlines()[0][:100]
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(rounds):
        for name, run in tasks.items():
            times[name].append(run())
    bare.append(measure("junctions", 20, Traffic())["bare_us"])
    print(f"town, kernels and first picture after {started:.2f} s (compiled before, or not)")
    print(f"bare libsumo calls of a decision: {bare[0]:.0f} us before, {bare[1]:.0f} us after")
    print(f"{'':28}{'median':>10}{'best':>10}{'of ours':>10}   a second, one core; the median of the rounds' ratios")
    figures = {"start_s": started, "bare_before_us": bare[0], "bare_after_us": bare[1]}
    for name, spent in times.items():
        ours = times["step, camera, 20 cars" if name.startswith("step") else "with 20 cars"]
        ratio = statistics.median(one / other for one, other in zip(ours, spent, strict=True))
        figures[name] = 1 / statistics.median(spent)
        print(f"{name:28}{figures[name]:10,.0f}{1 / min(spent):10,.0f}{ratio:10.3f}")
    for name, why in absent.items():
        print(f"{name:28}not measured: {why}")
    finish(figures, options)


if __name__ == "__main__":
    main()
