"""``kill -9`` on a Ray cluster during submissions: does each one finish, with each trial driven once?

``python benchmarks/ray_runner_kills.py [--each N] [--seed N] [--victims …] [--simulators S] [--json FILE] [--short]``

Kills runners, the workers of Ray that watch them, raylets, nodes with all their processes, the head, Ray's driver and
the service, in drawn order, while a model drives. What is killed is started again, as systemd or Kubernetes would. The
time of a kill is the longest one without a step of a model, from then until everything works again.
"""

import os
import random
import statistics
import sys
import tempfile
import time
from collections import Counter, defaultdict
from pathlib import Path

import httpx
import psutil
from common import finish, parser
from ray_nodes import Nodes

sys.path[:0] = [str(Path(__file__).parents[1] / "tests" / folder) for folder in ("faults", "service", "runner")]

import small_models  # noqa: E402
from databases import File  # noqa: E402
from processes import Service, children, until  # noqa: E402
from submission_owner import Owner  # noqa: E402

VICTIMS = ("runner", "worker", "raylet", "node", "head", "driver", "service")
_RUNNER = "wrongturn_runner"
_LONGEST_S = 300.0
_NOTICED_S = 12.0
"""Seconds in which nodes notice that their head is gone."""


class Storm:
    """A cluster, a service, and an owner who hands one model in after the other."""

    def __init__(self, folder: Path, nodes: Nodes, simulators: str, suite: str) -> None:
        os.environ.update(nodes.environment)
        self.nodes = nodes
        self.store = File(folder)
        self.service = Service(
            self.store.url,
            folder / "service.log",
            simulators=simulators,
            spare_simulators=1,
            submissions=1,
            submissions_per_owner=1000,
            runners="ray",
            model_memory=1 << 28,
            ray_address=nodes.address,
            ray_listen="127.0.0.1:0",
        )
        self.suite = suite
        self.waiting = 2 if suite == "smoke@3" else 1
        self.submissions: list[str] = []
        self.times: defaultdict[str, list[float]] = defaultdict(list)

    def figure(self, name: str) -> float:
        return self.service._figure(f"wrongturn_{name}")

    def begin(self) -> None:
        self.service.start()
        self.service.await_ready()
        until(lambda: self.figure("ray_nodes_with_sandbox") == 1 + len(self.nodes.workers), _LONGEST_S, "no sandboxes")
        self.owner = Owner(self.service.url)

    def state(self, submission: str) -> str:
        """Return its state; nothing while nobody answers."""
        try:
            return str(self.owner.get(submission)["state"])
        except (httpx.HTTPError, AssertionError):
            return ""

    def hand_in(self) -> None:
        """Keep a model or two waiting."""
        if sum(self.state(one) in {"queued", "checked", ""} for one in self.submissions[-4:]) < self.waiting:
            self.submissions.append(self.owner.hand_in(small_models.steady(accelerate=0.1), suite=self.suite))

    def well(self) -> bool:
        """Whether all nodes have a sandbox, and a model drives."""
        if self.service._get("/health/ready") is None:
            return False
        self.hand_in()
        return (
            self.figure("ray_nodes_with_sandbox") == 1 + len(self.nodes.workers)
            and self.figure("ray_connected") == 1
            # Steps of a check must not be taken for those of the drive.
            and {"checked", "running"} == {self.state(one) for one in self.submissions[-4:]} - {"finished"}
            and self.host() is not None
        )

    def host(self) -> int | None:
        """Return the node of the runner that drives."""
        return next((n for n in self.nodes.workers if self.nodes._named(n, _RUNNER)), None)

    def kill(self, victim: str) -> bool:
        host = self.host()
        if victim == "head":
            return bool(self.nodes.kill(0))
        if victim == "driver":
            drivers = [psutil.Process(pid) for pid in children(self.service.pid or 0)]
            return self.nodes.kill_one([one for one in drivers if "wrongturn_ray.driver" in one.cmdline()])
        if victim == "service":
            return self.service.kill()
        if host is None:
            return False
        if victim == "raylet":
            return self.nodes.kill_raylet(host)
        if victim == "node":
            return bool(self.nodes.kill(host))
        carriers = self.nodes._named(host, "wrongturn_ray.piped")
        found = [child for one in carriers for child in one.children() if victim == "runner"]
        # The worker of the task is the parent of the program that carries the runner's stdin and stdout.
        return self.nodes.kill_one(found or [parent for one in carriers for parent in one.parents()[:1]])

    def steps(self) -> float:
        return self.figure("steps_total")

    def pause_s(self) -> float:
        """Wait until everything works again; return the longest time without a step, in seconds."""
        killed = stepped = looked = time.monotonic()
        longest, before = 0.0, self.steps()
        while time.monotonic() < killed + _LONGEST_S:
            now, steps = time.monotonic(), self.steps()
            if steps not in {before, 0.0}:  # a service that has begun again counts from 0
                longest, stepped, before = max(longest, now - stepped), now, steps
            if now > looked + 1.0:
                looked = now
                if self.well() and now - stepped < 1.0 and now > killed + _NOTICED_S:
                    return longest
            time.sleep(0.05)
        raise AssertionError(f"not well within {_LONGEST_S:g} s")

    def examine(self) -> tuple[int, list[str]]:
        """Return how many verdicts there are, and what is wrong."""
        verdicts, wrong = 0, []
        for submission in self.submissions:
            found = self.owner.get(submission)
            if found["state"] != "finished":
                wrong.append(
                    f"{submission}: {found['state']}, {found.get('reason')}, {self.owner.log(submission)[-4:]}"
                )
                continue
            query = f"SELECT trial_id, state FROM episodes WHERE evaluation_id = '{found['evaluation']}'"
            times = Counter(row["trial_id"] for row in self.store.rows(query) if row["state"] == "finished")
            verdicts += len(times)
            if len(times) != found["episodes"] or set(times.values()) != {1}:
                wrong.append(f"{submission}: {times}")
        return verdicts, wrong


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--each", type=int, default=5, help="kills of each victim")
    options.add_argument("--seed", type=int, default=7, help="of their order and moments")
    options.add_argument("--victims", nargs="+", default=VICTIMS, choices=VICTIMS)
    options.add_argument("--simulators", default="3", help="as WRONGTURN_SIMULATORS has it")
    given = options.parse_args()
    chance = random.Random(given.seed)
    kills = list(given.victims[:1] if given.short else given.victims) * (1 if given.short else given.each)
    chance.shuffle(kills)
    with tempfile.TemporaryDirectory(prefix="wrongturn-kills-") as name, Nodes(1 if given.short else 2) as nodes:
        storm = Storm(Path(name), nodes, given.simulators, "smoke@3" if given.short else "wrong-command@3")
        try:
            storm.begin()
            for number, victim in enumerate(kills, 1):
                until(storm.well, _LONGEST_S, "the cluster is not well")
                time.sleep(chance.uniform(0.0, 2.0))
                until(lambda victim=victim: storm.well() and storm.kill(victim), _LONGEST_S, f"no {victim} to kill")
                storm.times[victim].append(storm.pause_s())
                print(f"{number}/{len(kills)} {victim}: {storm.times[victim][-1]:.2f} s", flush=True)
            over = {"finished", "failed", "cancelled"}
            until(
                lambda: all(storm.state(one) in over for one in storm.submissions), 4 * _LONGEST_S, "not all are over"
            )
            verdicts, wrong = storm.examine()
        finally:
            status = storm.service.stop()
            if given.json is not None:
                given.json.with_suffix(".log").write_bytes((Path(name) / "service.log").read_bytes())
    for victim, times in storm.times.items():
        rates = f"median {statistics.median(times):6.2f} s   longest {max(times):6.2f} s"
        print(f"{victim:<10}{len(times):>4} kills   {rates}")
    print(f"{len(storm.submissions)} submissions, {verdicts} verdicts; wrong: {wrong or 'nothing'}; status {status}")
    finish({"times": storm.times, "submissions": len(storm.submissions), "verdicts": verdicts, "bad": wrong}, given)
    if wrong or status:
        sys.exit(1)


if __name__ == "__main__":
    main()
