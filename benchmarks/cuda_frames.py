"""Measure how many pictures a second a GPU makes, and whether they equal the CPU's: RGB and segmentation, 64 x 192.

    python benchmarks/cuda_frames.py [--towns Town01 Town02] [--poses 64] [--variants] [--json FILE]

First it compares pictures from poses along the lanes of each town, off the middle and turned, in each of six weathers:
the share of pixels whose class differs from the CPU's, the share whose colours differ by more than 1, and the largest
difference. Then it measures pictures a second of 256, 512 and 2,048 egos in one call, with all weathers, and steps of
the vectorised environment that cruises through Town01. ``--variants`` also times the main kernel with fewer registers
and other blocks.
"""

import json
import math
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from common import finish, parser

from wrongturn_networks import load_town
from wrongturn_protocol import Weather
from wrongturn_sim.camera import Camera, World, cuda_kernels, look_of, render_batch
from wrongturn_sim.camera import cuda as cuda_camera
from wrongturn_sim.camera.cuda import CudaRenderer
from wrongturn_sim.fleet.vector_env import WrongturnVectorEnv

cuda: Any = cuda_kernels.cuda
LOOKS = np.array([look_of(weather) for weather in Weather])


def poses(town_name: str, count: int, seed: int = 1) -> np.ndarray:
    """Return poses on lanes, some metres off the middle and turned."""
    random = np.random.default_rng(seed)
    lanes = list(load_town(town_name).lanes.values())
    rows = []
    for _ in range(count):
        line = np.asarray(lanes[random.integers(len(lanes))].centreline)
        k = int(random.integers(len(line) - 1))
        (x, y), (to_x, to_y) = line[k, :2], line[k + 1, :2]
        part = random.random()
        aside = random.normal(0.0, 1.0)
        heading = math.atan2(to_y - y, to_x - x)
        rows.append(
            (
                x + part * (to_x - x) - aside * math.sin(heading),
                y + part * (to_y - y) + aside * math.cos(heading),
                heading + random.normal(0.0, 0.5),
            )
        )
    return np.array(rows)


def equality(town_name: str, count: int, camera: Camera) -> dict[str, float]:
    world, places = World.of(load_town(town_name)), poses(town_name, count)
    number = count * len(LOOKS)
    places = np.repeat(places, len(LOOKS), axis=0)
    looks, ticks = np.tile(LOOKS, (count, 1)), np.arange(number)
    seeds = ticks * 7 + 3
    rgb = np.empty((number, camera.height, camera.width, 3), np.uint8)
    segmentation = np.empty(rgb.shape[:3], np.uint8)
    render_batch(world, camera, looks, seeds, places, ticks, rgb, segmentation, threads=8)
    renderer = CudaRenderer(world, camera, number)
    begin = time.perf_counter()
    renderer.render(looks, seeds, places, ticks)
    cuda.synchronize()
    first = time.perf_counter() - begin
    classes = np.asarray(renderer.segmentation) != segmentation
    off = np.abs(np.asarray(renderer.rgb).astype(np.int16) - rgb).max(axis=3)
    return {
        "pictures": number,
        "first_call_s": first,
        "other_class_pixels": int(classes.sum()),
        "other_class_share": float(classes.mean()),
        "pictures_with_another_class": int(classes.any(axis=(1, 2)).sum()),
        "rgb_off_by_any_share": float((off > 0).mean()),
        "rgb_off_by_more_than_1_share": float((off > 1).mean()),
        "rgb_largest": int(off.max()),
    }


def timed(work: Callable[[], object], rounds: int) -> float:
    """Return the seconds of one call; all calls are queued, and only the end is waited for."""
    work()
    cuda.synchronize()
    begin = time.perf_counter()
    for _ in range(rounds):
        work()
    cuda.synchronize()
    return (time.perf_counter() - begin) / rounds


def speed(town_name: str, number: int, kinds: np.ndarray) -> dict[str, float]:
    world, places = World.of(load_town(town_name)), poses(town_name, number)
    renderer = CudaRenderer(world, Camera(), number)
    seeds = ticks = np.arange(number)
    launched = []

    def work() -> None:
        begin = time.perf_counter()
        renderer.render(LOOKS, seeds, places, ticks, kinds=kinds)
        launched.append(time.perf_counter() - begin)

    spent = timed(work, 30)
    return {"frames_per_s": number / spent, "ms": spent * 1e3, "host_ms": statistics.median(launched) * 1e3}


def parts(town_name: str, number: int) -> dict[str, float]:
    """Return the milliseconds of each kernel by itself."""
    world = World.of(load_town(town_name))
    renderer: Any = CudaRenderer(world, Camera(), number)
    numbers = np.arange(number)
    renderer.render(LOOKS, numbers, poses(town_name, number), numbers, kinds=numbers % 6)
    sent, looks = renderer._numbers_there[:number], renderer._looks_there
    grid = (number, -(-192 // cuda_camera.THREADS))
    around = (sent, looks, renderer._packed, renderer._scene[2], renderer._items, 192, 64, renderer._rows,
              renderer._place, renderer._spans)  # fmt: skip
    paint = (sent, looks, renderer._packed, *renderer._scene, renderer._rows, renderer._place, renderer._spans,
             *renderer._lists, *renderer._work, *renderer._images)  # fmt: skip
    figures = {
        "look_around": timed(lambda: cuda_kernels.look_around[number, 2 * cuda_camera.THREADS](*around), 20),
        "paint": timed(lambda: cuda_kernels.paint_low[grid, cuda_camera.THREADS](*paint), 20),
        "rain": timed(lambda: cuda_kernels.rain_down[grid, cuda_camera.THREADS](sent, looks, renderer._images[0]), 20),
        "upload": timed(lambda: sent.copy_to_device(renderer._numbers[:number]), 20),
    }
    return {name: 1e3 * spent for name, spent in figures.items()}


def variants(town_name: str, number: int) -> dict[str, float]:
    """Return the milliseconds of the main kernel, by registers and threads of a block."""
    world = World.of(load_town(town_name))
    renderer: Any = CudaRenderer(world, Camera(), number)
    numbers = np.arange(number)
    renderer.render(LOOKS, numbers, poses(town_name, number), numbers, kinds=numbers % 6)
    paint = (renderer._numbers_there[:number], renderer._looks_there, renderer._packed, *renderer._scene,
             renderer._rows, renderer._place, renderer._spans, *renderer._lists, *renderer._images)  # fmt: skip
    figures = {}
    for registers in (None, 168, 128, 96, 64):
        made = cuda.jit(fastmath=True, max_registers=registers)(cuda_kernels.paint_low.py_func)
        for threads in (32, 64, 96, 192):
            grid = (number, -(-192 // threads))
            spent = timed(lambda made=made, grid=grid, threads=threads: made[grid, threads](*paint), 10)
            figures[f"{registers or 'all'} registers, {threads} threads"] = 1e3 * spent
    return figures


def steps(number: int, backend: str, rounds: int) -> dict[str, float]:
    env = WrongturnVectorEnv(
        number, town="Town01", track="segmentation", backend=backend, copy=False, threads=8, task="cruise",
        strict=True, record=False, autoreset_mode="SameStep", weather=[str(weather) for weather in Weather],
    )  # fmt: skip
    env.reset(seed=0)
    action = np.tile(np.array([0.0, 0.3, 0.0], np.float32), (number, 1))
    camera: Any = env._camera
    paint, last = camera.paint, camera.last
    painting = [0.0]

    def watched(work: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            begin = time.perf_counter()
            result = work(*given)
            painting[0] += time.perf_counter() - begin
            return result

        return call

    for _ in range(5):
        env.step(action)
    camera.paint, camera.last = watched(paint), watched(last)
    begin = time.perf_counter()
    ends = 0
    for _ in range(rounds):
        _, _, terminated, truncated, _ = env.step(action)
        ends += int((terminated | truncated).sum())
    if backend == "cuda":
        cuda.synchronize()
    spent = (time.perf_counter() - begin) / rounds
    env.close()
    return {
        "env_steps_per_s": number / spent,
        "ms": spent * 1e3,
        "camera_host_ms": painting[0] / rounds * 1e3,
        "ended_per_step": ends / rounds,
    }


def main() -> None:
    options_of = parser(__doc__)
    options_of.add_argument("--towns", nargs="+", default=["Town01", "Town02"])
    options_of.add_argument("--poses", type=int, default=64)
    options_of.add_argument("--numbers", type=int, nargs="+", default=[256, 512, 2048])
    options_of.add_argument("--variants", action="store_true")
    options = options_of.parse_args()
    figures: dict[str, Any] = {}

    def tell(name: str, work: Callable[[], dict[str, float]]) -> None:
        try:
            figures[name] = work()
        except Exception as error:  # go on with the other figures
            figures[name] = {"failed": f"{type(error).__name__}: {error}"[:2000]}
        print(name, json.dumps(figures[name]), flush=True)

    for town in options.towns:
        tell(f"equality {town}", lambda town=town: equality(town, options.poses, Camera()))
    town = options.towns[0]
    tell(f"equality {town}, pitched", lambda: equality(town, 8, Camera(pitch=0.1)))
    tall = Camera(width=320, height=120, focal=180.0, cx=160.0, cy=50.0)
    tell(f"equality {town}, 120 x 320", lambda: equality(town, 8, tall))
    for number in options.numbers:
        tell(f"frames {number}, six weathers", lambda n=number: speed(town, n, np.arange(n) % 6))
        tell(f"frames {number}, clear noon", lambda n=number: speed(town, n, np.zeros(n, np.int64)))
        tell(f"kernels {number}, ms", lambda n=number: parts(town, n))
    for number in options.numbers[:2]:
        tell(f"steps {number}, cuda", lambda n=number: steps(n, "cuda", 200))
        tell(f"steps {number}, cpu, 8 threads", lambda n=number: steps(n, "cpu", 10))
    if options.variants:
        tell("variants 512, ms", lambda: variants(town, 512))
    finish(figures, options)


if __name__ == "__main__":
    main()
