"""What rigs cost: bytes and time of a step over the socket, time in process, in a batch, and memory.

The rigs are those of the adapters in ``docs/examples/adapters``, beside the track ``camera`` and that track as a rig. A
step is 0.1 s of the tracks, and 0.1 s or 0.05 s of a rig by its rate. Over the socket a service in its own processes
answers; a batch is two Gymnasium environments in processes of their own.

    python benchmarks/rigs.py [--steps 150] [--json FILE]
"""

import importlib
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import gymnasium
from common import finish, parser

from wrongturn_client import Client, LocalService
from wrongturn_networks import load_suite
from wrongturn_protocol import PracticeRequest, Rig, RigCamera, Track
from wrongturn_protocol.rigs import Sight, track_of
from wrongturn_protocol.wire import block
from wrongturn_sim import Episode

ADAPTERS = Path(__file__).parents[1] / "docs/examples/adapters"
ACTION = (0.0, 0.25, 0.0)
TRIAL = load_suite("wrong-command@3").open_draw.twins[0]


def rigs() -> dict[str, Sight]:
    """Return what is measured, by its name."""
    sys.path.insert(0, str(ADAPTERS))
    plain = Rig(cameras=(RigCamera(width=192, height=64, fov=83.6, horizon=26),))
    found: dict[str, Sight] = {"track camera": Track.CAMERA, "the same as a rig": plain}
    for file in sorted(ADAPTERS.glob("*.py")):
        module = importlib.import_module(file.stem)
        found[file.stem] = next(one.rig for one in vars(module).values() if isinstance(getattr(one, "rig", None), Rig))
    return found


def in_process(sight: Sight, steps: int) -> tuple[int, float]:
    """Return the bytes of an observation and the milliseconds of a step."""
    episode, times = Episode(TRIAL, sight, compressed=True), []
    size = len(block(episode.reset(), sight))
    for _ in range(steps):
        begin = time.perf_counter()
        step = episode.step(*ACTION)
        times.append(time.perf_counter() - begin)
        if step.terminated or step.truncated:
            episode.reset()
    return size, statistics.median(times) * 1000


def over_socket(url: str, name: str, sight: Sight, steps: int) -> float:
    """Return the milliseconds of a step over the socket."""
    rig = sight if isinstance(sight, Rig) else None
    with Client(url) as stranger:
        token = stranger.register(f"measured {name}", track_of(rig) if rig else Track.CAMERA, rig=rig).token
    times = []
    with Client(url, token) as client, client.drive() as drive:
        begun = drive.practise(PracticeRequest(suite="wrong-command@3", trial=TRIAL.id))
        for seq in range(1, steps + 1):
            begin = time.perf_counter()
            reply = drive.step(begun.id, seq, ACTION)
            times.append(time.perf_counter() - begin)
            if reply.terminated or reply.truncated:
                break
        else:
            drive.abort_episode(begun.id)
    return statistics.median(times) * 1000


def batch(sight: Sight, steps: int) -> float:
    """Return the steps per second of two environments side by side."""
    rig = sight if isinstance(sight, Rig) else None
    envs: Any = gymnasium.make_vec(
        "wrongturn_sim:WrongturnSim-v0", 2, "async", track=str(track_of(rig) if rig else sight), rig=rig
    )
    try:
        envs.reset(seed=0)
        begin = time.perf_counter()
        for _ in range(steps):
            envs.step([ACTION, ACTION])
        return 2 * steps / (time.perf_counter() - begin)
    finally:
        envs.close()


def memory_mb(service: LocalService) -> float:
    """Return the memory of the largest simulator, MB."""
    of = [int(task.parent.name) for task in Path("/proc").glob("[0-9]*/stat")]
    sizes = [0.0]
    for pid in of:
        try:
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
            if b"wrongturn_service.simulators" in command and _below(pid, service.pid):
                status = Path(f"/proc/{pid}/status").read_text()
                sizes.append(int(status.split("VmRSS:")[1].split()[0]) / 1000)
        except OSError:  # it ended
            continue
    return max(sizes)


def _below(pid: int, ancestor: int) -> bool:
    while pid > 1:
        if pid == ancestor:
            return True
        pid = int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])
    return False


def main() -> None:
    """Measure, and print the table of ``docs/rigs.md``."""
    options = parser(__doc__)
    options.add_argument("--steps", type=int, default=150)
    given = options.parse_args()
    steps = 5 if given.short else given.steps
    figures: dict[str, dict[str, float]] = {}
    print("| rig | kB a step | in process, ms | over the socket, ms | two in a batch, steps/s | simulator, MB |")
    print("|---|---:|---:|---:|---:|---:|")
    for name, sight in rigs().items():
        size, alone = in_process(sight, steps)
        with (
            tempfile.TemporaryDirectory() as folder,
            LocalService(
                database=f"sqlite+aiosqlite:///{folder}/a.db", environment={"WRONGTURN_SIMULATORS": "1"}
            ) as service,
        ):
            sent, memory = over_socket(service.url, name, sight, steps), memory_mb(service)
        side = batch(sight, steps)
        figures[name] = {"bytes": size, "ms": alone, "socket_ms": sent, "batch": side, "memory_mb": memory}
        print(f"| {name} | {size / 1000:.0f} | {alone:.2f} | {sent:.2f} | {side:.0f} | {memory:.0f} |", flush=True)
    finish({"rigs": figures}, given)


if __name__ == "__main__":
    main()
