"""What a worker itself saw of its episodes."""

import hashlib
import statistics
import struct
from dataclasses import dataclass, field
from typing import Final

from wrongturn_protocol import Action, EpisodeRecord

_ACTION: Final = struct.Struct("<3f")


@dataclass
class EpisodeRecorder:
    """What the worker itself saw of an episode."""

    episode: str
    steps: int = 0
    latencies: list[float] = field(default_factory=list)
    """Seconds that each decision took."""
    actions: bytearray = field(default_factory=bytearray)
    """Little-endian float32 [n, 3]."""

    def add(self, action: Action, latency: float) -> None:
        """Note a decision."""
        self.steps += 1
        self.latencies.append(latency)
        self.actions += _ACTION.pack(action.steer, action.throttle, action.brake)

    def message(self) -> EpisodeRecord:
        """The record as it is posted."""
        return EpisodeRecord(
            episode=self.episode,
            steps=self.steps,
            actions_sha256=hashlib.sha256(self.actions).hexdigest(),
            latency_ms=statistics.median(self.latencies) * 1000 if self.latencies else None,
        )
