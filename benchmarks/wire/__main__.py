"""Steps a second over the wire: our WebSocket beside bare sockets, HTTP, batches, and other environments' ways.

    python benchmarks/wire [--json FILE] [--rounds 5] [--seconds 0.5] [--work 145] [--clients 1 4 16] [--batch 16]
        [--openenv PYTHON] [--others SITE-PACKAGES] [--real]

Simulators are emulated: a process that works for so many microseconds and shows an observation of the track
``segmentation``. ``in the simulator`` is a bare blocking socket in the process that works, 32 bytes in and the block
out: what no protocol can beat. ``with a hop`` is such a socket in front of one of the service's own simulator
processes, one blocking process for each connection. Every client is a process; all ways are measured by turns in
every round, and what is told is the median of the rounds' ratios, which a busy machine spoils least.

``--real`` measures real simulations too. ``--others`` names a folder with highway-env and MetaDrive (``frames.py``
tells how to make one), ``--openenv`` the python of an environment with openenv-core and numpy.
"""

import argparse
import contextlib
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(1, str(Path(__file__).parents[1]))

import emulation
from common import finish, parser
from rates import Rates, by_turns, medians, percentiles, ratio

RAW, OURS, HTTP = "WebSocket, raw client", "WebSocket, our client", "HTTP, our client"
BARE, HOP = "in the simulator", "with a hop"
RATIOS = [(RAW, HOP), (OURS, HOP), (OURS, BARE), (OURS, HTTP)]


def lone_steps(given: argparse.Namespace, url: str, token: str, ports: tuple[int, int], pipe: Any) -> dict[str, Any]:
    from crowd import crowd  # noqa: PLC0415
    from ways import Episode, Http, Ours, Raw, Socket  # noqa: PLC0415

    from wrongturn_client import Client  # noqa: PLC0415

    def make() -> dict[str, Any]:
        client = Client(url, token)
        episode = Episode(client)
        return {
            BARE: Socket(ports[0]),
            HOP: Socket(ports[1]),
            RAW: Raw(url, token, episode),
            OURS: Ours(client, episode),
            HTTP: Http(client, episode),
        }

    found: dict[str, Any] = {}
    with crowd(make, max(given.clients)) as many:
        for clients in given.clients:
            rates: Rates = []
            took: dict[str, list[float]] = {}
            overheads: dict[str, list[float]] = {}
            for _ in range(given.rounds):
                one = {}
                for way in (BARE, HOP, RAW, OURS, HTTP):
                    one[way], seconds = many.rate(way, clients, given.seconds)
                    took.setdefault(way, []).extend(seconds)
                    pipe.send(True)
                    overheads.setdefault(way, []).extend(pipe.recv())
                rates.append(one)
            print(f"\n{clients} client{'s' * (clients > 1)}:")
            for way, value in medians(rates).items():
                of_hop, of_bare = ratio(rates, way, HOP), ratio(rates, way, BARE)
                print(f"  {way:28}{value:8,.0f} steps/s   {of_hop:5.2f} of {HOP}   {of_bare:5.2f} of {BARE}")
            for way, seconds in took.items():
                print(f"  {way:28}a step's ms {percentiles(seconds)}   the service's own {percentiles(overheads[way])}")
            found[str(clients)] = {
                "rates": rates,
                "ratios": {f"{above} / {below}": ratio(rates, above, below) for above, below in RATIOS},
                "overhead_ms": {way: percentiles(overheads[way]) for way in (RAW, OURS, HTTP)},
                "step_ms": {way: percentiles(took[way]) for way in took},
            }
    return found


def shown(title: str, rates: Rates, below: str) -> dict[str, Any]:
    print(f"\n{title}:")
    for name, value in medians(rates).items():
        print(f"  {name:44}{value:8,.0f} steps/s   {ratio(rates, name, below):6.2f} of {below}")
    return {"rates": rates, "ratios": {f"{name} / {below}": ratio(rates, name, below) for name in rates[0]}}


def batches(given: argparse.Namespace, client: Any) -> dict[str, Any]:
    from ways import Batch, InProcess, Workers  # noqa: PLC0415

    count = given.batch
    ways = {
        "in process, one after the other": (InProcess(count), count),
        f"{count} simulator processes, nothing between": (Workers(count), count),
        "over the wire": (Batch(client, count), count),
    }
    rates = by_turns(ways, given.rounds, 2 * given.seconds)
    return shown(f"batches of {count}", rates, "in process, one after the other")


def simulators(given: argparse.Namespace, client: Any) -> dict[str, Any]:
    from ways import Batch  # noqa: PLC0415

    ways = {f"{count} simulators": (Batch(client, count), count) for count in counts_of(given)}
    rates = by_turns(ways, given.rounds, given.seconds)
    return shown(f"one client, a message for all its simulators, {os.cpu_count()} cores", rates, "1 simulators")


def counts_of(given: argparse.Namespace) -> list[int]:
    cores = os.cpu_count() or 1
    powers = (2**power for power in range(10) if 2**power <= cores)
    return [1] if given.short else sorted({*powers, cores, 2 * cores})


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--rounds", type=int, default=5)
    options.add_argument("--seconds", type=float, default=0.5, help="of each way in each round")
    options.add_argument("--clients", type=int, nargs="+", default=[1, 4, 16])
    options.add_argument("--batch", type=int, default=16, help="episodes in a message")
    options.add_argument("--work", type=float, default=145.0, help="microseconds of an emulated step")
    options.add_argument("--openenv", type=Path, help="python with openenv-core")
    options.add_argument("--others", type=Path, help="folder with highway-env and MetaDrive")
    options.add_argument("--real", action="store_true", help="real simulations too")
    given = options.parse_args()
    if given.short:
        given.rounds, given.seconds, given.clients, given.batch = 1, 0.1, [1], 2
    os.environ[emulation.WORK] = str(given.work * 1e-6)
    os.environ.setdefault("OMP_NUM_THREADS", "1")

    import servers  # noqa: PLC0415

    from wrongturn_client import Client  # noqa: PLC0415

    found: dict[str, Any] = {
        "cores": os.cpu_count(),
        "work_us": given.work,
        "block_bytes": emulation.SIZE,
        "load_before": os.getloadavg(),
    }
    began = time.monotonic()
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores, {emulation.SIZE} bytes, {given.work:g} us a step")
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        os.environ.setdefault("WRONGTURN_HOME", folder)
        port, _ = stack.enter_context(servers.started(servers.bare))
        hop, _ = stack.enter_context(servers.started(servers.hop))
        slots = max(given.clients) + given.batch + sum(counts_of(given))
        listening, pipe = stack.enter_context(servers.started(servers.service, folder, True, slots))
        url = f"http://127.0.0.1:{listening}"
        with Client(url) as anybody:
            anybody.ready()
            token = anybody.register("wire", emulation.TRACK).token
        found["clients"] = lone_steps(given, url, token, (port, hop), pipe)
        client = stack.enter_context(Client(url, token))
        found["batches"] = batches(given, client)
        found["simulators"] = simulators(given, client)
        if given.openenv or given.others or given.real:
            import rivals  # noqa: PLC0415

            found |= rivals.compared(given, client, folder)
    found["load_after"] = os.getloadavg()
    found["seconds"] = time.monotonic() - began
    print(f"\nload {os.getloadavg()[0]:.1f} at the end; {found['seconds']:.0f} s in all")
    finish(found, given)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--simulator"]:
        os.environ[emulation.WORK] = sys.argv[2]
        del sys.argv[1:3]
        emulation.simulator()
    else:
        main()
