"""``script/demo``: start a service, drive the baselines against it as processes, and print the ranking."""

import argparse
import fcntl
import json
import os
import secrets
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from rich.progress import Progress as Bars

from wrongturn_agents.errors import AgentsError
from wrongturn_agents.progress import LinesProgress, Progress, add_bar, progress_bars
from wrongturn_agents.registry import AGENTS, resolve
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_client import Client, LocalService, WrongturnError
from wrongturn_client.listings import listing
from wrongturn_client.settings import OPERATOR_TOKEN
from wrongturn_client.tables import console, leaderboard_table

_AT_A_TIME: Final = 2
_USAGE: Final = 2  # exit status of argparse
_TAIL: Final = 5  # lines shown of a failed worker's output


class DemoError(AgentsError):
    """The demo cannot start."""


class DemoUsageError(DemoError):
    """An option names an agent or a suite that does not exist."""


@dataclass
class Worker:
    """Process that runs ``wrongturn run`` for one agent."""

    agent: str
    url: str
    suite: str
    operator_token: str
    folder: Path
    process: subprocess.Popen[str] | None = None
    tail: deque[str] = field(default_factory=lambda: deque(maxlen=_TAIL))
    """Last lines of its output that are not progress."""

    def run(self, progress: Progress) -> int:
        """Run the process to its end and return its exit status."""
        command = [sys.executable, "-m", "wrongturn_client", "run", self.agent]
        command += ["--url", self.url, "--suite", self.suite, "--progress", "json"]
        environment = {name: value for name, value in os.environ.items() if name != "WRONGTURN_TOKEN"}
        environment |= {OPERATOR_TOKEN: self.operator_token, "WRONGTURN_HOME": str(self.folder / "workers")}
        self.process = subprocess.Popen(  # noqa: S603 - our own program
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=environment,
            process_group=0,  # Ctrl-C reaches only the demo, which then stops its workers
        )
        assert self.process.stderr is not None
        with self.process.stderr as lines:
            for line in lines:
                try:
                    done = json.loads(line)
                    progress(done["finished"], done["total"])
                except (ValueError, TypeError, KeyError):
                    self.tail.append(line.rstrip())
        return self.process.wait()

    def stop(self) -> None:
        """Stop the process if it is running."""
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo and return its exit status."""
    options = _options(arguments)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        agents, suite = _checked(options.agents, options.suite)
        with _folder(Path("demo")) as folder:
            return _demo(agents, suite, folder)
    except (AgentsError, WrongturnError) as error:
        print(f"script/demo: {error}", file=sys.stderr)
        return _USAGE if isinstance(error, DemoUsageError) else 1
    except KeyboardInterrupt:
        print("script/demo: interrupted", file=sys.stderr)
        return 130


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="script/demo",
        description="Drive the baseline agents through a suite, each over HTTP, and rank them. "
        "Example: script/demo --agents careful,parked --suite smoke@2",
    )
    parser.add_argument("--agents", default=",".join(AGENTS), metavar="A,B", help="agents (default: %(default)s)")
    parser.add_argument("--suite", default=WRONG_COMMAND, help="suite of trials (default: %(default)s)")
    return parser.parse_args(arguments)


def _checked(agents: str, suite: str) -> tuple[list[str], str]:
    """Return the agents' names and the suite after a check that they exist.

    Raises:
        DemoUsageError: One of them does not exist.
    """
    names = [name.strip() for name in agents.split(",") if name.strip()]
    if not names:
        raise DemoUsageError(f"--agents: names no agent; known are {', '.join(AGENTS)}")
    if len(set(names)) < len(names):
        raise DemoUsageError(f"--agents: {agents} names an agent twice; name each once")
    for name in names:
        try:
            resolve(name)
        except AgentsError as error:
            raise DemoUsageError(f"--agents: {str(error).removeprefix('agent: ')}") from error
    known = [item["id"] for item in listing("suites", None)]
    if suite not in known:
        raise DemoUsageError(f"--suite: there is no suite {suite!r}; known are {', '.join(known)}")
    return names, suite


@contextmanager
def _folder(path: Path) -> Iterator[Path]:
    """Lock the demo's folder, remove the last demo's files from it, and yield its absolute path.

    Raises:
        DemoError: The folder cannot be written, or another demo runs in it.
    """
    folder = path.absolute()
    try:
        folder.mkdir(exist_ok=True)
        lock = (folder / "lock").open("w")
    except OSError as error:
        raise DemoError(f"{folder}: cannot be written ({error.strerror}); run it where you may write") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise DemoError(f"{folder}: another demo is running there; wait for its end") from error
        for pattern in ("wrongturn.db*", "leaderboard.json", "service.log", "workers/runs/*.json"):
            for file in folder.glob(pattern):
                file.unlink()
        yield folder


def _demo(agents: list[str], suite: str, folder: Path) -> int:
    began = time.monotonic()
    database, log = folder / "wrongturn.db", folder / "service.log"
    operator_token = secrets.token_urlsafe(32)
    environment = {OPERATOR_TOKEN: operator_token, f"{OPERATOR_TOKEN}_FILE": ""}
    print("Starting the service …", flush=True)
    with LocalService(database=f"sqlite+aiosqlite:///{database}", environment=environment, log=log) as service:
        print(f"The service is at {service.url}. Driving {', '.join(agents)} through {suite} over HTTP …", flush=True)
        workers = [Worker(agent, service.url, suite, operator_token, folder) for agent in agents]
        failed = _run_all(workers)
        with Client(service.url, operator_token) as client:
            leaderboard = client.leaderboard(suite)
    console().print(leaderboard_table(leaderboard))
    written = folder / "leaderboard.json"
    written.write_text(json.dumps(leaderboard.model_dump(mode="json"), indent=2) + "\n", encoding="utf-8")
    print(f"Ranking as JSON: demo/{written.name} (took {time.monotonic() - began:.0f} s).")
    for worker in failed:
        print(f"script/demo: the worker of {worker.agent} failed:", *worker.tail, sep="\n  ", file=sys.stderr)
    if failed:
        return 1
    print("To start a service that keeps running: .venv/bin/wrongturn serve")
    return 0


def _run_all(workers: list[Worker]) -> list[Worker]:
    """Run the workers two at a time, show their progress, and return those that failed."""
    screen = console()
    bars = progress_bars(screen) if screen.is_terminal else None
    pool = ThreadPoolExecutor(_AT_A_TIME)
    with bars or nullcontext():
        try:
            jobs = {pool.submit(worker.run, _progress_of(worker, bars)): worker for worker in workers}
            return [jobs[job] for job in as_completed(jobs) if job.result() != 0]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.stop()
            raise
        finally:
            pool.shutdown()


def _progress_of(worker: Worker, bars: Bars | None) -> Progress:
    return LinesProgress(worker.agent, sys.stdout) if bars is None else add_bar(bars, worker.agent)


if __name__ == "__main__":
    sys.exit(main())
