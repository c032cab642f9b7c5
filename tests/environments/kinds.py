"""The environments of the contract: in process and over the wire, by the ids that users make them with."""

from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np

from wrongturn_client import Client

GAS = np.float32([0.1, 0.5, 0.0])
BRAKE = np.float32([0.0, 0.0, 1.0])


@dataclass
class Environments:
    """How to make one kind of environment: the first names are what a user writes."""

    id: str
    options: dict[str, Any]
    tokens: dict[str, str] = field(default_factory=dict)
    """Of an agent for each track."""
    made: list[Any] = field(default_factory=list)

    def one(self, **options: Any) -> gymnasium.Env[Any, Any]:
        """One environment, without Gymnasium's wrappers, whose checks would come before ours."""
        self.made.append(gymnasium.make(self.id, **self.all(options)).unwrapped)
        return self.made[-1]

    def many(self, number: int = 2, **options: Any) -> Any:
        self.made.append(gymnasium.make_vec(self.id, num_envs=number, **self.all(options)))
        return self.made[-1]

    def close(self) -> None:
        while self.made:
            self.made.pop().close()

    def all(self, given: dict[str, Any]) -> dict[str, Any]:
        options = {} if {"suite", "town"} & given.keys() else {"town": "junctions"}
        options |= self.options | given
        if self.is_remote:
            track = str(options.get("track", "state"))
            if track in {"state", "camera", "segmentation", "privileged"}:
                options["token"] = self._token(track)
        return options

    @property
    def is_remote(self) -> bool:
        return "url" in self.options

    def _token(self, track: str) -> str:
        if track not in self.tokens:
            with Client(self.options["url"], "") as client:
                self.tokens[track] = client.register(f"contract {track}", track).token
        return self.tokens[track]


def same(one: Any, batch: Any, i: int) -> None:
    """An observation has the bytes of a batch's row."""
    assert one.keys() == batch.keys()
    for name, array in one.items():
        assert array.dtype == batch[name].dtype, name
        assert array.shape == batch[name].shape[1:], name
        assert array.tobytes() == np.ascontiguousarray(batch[name][i]).tobytes(), name
