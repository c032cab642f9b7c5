"""Guards of a refactoring: digests of what users get, to compare before and after.

    python lab/guards.py make before.json
    python lab/guards.py compare before.json

Drives (wrong commands, twins, journeys, SUMO's traffic, cameras), a training batch beside simple traffic, verdicts, the
OpenAPI document and the text of every page. Words of pages and the OpenAPI document are stored whole, so that a
difference can be read; the rest is digests. ``compare`` prints what differs; its exit status says whether drives do.
"""

import difflib
import hashlib
import html
import json
import math
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from wrongturn_agents.registry import resolve
from wrongturn_networks import load_suite
from wrongturn_protocol import Track, Trial
from wrongturn_protocol.observations import observation_space
from wrongturn_sim import Episode, FleetTraffic, WrongturnVectorEnv

DECISIONS = 400
"""Decisions of each training batch."""


def swerving(trial: Trial, step: int) -> tuple[float, float, float]:
    """Return the action of a drive that ends in many ways: another curve for each trial."""
    phase = step / 7 + trial.seed
    return 0.35 * math.sin(phase), 0.5 + 0.4 * math.cos(phase / 3), 0.0


def drives() -> Iterator[tuple[Trial, Track, str]]:
    """Yield 200 drives: trial, track and driver."""
    commands, navigation = load_suite("wrong-command@3").episodes, load_suite("navigation@1").episodes
    for trial in commands[::2]:
        yield trial, Track.PRIVILEGED, "careful"
    for trial in commands[1::2]:
        yield trial, Track.PRIVILEGED, "obeys-blindly"
    for trial in commands[3::6]:
        yield trial, Track.SEGMENTATION, "swerving"
    for trial in commands[5::12]:
        yield trial, Track.CAMERA, "swerving"
    for trial in navigation[:: max(1, len(navigation) // 50)][:50]:
        yield trial, Track.PRIVILEGED, "careful"


def driven(trial: Trial, track: Track, driver: str) -> dict[str, str]:
    """Drive one trial to its end and return the digest of all bytes, and the outcome."""
    episode = Episode(trial, track)
    agent = None if driver == "swerving" else resolve(driver).make()
    if agent is not None:
        agent.reset(observation_space(track))
    digest = hashlib.sha256()
    observation = episode.reset()
    while episode.outcome is None:
        for name in sorted(observation):
            digest.update(np.ascontiguousarray(observation[name]).tobytes())
        if agent is None:
            action = swerving(trial, episode.steps)
        else:
            made = agent.act(observation)
            action = made.steer, made.throttle, made.brake
        step = episode.step(*action)
        observation = step.observation
        digest.update(repr(step.reward).encode())
    trajectory = episode.trajectory.to_json()
    digest.update(trajectory if isinstance(trajectory, bytes) else trajectory.encode())
    return {"bytes": digest.hexdigest(), "outcome": episode.outcome.model_dump_json()}


def batch(town: str, track: Track) -> str:
    """Return the digest of a batch of 24 cars beside the batch's own traffic."""
    env = WrongturnVectorEnv(24, town, track, own_traffic=FleetTraffic(), task="navigation_dynamic")
    digest = hashlib.sha256()
    rng = np.random.default_rng(7)
    observation, _ = env.reset(seed=7)
    for _ in range(DECISIONS if track is Track.STATE else 60):
        actions = rng.uniform((-0.3, 0.2, 0.0), (0.3, 0.9, 0.1), (24, 3)).astype(np.float32)
        observation, reward, terminated, truncated, _ = env.step(actions)
        for name in sorted(observation):
            digest.update(np.ascontiguousarray(observation[name]).tobytes())
        digest.update(reward.tobytes() + terminated.tobytes() + truncated.tobytes())
    env.close()
    return digest.hexdigest()


def words(page: str) -> list[str]:
    """Return a page's text without what differs from run to run: numbers, ids and dates."""
    page = re.sub(r"<(script|style)\b.*?</\1>", " ", page, flags=re.S)
    lines = html.unescape(re.sub(r"<[^>]*>", "\n", page)).splitlines()
    plain = (re.sub(r"\b[0-9a-f]{8,}\b|[-\u2212]?\d[\d.,:]*", "#", line.strip()) for line in lines)
    return [line for line in plain if line]


def service() -> dict[str, Any]:
    """Return the OpenAPI document and the words of every page of a service with two driven agents."""
    # The pages are found and filled as the browser's tests do it.
    sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / folder) for folder in ("service", "browser")]
    from all_pages import page_paths
    from filled_site import SUITE, filled_site

    with tempfile.TemporaryDirectory() as folder, filled_site(Path(folder)) as site:
        pages = {
            name: words(httpx.get(site.url + path, timeout=300, follow_redirects=True).text)
            for name, path in {"front": "/", **page_paths(site, SUITE)}.items()
        }
        return {"openapi": site.get("/openapi.json"), "pages": pages}


def make() -> dict[str, Any]:
    """Return all guards."""
    found: dict[str, Any] = {"drives": {}, "batches": {}}
    for trial, track, driver in drives():
        found["drives"][f"{trial.id} {track} {driver}"] = driven(trial, track, driver)
        print(f"\r{len(found['drives'])} drives", end="", file=sys.stderr)
    for town in ("Town01", "Town02"):
        for track in (Track.STATE, Track.SEGMENTATION):
            found["batches"][f"{town} {track}"] = batch(town, track)
    return {**found, **service()}


def compare(before: dict[str, Any], after: dict[str, Any]) -> int:
    """Print what differs; return 1 if a drive or a batch does."""
    changed = 0
    for kind in ("drives", "batches"):
        for name in sorted(before[kind].keys() | after[kind].keys()):
            if before[kind].get(name) != after[kind].get(name):
                changed += 1
                print(f"{kind}: {name}: {before[kind].get(name)} -> {after[kind].get(name)}")
    for name in sorted(before["pages"].keys() | after["pages"].keys()):
        lines = before["pages"].get(name, []), after["pages"].get(name, [])
        print(*difflib.unified_diff(*lines, f"{name} before", f"{name} after", lineterm="", n=1), sep="\n")
    texts = (json.dumps(each["openapi"], indent=1, sort_keys=True).splitlines() for each in (before, after))
    print(*difflib.unified_diff(*texts, "OpenAPI before", "OpenAPI after", lineterm="", n=2), sep="\n")
    print(f"{len(after['drives'])} drives, {len(after['batches'])} batches: {changed} differ")
    return int(changed > 0)


def main() -> int:
    """Run a command: ``make FILE`` or ``compare FILE``."""
    command, file = sys.argv[1], Path(sys.argv[2])
    if command == "make":
        file.write_text(json.dumps(make()), "utf-8")
        return 0
    return compare(json.loads(file.read_text("utf-8")), make())


if __name__ == "__main__":
    raise SystemExit(main())
