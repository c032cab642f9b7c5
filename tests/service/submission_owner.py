"""An owner that hands models in by plain HTTP, and follows them."""

import time
import uuid
from collections.abc import Callable
from typing import Any

import httpx
from service_harness import expect

OVER = ("finished", "failed", "cancelled")


class Owner:
    """One registered owner."""

    def __init__(self, url: str, name: str | None = None) -> None:
        with httpx.Client(base_url=url, timeout=60) as http:
            body = {"name": name or f"owner {uuid.uuid4().hex[:12]}"}
            registered = expect(http.post("/v1/owners", json=body), 201)
        self.name: str = registered["name"]
        self.token: str = registered["token"]
        self._move(url)

    def _move(self, url: str) -> None:
        self.http = httpx.Client(base_url=url, timeout=120, headers={"Authorization": f"Bearer {self.token}"})

    def close(self) -> None:
        self.http.close()

    def move(self, url: str) -> None:
        """Go on with the service that runs at another URL now."""
        self.http.close()
        self._move(url)

    def post(self, model: bytes, name: str | None, suite: str = "smoke@3", **headers: str) -> httpx.Response:
        fields = {"suite": suite} if name is None else {"suite": suite, "name": name}
        return self.http.post("/v1/submissions", data=fields, files={"model": ("a.onnx", model)}, headers=headers)

    def hand_in(self, model: bytes, name: str | None = None, suite: str = "smoke@3") -> str:
        """Hand a model in and return the id of its submission."""
        body = expect(self.post(model, name or f"model {uuid.uuid4().hex[:12]}", suite), 202)
        submission: str = body["id"]
        return submission

    def get(self, submission: str) -> dict[str, Any]:
        return expect(self.http.get(f"/v1/submissions/{submission}"), 200)

    def log(self, submission: str) -> list[str]:
        lines = expect(self.http.get(f"/v1/submissions/{submission}/log"), 200)["lines"]
        return [line["message"] for line in lines]

    def cancel(self, submission: str) -> dict[str, Any]:
        return expect(self.http.delete(f"/v1/submissions/{submission}"), 200)

    def until(self, submission: str, *states: str, seconds: float = 240) -> dict[str, Any]:
        """Wait until a submission is in one of these states; in one in which it stays, if none is named."""
        found: dict[str, Any] = {}

        def there() -> bool:
            nonlocal found
            found = self.get(submission)
            if states and found["state"] in OVER and found["state"] not in states:
                raise AssertionError(f"{found}\n" + "\n".join(self.log(submission)))
            return found["state"] in (states or OVER)

        until(there, seconds)
        return found


def until(condition: Callable[[], bool], seconds: float = 240) -> None:
    """Wait until something has happened. To be asked takes the service some milliseconds each time."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"it has not happened within {seconds:g} s"
        time.sleep(0.1)
