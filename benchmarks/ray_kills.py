"""``kill -9`` on a Ray cluster during evaluations: what is lost or counted twice, and when does everybody step again?

``python benchmarks/ray_kills.py [--each N] [--seed N] [--victims WORDS] [--minutes N] [--json FILE] [--short]``

Kills simulators, raylets, nodes with all their processes, the head, Ray's driver and the service, in drawn order, each
once everything works again. What is killed is started again, as systemd or Kubernetes would. The time of a kill is the
longest that one of the agents waited for its next step, from then until everything works again.
"""

import itertools
import math
import os
import random
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import psutil
from common import finish, parser
from ray_nodes import Nodes

sys.path[:0] = [str(Path(__file__).parents[1] / folder) for folder in ("tests/faults", "tests/service")]

import campaign  # noqa: E402
from databases import File  # noqa: E402
from ledger import examine, journal  # noqa: E402
from processes import Service, children, until  # noqa: E402
from undisturbed import drive_undisturbed  # noqa: E402
from worker import HTTP, SOCKET  # noqa: E402

VICTIMS = ("simulator", "raylet", "node", "head", "driver", "service")
SEATS = (("careful", HTTP, 1), ("obeys-blindly", SOCKET, 1), ("careful", SOCKET, 2))
SUITE = "wrong-command@3"
_LONGEST_S = 240.0
_NOTICED_S = 30.0
"""Seconds in which Ray notices that a node is gone."""
_SETTLED_S = 1.5
"""Seconds in which the consequences of a kill begin, and in which the last steps are noted."""


class Storm:
    """A cluster, a service and agents."""

    def __init__(self, folder: Path, nodes: Nodes, seats: tuple[tuple[str, str, int], ...]) -> None:
        os.environ.update(nodes.environment)
        self.folder = folder
        self.nodes = nodes
        self.store = File(folder)
        self.service = Service(
            self.store.url,
            folder / "service.log",
            simulators="ray",
            spare_simulators=2,
            submissions=0,
            ray_address=nodes.address,
            ray_listen="127.0.0.1:0",
        )
        self.seats = [campaign.Seat(self.service, folder, f"seat {n}", one) for n, one in enumerate(seats, 1)]
        self.times: defaultdict[str, list[float]] = defaultdict(list)

    def figure(self, name: str) -> float:
        return self.service._figure(f"wrongturn_{name}")

    def well(self) -> bool:
        """Whether all nodes are there, spare simulators are ready, and the agents drive."""
        return (
            self.service._get("/health/ready") is not None
            and self.figure("ray_nodes") == 1 + len(self.nodes.workers)
            and self.figure("ray_connected") == 1
            and self.figure("simulators_idle") >= 1
            and self.service.driven()
        )

    def driving(self, chance: random.Random) -> list[psutil.Process]:
        """Return the simulators that drive, in drawn order: those that took processor time just now."""
        found = [one for number in self.nodes.workers for one in self.nodes.simulators(number)]
        before = [sum(one.cpu_times()[:2]) for one in found]
        time.sleep(0.3)
        found = [one for one, spent in zip(found, before, strict=True) if sum(one.cpu_times()[:2]) > spent]
        return chance.sample(found, len(found))

    def kill(self, victim: str, chance: random.Random) -> bool:
        worker = chance.choice(self.nodes.workers)
        if victim == "simulator":
            return self.nodes.kill_one(self.driving(chance))
        if victim == "raylet":
            return self.nodes.kill_raylet(worker)
        if victim == "node":
            return bool(self.nodes.simulators(worker)) and bool(self.nodes.kill(worker))
        if victim == "head":
            return bool(self.nodes.kill(0))
        if victim == "driver":
            return self.nodes.kill_one([psutil.Process(pid) for pid in children(self.service.pid or 0)])
        return self.service.kill()

    def longest_pause(self, victim: str, killed: float, connections: float) -> float:
        """Wait until all is well again; return the longest time since the kill without a step of some agent."""
        time.sleep(_SETTLED_S)
        if victim in {"head", "driver"}:
            until(lambda: self.figure("ray_connections") > connections, _LONGEST_S, "nobody has connected again")
        elif victim in {"raylet", "node"}:
            noticed_by = time.time() + _NOTICED_S
            while time.time() < noticed_by and self.figure("ray_nodes") > len(self.nodes.workers):
                time.sleep(0.1)
        until(self.well, _LONGEST_S, "the cluster is not well")
        well = time.time()
        time.sleep(_SETTLED_S)
        longest = 0.0
        for seat in self.seats:
            lines = [one for one in journal(seat.journals) if one["what"] in {"exchange", "began", "finished"}]
            for before, after in itertools.pairwise(lines):
                # An agent that has finished begins another evaluation, which takes its own time.
                if {before["what"], after["what"]} == {"exchange"} and after["time"] > killed and before["time"] < well:
                    longest = max(longest, after["time"] - max(killed, before["time"]))
        return longest


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--each", type=int, default=20, help="kills of each victim")
    options.add_argument("--minutes", type=float, default=math.inf, help="after which nothing more is killed")
    options.add_argument("--seed", type=int, default=7, help="of their order and moments")
    options.add_argument("--victims", nargs="+", default=VICTIMS, choices=VICTIMS)
    given = options.parse_args()
    chance = random.Random(given.seed)
    campaign.SUITE = "smoke@3" if given.short else SUITE
    kills = list(given.victims[:1] if given.short else given.victims) * (1 if given.short else given.each)
    chance.shuffle(kills)
    with tempfile.TemporaryDirectory(prefix="wrongturn-kills-") as name, Nodes() as nodes:
        storm = Storm(Path(name), nodes, SEATS[1:2] if given.short else SEATS)
        storm.service.start()
        try:
            storm.service.await_ready()
            for seat in storm.seats:
                seat.thread.start()
            enough = time.monotonic() + 60 * given.minutes
            for number, victim in enumerate(kills, 1):
                if time.monotonic() > enough:
                    break
                until(storm.well, _LONGEST_S, "the cluster is not well")
                time.sleep(chance.uniform(0.1, 2.0))
                connections = storm.figure("ray_connections")
                until(lambda victim=victim: storm.kill(victim, chance), 60.0, f"no {victim} to kill")
                storm.times[victim].append(storm.longest_pause(victim, time.time(), connections))
                print(f"{number}/{len(kills)} {victim}: {storm.times[victim][-1]:.2f} s", flush=True)
            for seat in storm.seats:
                seat.last.set()
            campaign._await(storm.seats, 1800.0)
        finally:
            for seat in storm.seats:
                seat.stop()
            status = storm.service.stop()
            if given.json is not None:
                Path(given.json).with_suffix(".log").write_bytes((Path(name) / "service.log").read_bytes())
        told = journal([path for seat in storm.seats for path in seat.journals])
        driven = {evaluation: seat.policy for seat in storm.seats for evaluation in seat.evaluations}
        undisturbed = {one: drive_undisturbed(storm.store, one, policy) for one, policy in driven.items()}
        found = examine(storm.store, undisturbed, told, storm.service.kills)
    for victim, times in storm.times.items():
        rates = f"median {statistics.median(times):6.2f} s   longest {max(times):6.2f} s"
        print(f"{victim:<10}{len(times):>4} kills   {rates}")
    print(f"{found.evaluations} evaluations, {found.finished} verdicts, {found.acknowledged} acknowledged")
    print(f"voided {dict(found.voided)}; lost, twice or differing: {found.bad or 'nothing'}; status {status}")
    finish({"times": storm.times, "verdicts": found.finished, "bad": found.bad, "voided": found.voided}, given)
    if found.bad or status:
        sys.exit(1)


if __name__ == "__main__":
    main()
