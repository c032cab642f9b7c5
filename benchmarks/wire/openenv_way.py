"""OpenEnv's own server and client with an observation of the same size: run by the python that has openenv-core.

``openenv_way.py SECONDS-OF-WORK BYTES ROUNDS SECONDS`` prints steps a second of each round, with deflate and without.
"""

import asyncio
import base64
import json
import multiprocessing
import os
import socket
import sys
import time
from typing import Any

import uvicorn
from openenv.core.env_server.http_server import create_fastapi_app
from openenv.core.env_server.interfaces import Environment
from openenv.core.env_server.types import Action, Observation, State
from openenv.core.generic_client import GenericEnvClient


def serve(port: int, deflate: bool, duration: float, size: int) -> None:
    picture = os.urandom(size)

    class Steer(Action):
        steer: float

    class Picture(Observation):
        data: str

    class Emulated(Environment):  # type: ignore[misc]
        SUPPORTS_CONCURRENT_SESSIONS = True

        def reset(self, *_: Any, **__: Any) -> Picture:
            return Picture(data=base64.b64encode(picture).decode())

        def step(self, *_: Any, **__: Any) -> Picture:
            end = time.thread_time() + duration
            while time.thread_time() < end:
                pass
            return Picture(data=base64.b64encode(picture).decode(), reward=1.0)

        @property
        def state(self) -> State:
            return State()

    app = create_fastapi_app(Emulated, Steer, Picture)
    uvicorn.run(app, port=port, log_level="error", ws_per_message_deflate=deflate)


async def rates(port: int, rounds: int, seconds: float) -> list[float]:
    found = []
    async with GenericEnvClient(base_url=f"ws://127.0.0.1:{port}") as env:
        await env.reset()
        for _ in range(rounds):
            count, begin = 0, time.perf_counter()
            while time.perf_counter() < begin + seconds:
                result = await env.step({"steer": 0.0})
                base64.b64decode(result.observation["data"])
                count += 1
            found.append(count / (time.perf_counter() - begin))
    return found


def main() -> None:
    duration, size, rounds, seconds = float(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
    told = {}
    for name, deflate in (("as it comes", True), ("deflate off", False)):
        with socket.create_server(("127.0.0.1", 0)) as free:
            port = free.getsockname()[1]
        process = multiprocessing.Process(target=serve, args=(port, deflate, duration, size), daemon=True)
        process.start()
        for _ in range(300):
            time.sleep(0.2)
            try:
                socket.create_connection(("127.0.0.1", port)).close()
                break
            except OSError:
                pass
        told[name] = asyncio.run(rates(port, rounds, seconds))
        process.terminate()
    print(json.dumps(told))


if __name__ == "__main__":
    main()
