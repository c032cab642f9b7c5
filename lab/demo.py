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
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Final

from wrongturn_agents.errors import AgentsError
from wrongturn_agents.progress import add_bar, lines_progress, progress_bars
from wrongturn_agents.registry import AGENTS, resolve
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite
from wrongturn_client import Client, LocalService, WrongturnError
from wrongturn_client.settings import OPERATOR_TOKEN
from wrongturn_client.tables import console, leaderboard_table

_AT_A_TIME: Final = 2
_TAIL: Final = 5  # lines shown of a failed worker's output


class DemoError(AgentsError):
    """The demo cannot start."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the demo and return its exit status."""
    agents, suite = _options(arguments)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        with _folder(Path("demo")) as folder:
            return _demo(agents, suite, folder)
    except (AgentsError, WrongturnError) as error:
        print(f"script/demo: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("script/demo: interrupted", file=sys.stderr)
        return 130


def _options(arguments: Sequence[str] | None) -> tuple[list[str], str]:
    """Return the agents' names and the suite, which exist; else exit with the status 2."""
    parser = argparse.ArgumentParser(
        prog="script/demo",
        description="Drive the baseline agents through a suite, each over HTTP, and rank them. "
        "Example: script/demo --agents careful,parked --suite smoke@3",
    )
    parser.add_argument("--agents", default=",".join(AGENTS), metavar="A,B", help="agents (default: %(default)s)")
    parser.add_argument("--suite", default=WRONG_COMMAND, help="suite of trials (default: %(default)s)")
    options = parser.parse_args(arguments)
    names = [name.strip() for name in options.agents.split(",") if name.strip()]
    if not names:
        parser.error(f"--agents: names no agent; known are {', '.join(AGENTS)}")
    if len(set(names)) < len(names):
        parser.error(f"--agents: {options.agents} names an agent twice; name each once")
    try:
        for name in names:
            resolve(name)
        installed_suite(options.suite)
    except AgentsError as error:
        parser.error(f"--{str(error).replace('agent: ', 'agents: ', 1)}")
    return names, options.suite


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
        environment = {name: value for name, value in os.environ.items() if name != "WRONGTURN_TOKEN"}
        environment |= {OPERATOR_TOKEN: operator_token, "WRONGTURN_HOME": str(folder / "workers")}
        failed = drive_all(agents, ["--url", service.url, "--suite", suite], environment)
        with Client(service.url, operator_token) as client:
            leaderboard = client.leaderboard(suite)
    console().print(leaderboard_table(leaderboard))
    written = folder / "leaderboard.json"
    written.write_text(json.dumps(leaderboard.model_dump(mode="json"), indent=2) + "\n", encoding="utf-8")
    print(f"Ranking as JSON: demo/{written.name} (took {time.monotonic() - began:.0f} s).")
    for agent, tail in failed.items():
        print(f"script/demo: the worker of {agent} failed:", *tail, sep="\n  ", file=sys.stderr)
    if failed:
        return 1
    print("To start a service that keeps running: .venv/bin/wrongturn serve")
    return 0


def drive_all(agents: Sequence[str], options: Sequence[str], environment: Mapping[str, str]) -> dict[str, list[str]]:
    """Run ``wrongturn run`` for each agent, two at a time, and show their progress.

    Return the last lines of those that failed, by agent. On an exception, such as Ctrl-C, stop all of them.
    """
    screen = console()
    bars = progress_bars(screen) if screen.is_terminal else None
    running: list[subprocess.Popen[str]] = []

    def drive(agent: str) -> list[str] | None:
        progress = lines_progress(agent, sys.stdout) if bars is None else add_bar(bars, agent)
        process = subprocess.Popen(  # noqa: S603 - our own program
            [sys.executable, "-m", "wrongturn_client", "run", agent, *options, "--progress", "json"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=environment,
            process_group=0,  # Ctrl-C reaches only the demo, which then stops its workers
        )
        running.append(process)
        tail: list[str] = []
        assert process.stderr is not None
        with process.stderr as lines:
            for line in lines:
                try:
                    done = json.loads(line)
                    progress(done["finished"], done["total"])
                except (ValueError, TypeError, KeyError):
                    tail.append(line.rstrip())
        return tail[-_TAIL:] if process.wait() else None

    pool = ThreadPoolExecutor(_AT_A_TIME)
    with bars or nullcontext():
        try:
            tails = zip(agents, pool.map(drive, agents), strict=True)
            return {agent: tail for agent, tail in tails if tail is not None}
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in running:
                process.terminate()
            raise
        finally:
            pool.shutdown()


if __name__ == "__main__":
    sys.exit(main())
