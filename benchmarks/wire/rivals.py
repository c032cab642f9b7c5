"""Other environments' ways, each beside ours."""

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import emulation
import servers
from rates import by_turns
from ways import Batch

from wrongturn_client import Client
from wrongturn_protocol import PracticeRequest, Track

HERE = Path(__file__).parent


def compared(given: argparse.Namespace, client: Client, folder: str) -> dict[str, Any]:
    """What was asked for; what could not be measured is told and left out."""
    found: dict[str, Any] = {}
    rounds, seconds = str(given.rounds), str(2 * given.seconds)
    if given.openenv:
        theirs = _told(
            [str(given.openenv), "openenv_way.py", f"{given.work * 1e-6}", f"{emulation.SIZE}", rounds, seconds]
        )
        found["openenv"] = _shown("OpenEnv, the same observation", theirs, _ours(given, Batch(client, 1)))
    if given.others or given.real:
        with contextlib.ExitStack() as stack:
            port, _ = stack.enter_context(servers.started(servers.service, folder, False, 4))
            url = f"http://127.0.0.1:{port}"
            with Client(url, timeout=600) as anybody:
                anybody.ready()  # its simulators may have to be compiled first
            found["real"] = {}
            for track in (Track.STATE, Track.PRIVILEGED, Track.CAMERA):
                with Client(url) as anybody:
                    token = anybody.register(f"real {track}", track).token
                with Client(url, token) as agent:
                    request = PracticeRequest(town="Town01", approach="J3-S", track=track)
                    found["real"][track.value] = _ours(given, Batch(agent, 1, request))
        if given.others:
            theirs = _told(
                [sys.executable, "others_way.py", rounds, seconds],
                PYTHONPATH=os.pathsep.join([str(given.others), os.environ.get("PYTHONPATH", "")]),
            )
            for name, ours in found["real"].items():
                found[f"others, ours {name}"] = _shown(f"in process; ours over the wire, {name}", theirs, ours)
    return found


def _ours(given: argparse.Namespace, step: Any) -> list[float]:
    return [one["ours"] for one in by_turns({"ours": (step, 1)}, given.rounds, 2 * given.seconds)]


def _told(command: list[str], **environment: str) -> dict[str, Any]:
    ran = subprocess.run(
        command, cwd=HERE, env={**os.environ, **environment}, stdout=subprocess.PIPE, text=True, check=False
    )
    if ran.returncode:
        print(f"{command[1]} failed with status {ran.returncode}")
        return {}
    told: dict[str, Any] = json.loads(ran.stdout.splitlines()[-1])
    for why in told.pop("absent", []):
        print(f"not measured: {why}")
    return told


def _shown(title: str, theirs: dict[str, list[float]], ours: list[float]) -> dict[str, Any]:
    print(f"\n{title}: ours {statistics.median(ours):,.0f} steps/s")
    for name, rates in theirs.items():
        ratio = statistics.median(ours) / statistics.median(rates)
        print(f"  {name:44}{statistics.median(rates):8,.0f} steps/s   ours is {ratio:.1f} times as many")
    return {"ours": ours, "theirs": theirs}
