"""The way of one step: how many of our files and functions it runs through, and how often it changes the file.

    .venv/bin/python lab/step_way.py [--socket] [--show]

Client and service run in two threads of this process, the simulator in its own; each notes the calls of our functions.
``--show`` lists them.
"""

import itertools
import json
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import FrameType

PARTS = ("wrongturn_client", "wrongturn_protocol", "wrongturn_networks", "wrongturn_sim", "wrongturn_service")
Call = tuple[str, str]
calls: dict[str, list[Call]] = {}
"""Calls by the side on which they were made: file and function."""


def note(frame: FrameType, event: str, _: object) -> None:
    """Note a call of ours, for Python's profiler."""
    path = Path(frame.f_code.co_filename).parts
    part = next((at for at, name in enumerate(path) if name in PARTS), None)
    if event == "call" and part is not None and "<" not in frame.f_code.co_name.replace("<lambda>", ""):
        side = "client" if threading.current_thread() is threading.main_thread() else "service"
        calls.setdefault(side, []).append(("/".join(path[part:]), frame.f_code.co_qualname))


def simulator(file: str) -> None:
    """Run a simulator process that writes the calls of its last step to a file."""
    from wrongturn_service.simulators import worker

    answer = worker.Server.answer

    def noted(self: worker.Server, request: list[object]) -> list[object]:
        calls.clear()
        sys.setprofile(note if request[0] == "step" else None)
        reply = answer(self, request)
        sys.setprofile(None)
        if request[0] == "step":
            Path(file).write_text(json.dumps(calls["client"]))
        return reply

    worker.Server.answer = noted  # type: ignore[method-assign]
    worker.main()


def main() -> None:
    """Print what a step runs through."""
    from wrongturn_client import Client
    from wrongturn_protocol import PracticeRequest
    from wrongturn_service import server
    from wrongturn_service.address import bind
    from wrongturn_service.settings import Settings
    from wrongturn_service.simulators.local_pool import LocalPool

    with tempfile.TemporaryDirectory() as folder:
        steps = f"{folder}/steps.json"
        LocalPool.__init__.__kwdefaults__["command"] = (sys.executable, __file__, steps)  # type: ignore[index]
        settings = Settings(port=0, database=f"sqlite+aiosqlite:///{folder}/wrongturn.db", simulators=1)
        bound = bind(settings.host, 0)
        threading.setprofile(note)
        threading.Thread(target=server.run, args=(settings, bound), daemon=True).start()
        url = f"http://127.0.0.1:{bound.getsockname()[1]}"
        token = Client(url, timeout=300).register("way of a step", "state").token
        client = Client(url, token)
        driving = client.drive() if "--socket" in sys.argv else client
        episode = driving.practise(PracticeRequest(town="Town01", approach="J3-S", seed=1)).id
        for seq in (1, 2):  # the first loads what is rarely needed
            time.sleep(1)
            calls.clear()
            sys.setprofile(note)
            driving.step(episode, seq, (0.0, 0.5, 0.0))
            sys.setprofile(None)
        time.sleep(0.5)
        calls["simulator"] = [tuple(call) for call in json.loads(Path(steps).read_text())]
    way = [call for side in ("client", "service", "simulator") for call in calls[side]]
    for name, part in [*calls.items(), ("all", way)]:
        changes = sum(before[0] != after[0] for before, after in itertools.pairwise(part))
        print(f"{name}: {len({file for file, _ in part})} files, {len(set(part))} functions, {changes} changes of file")
    if "--show" in sys.argv:
        for side, part in calls.items():
            print("\n".join([f"\n{side}", *(f"  {file}: {function}" for file, function in part)]))


if __name__ == "__main__":
    simulator(sys.argv.pop(1)) if sys.argv[1:2] and sys.argv[1].endswith(".json") else main()
