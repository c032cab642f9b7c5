"""Train and score many runs over the GPUs that there are, within given minutes.

``python -m wrongturn_agents.training.campaign --default --minutes 24 --directory D`` trains five seeds of each agent
and the ablations. It may be interrupted at any second; the same command goes on. What came of it is in ``D/bundle``,
``D/status.json`` and ``D/campaign.log`` tell how far it is, ``D/jobs/NAME/log.txt`` of each run.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final

from wrongturn_agents.training.bundle import replace
from wrongturn_agents.training.campaign_jobs import JobProcess, warm_up
from wrongturn_agents.training.campaign_plan import Plan, default_plan, read_plan
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.lock import locked

_WARMING: Final = 180.0
"""Seconds that compiling may take."""
_EVERY: Final = 5.0
"""Seconds between two states of the status file."""
_ENDING: Final = 0.15
"""Minutes before the end at which what still runs is stopped."""


class Campaign:
    """Runs a plan's jobs, in their order as far as GPUs and time allow.

    Args:
        plan: what to train.
        directory: where all of it is.
        devices: of ``CUDA_VISIBLE_DEVICES``; none for the CPU.
        minutes: of wall clock, with everything.
    """

    def __init__(self, plan: Plan, directory: Path, devices: list[str], minutes: float) -> None:
        if not minutes > 0.0:
            raise TrainingError(f"minutes: is {minutes}; give a number above 0")
        self.plan = plan
        self.directory = directory
        self.devices = devices
        self.end = time.monotonic() + 60.0 * minutes
        self.jobs = [JobProcess(job, directory / "jobs" / job.name) for job in plan.jobs]
        self.stopped = False
        self._began = time.monotonic()
        self._told_at = -_EVERY

    def run(self, *, warm: bool = True) -> bool:
        """Do what can be done; gives whether all of it is done."""
        self.directory.mkdir(parents=True, exist_ok=True)
        with locked(self.directory / ".lock", "a campaign is running there"):
            return self._run(warm)

    def _run(self, warm: bool) -> bool:
        where = f"{len(self.devices)} GPUs" if self.devices else "the CPU"
        self._say(f"{len(self.jobs)} jobs, {sum(one.done for one in self.jobs)} of them done, on {where}")
        try:
            if warm and any(not one.done for one in self.jobs):
                with (self.directory / "warm.txt").open("wb") as log:
                    status = warm_up(log, _WARMING)
                self._say("compiled" if status == 0 else f"compiling failed with {status}; jobs will do it themselves")
            while not self.stopped and self._step():
                time.sleep(0.25)
        finally:
            for one in self.jobs:
                one.terminate()
            for one in self.jobs:
                if one.running:
                    self._say(f"stopped {one.job.name}")
                    one.stop()
            done = sum(one.done for one in self.jobs)
            self._say(f"over: {done} of {len(self.jobs)} jobs done")
            self._tell(over=True)
        return done == len(self.jobs)

    def _step(self) -> bool:
        """Begin what can begin and see what has ended; gives whether there is anything left to wait for."""
        for one in self.jobs:
            status = one.over() if one.running else None
            if status is not None:
                took = time.monotonic() - one.began
                self._say(f"{one.job.name}: {one.state if status == 0 else f'failed with {status}'} after {took:.0f} s")
        left = (self.end - time.monotonic()) / 60.0 - _ENDING
        for one in self.jobs:
            gpu = self._free(one.job.slots)
            if gpu is not None and one.waiting and one.needs <= left and self._ready(one):
                device = self.devices[gpu] if self.devices else None
                one.start(gpu, self._command(one), device)
                self._say(
                    f"{one.job.name}: {'begins' if one.tries == 1 else 'is tried again'} on {device or 'the CPU'}"
                )
        if time.monotonic() - self._told_at >= _EVERY:
            self._tell()
        return left > 0.0 and any(one.running for one in self.jobs)

    def _free(self, slots: int) -> int | None:
        """The GPU with the most room, if that is enough."""
        loads = [0] * max(1, len(self.devices))
        for one in self.jobs:
            if one.gpu is not None:
                loads[one.gpu] += one.job.slots
        gpu = min(range(len(loads)), key=lambda i: loads[i])
        return gpu if loads[gpu] + slots <= self.plan.slots else None

    def _ready(self, one: JobProcess) -> bool:
        if one.job.encoder_of is None:
            return True
        other = next(other for other in self.jobs if other.job.name == one.job.encoder_of)
        return any((other.folder / place).is_file() for place in ("run/encoder.pt", "encoder.pt"))

    def _command(self, one: JobProcess) -> dict[str, Any]:
        cores = len(os.sched_getaffinity(0)) / max(1, len(self.devices))
        share = one.job.slots / self.plan.slots
        return {
            "suites": list(self.plan.suites),
            "bundle": str(self.directory.absolute() / "bundle"),
            "device": "cuda" if self.devices else "cpu",
            "threads": max(1, round(cores * share)),
        }

    def _tell(self, *, over: bool = False) -> None:
        self._told_at = time.monotonic()
        content = {
            "over": over,
            "minutes": round((self._told_at - self._began) / 60.0, 2),
            "minutes_left": round((self.end - self._told_at) / 60.0, 2),
            "jobs": {one.job.name: one.told() for one in self.jobs},
        }
        replace(self.directory / "status.json", (json.dumps(content, indent=1) + "\n").encode())

    def _say(self, text: str) -> None:
        line = f"{time.monotonic() - self._began:7.1f} s  {text}\n"
        sys.stdout.write(line)
        sys.stdout.flush()
        for folder in (self.directory, self.directory / "bundle"):
            folder.mkdir(parents=True, exist_ok=True)
            with (folder / "campaign.log").open("a", encoding="utf-8") as file:
                file.write(line)


def devices_of(gpus: str) -> list[str]:
    """What ``CUDA_VISIBLE_DEVICES`` calls so many GPUs, or all of them.

    Raises:
        TrainingError: there are fewer.
    """
    import torch  # noqa: PLC0415 - the watching needs none

    count = torch.cuda.device_count()
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    names = [name.strip() for name in visible.split(",") if name.strip()] if visible else [str(i) for i in range(count)]
    names = names[:count]
    if gpus == "auto":
        return names
    if not gpus.isdecimal():
        raise TrainingError(f"gpus: is {gpus!r}; give auto or a number, 0 for the CPU")
    if int(gpus) > len(names):
        raise TrainingError(f"gpus: is {gpus}, and torch finds {len(names)} here; give fewer, or auto")
    return names[: int(gpus)]


def watch(directory: Path, seconds: float) -> bool:
    """Wait until a campaign is over, or for so long, and tell how far it is; gives whether it is over."""
    end = time.monotonic() + seconds
    status: dict[str, Any] = {}
    while True:
        path = directory / "status.json"
        status = json.loads(path.read_text("utf-8")) if path.is_file() else {}
        left = end - time.monotonic()
        if status.get("over") or left <= 0.0:
            break
        time.sleep(min(1.0, left))
    for name, told in status.get("jobs", {}).items():
        rest = ", ".join(f"{key} {value:g}" for key, value in told.items() if isinstance(value, float))
        print(f"{told['state']:8} {name}: {rest}")
    print("over" if status.get("over") else f"{status.get('minutes_left', '?')} minutes are left")
    return bool(status.get("over"))


def _main() -> int:
    parser = argparse.ArgumentParser(prog="python -m wrongturn_agents.training.campaign", description=__doc__)
    parser.add_argument("plan", nargs="?", type=Path, help="a plan in TOML; see read_plan")
    parser.add_argument("--default", action="store_true", help="five seeds of each agent, and the ablations")
    parser.add_argument("--gpus", default="auto", help="auto, or how many; 0 for the CPU")
    parser.add_argument("--minutes", type=float, help="of wall clock, with everything")
    parser.add_argument("--directory", type=Path, required=True)
    parser.add_argument("--scale", type=float, default=1.0, help="factor of the default plan's minutes for each run")
    parser.add_argument("--share-encoder", action="store_true", help="one pretraining for all seeds of ppo-image")
    parser.add_argument("--option", action="append", default=[], help="name=value, for all runs of the default plan")
    parser.add_argument("--background", action="store_true", help="begin, and come back at once")
    parser.add_argument("--watch", type=float, metavar="SECONDS", help="wait for one that runs, and tell of it")
    arguments = parser.parse_args()
    if arguments.background:
        arguments.directory.mkdir(parents=True, exist_ok=True)
        (arguments.directory / "status.json").unlink(missing_ok=True)
        again = [argument for argument in sys.argv[1:] if argument != "--background"]
        if arguments.watch is not None:
            again = _without_watch(again)
        command = [sys.executable, "-m", "wrongturn_agents.training.campaign", *again]
        with (arguments.directory / "output.txt").open("ab") as log:
            subprocess.Popen(  # noqa: S603 - our own
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
            )
    elif arguments.watch is None:
        if (arguments.plan is None) != arguments.default or arguments.minutes is None:
            parser.error("give a plan or --default, and --minutes")
        plan = (
            default_plan(scale=arguments.scale, share_encoder=arguments.share_encoder, options=tuple(arguments.option))
            if arguments.default
            else read_plan(arguments.plan)
        )
        campaign = Campaign(plan, arguments.directory, devices_of(arguments.gpus), arguments.minutes)
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: setattr(campaign, "stopped", True))
        return 0 if campaign.run() else 1
    if arguments.watch is not None:
        watch(arguments.directory, arguments.watch)
    return 0


def _without_watch(arguments: list[str]) -> list[str]:
    place = next((i for i, argument in enumerate(arguments) if argument.startswith("--watch")), len(arguments))
    return arguments[:place] + arguments[place + (1 if "=" in "".join(arguments[place : place + 1]) else 2) :]


if __name__ == "__main__":
    sys.exit(_main())
