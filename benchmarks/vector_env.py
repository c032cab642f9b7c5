"""How many egos a second the vectorised environment drives, and what its time goes to, against the single one.

Egos wander by random actions and begin anew when their verdict falls, as in training, with one thread; the figures are
processor time of it, so that a busy machine counts little. Logic is the car, the judge, the route, the reward and the
arrays of the observation; resets are the drawing of trials and their begin; pictures are the camera. The rest is the
copying of the observation, and Python.

    python benchmarks/vector_env.py [--egos 512] [--steps 100] [--town Town01] [--threads 1,2] [--json FILE]
"""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from common import finish, parser

from wrongturn_sim import WrongturnSimEnv, WrongturnVectorEnv

WITH_PICTURES = ("camera", "segmentation")
WHOLE, LOGIC, RESETS, PICTURES = "whole", "logic", "resets", "pictures"


def actions_of(egos: int, steps: int) -> Any:
    """(steps, egos, 3): a gentle wandering."""
    random = np.random.default_rng(1)
    return random.uniform([-0.15, 0.1, 0.0], [0.15, 0.6, 0.05], (steps, egos, 3)).astype(np.float32)


def timed(owner: Any, name: str, spent: dict[str, float], part: str) -> None:
    """Let every call of a method add its time to a part; calls within it are left to their own part."""
    method: Callable[..., Any] = getattr(owner, name)

    def wrapped(*args: Any, **kwargs: Any) -> Any:
        inner = sum(spent.values())
        begin = time.thread_time()
        try:
            return method(*args, **kwargs)
        finally:
            spent[part] += time.thread_time() - begin - (sum(spent.values()) - inner)

    setattr(owner, name, wrapped)


def batch(town: str, track: str, egos: int, steps: int) -> dict[str, float]:
    """Egos a second and microseconds an ego, whole and by parts."""
    envs = WrongturnVectorEnv(egos, town, track)
    envs.reset(seed=1)
    actions = actions_of(egos, steps + 2)
    for action in actions[:2]:
        envs.step(action)
    spent = dict.fromkeys((LOGIC, RESETS, PICTURES), 0.0)
    timed(envs._fleet, "step", spent, LOGIC)
    timed(envs, "_begin", spent, RESETS)
    if envs._camera is not None:
        timed(envs._camera, "render", spent, PICTURES)
    begin = time.thread_time()
    for action in actions[2:]:
        envs.step(action)
    whole = time.thread_time() - begin
    microseconds = {part: seconds / (egos * steps) * 1e6 for part, seconds in {WHOLE: whole, **spent}.items()}
    return {"egos": egos, "egos_per_second": egos * steps / whole, **microseconds}


def threaded(town: str, track: str, egos: int, steps: int, threads: int) -> float:
    """Egos a second by the clock."""
    envs = WrongturnVectorEnv(egos, town, track, threads=threads)
    envs.reset(seed=1)
    actions = actions_of(egos, steps + 2)
    for action in actions[:2]:
        envs.step(action)
    begin = time.perf_counter()
    for action in actions[2:]:
        envs.step(action)
    seconds = time.perf_counter() - begin
    envs.close()
    return egos * steps / seconds


def single(town: str, track: str, steps: int) -> float:
    """Steps a second of the single environment, with SUMO, resets included."""
    env = WrongturnSimEnv(town, track)
    env.reset(seed=1)
    begin = time.thread_time()
    for action in actions_of(1, steps)[:, 0]:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    return steps / (time.thread_time() - begin)


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--egos", type=int, default=512)
    options.add_argument("--steps", type=int, default=100)
    options.add_argument("--town", default="Town01")
    options.add_argument("--threads", default="", help="such as 1,2,4: measure these by the clock too")
    arguments = options.parse_args()
    if arguments.short:
        arguments.egos, arguments.steps = 8, 4
    figures: dict[str, dict[str, float]] = {}
    for track in ("state", "camera") if arguments.short else ("state", "privileged", *WITH_PICTURES):
        painted = track in WITH_PICTURES
        egos = max(1, arguments.egos // 8) if painted else arguments.egos
        steps = max(1, arguments.steps // 4) if painted else arguments.steps
        found = figures[track] = batch(arguments.town, track, egos, steps)
        found["single_per_second"] = single(arguments.town, track, 4 * steps)
        print(
            f"{track:12} {egos:4} egos: {found['egos_per_second']:9,.0f} ego-steps/s "
            f"({found['egos_per_second'] / found['single_per_second']:.1f} x a single one), "
            f"{found[WHOLE]:.1f} us an ego: logic {found[LOGIC]:.1f}, resets {found[RESETS]:.1f}, "
            f"pictures {found[PICTURES]:.1f}"
        )
        for threads in [int(number) for number in arguments.threads.split(",") if number]:
            rate = found[f"threads_{threads}"] = threaded(arguments.town, track, egos, steps, threads)
            print(f"{'':12} {threads} threads by the clock: {rate:,.0f} ego-steps/s")
    finish({"tracks": figures}, arguments)


if __name__ == "__main__":
    main()
