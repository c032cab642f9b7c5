"""A runner that plays what its model says, which is JSON in place of ONNX.

``{"notes": FOLDER, "track": T, "check": [ACT, …], "drive": [ACT, …]}``: one act for each start, the last one for all
that follow. Each start adds a line with its process id to ``FOLDER/check`` or ``FOLDER/drive``.
"""

import http.client
import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any, NoReturn
from urllib.parse import urlsplit

COAST = {"steer": 0.0, "throttle": 0.0, "brake": 0.0}


def say(event: str, **fields: object) -> None:
    sys.stdout.write(json.dumps({"event": event, **fields}) + "\n")
    sys.stdout.flush()


class Calls:
    def __init__(self, url: str, token: str) -> None:
        place = urlsplit(url)
        assert place.hostname is not None
        self._connection = http.client.HTTPConnection(place.hostname, place.port, timeout=60)
        self._headers = {"Authorization": f"Bearer {token}", "Content-Type": "application/json"}

    def __call__(self, method: str, path: str, body: object = None, expected: int = 200) -> tuple[int, Any]:
        self._connection.request(method, path, None if body is None else json.dumps(body), self._headers)
        answer = self._connection.getresponse()
        said = json.loads(answer.read() or b"null")
        if answer.status not in {expected, 409}:
            sys.exit(f"{method} {path}: {answer.status} {said}")
        return answer.status, said

    def step(self, episode: str, seq: int) -> bool:
        _, reply = self("POST", f"/v1/episodes/{episode}/step", {"seq": seq, "action": COAST})
        return bool(reply["terminated"] or reply["truncated"])


def end(act: str) -> NoReturn:
    """Do what the model wants at its end."""
    if act == "hang":
        time.sleep(600)
    if act == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if act == "no room":
        sys.exit(75)
    if act == "nonsense":
        sys.stdout.write("I have won\n")
        sys.stdout.flush()
        time.sleep(600)
    say("refused", reason=act)
    sys.exit(0)


def check(job: dict[str, Any], model: dict[str, Any], act: str) -> None:
    if act == "tell agent's track":
        end(f"agent's track: {job['agent_track']}")
    practised = act.endswith(" in practice")
    if act != "pass" and not practised:
        end(act)
    say("described", track=model["track"], description="a stand-in of 0 nodes")
    practice = json.loads(sys.stdin.readline())
    calls = Calls(job["url"], practice["token"])
    body = {"suite": practice["suite"], "trial": practice["trial"]}
    _, begun = calls("POST", "/v1/episodes", body, 201)
    calls.step(begun["id"], 1)
    if practised:
        end(act.removesuffix(" in practice"))
    calls("DELETE", f"/v1/episodes/{begun['id']}", expected=204)
    say("passed", step_ms=[1.0] * 6)


def drive(job: dict[str, Any], act: dict[str, Any]) -> None:
    if "at once" in act:
        end(act["at once"])
    calls = Calls(job["url"], job["token"])
    path = f"/v1/evaluations/{job['evaluation']}"
    for number in range(1000):
        status, begun = calls("POST", f"{path}/episodes", {}, 201)
        if status == 409:
            break
        seq = 1
        while not calls.step(begun["id"], seq):
            if number == act.get("after"):
                end(act["then"])
            seq += 1
        _, evaluation = calls("GET", path)
        say("progressed", finished=evaluation["finished"], episodes=12)
    say("driven")


def main() -> None:
    job = json.loads(sys.stdin.readline())
    model = json.loads(Path(job["model"]).read_text())
    notes = Path(model["notes"]) / job["task"]
    with notes.open("a") as file:
        file.write(f"{os.getpid()} {model.get('name', '')}\n")
    acts = model[job["task"]]
    act = acts[min(len(notes.read_text().splitlines()), len(acts)) - 1]
    if job["task"] == "check":
        check(job, model, act)
    else:
        drive(job, act)


if __name__ == "__main__":
    main()
