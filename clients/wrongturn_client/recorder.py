"""The worker's own record of its episodes."""

import contextlib
import hashlib
import platform
import statistics
import struct
from dataclasses import dataclass, field
from importlib import metadata
from typing import Final

from wrongturn_protocol import Action, EpisodeRecord

_ACTION: Final = struct.Struct("<3f")


@dataclass
class EpisodeRecorder:
    """Collects what the worker did in one episode."""

    episode: str
    latencies: list[float] = field(default_factory=list)
    """Seconds that each decision took."""
    actions: bytearray = field(default_factory=bytearray)
    """Little-endian float32 [n, 3]."""

    def add(self, action: Action, latency: float) -> None:
        """Add a decision and the seconds it took."""
        self.latencies.append(latency)
        self.actions += _ACTION.pack(action.steer, action.throttle, action.brake)

    def record(self) -> EpisodeRecord:
        """Return the record that is posted to the service."""
        return EpisodeRecord(
            episode=self.episode,
            steps=len(self.latencies),
            actions_sha256=hashlib.sha256(self.actions).hexdigest(),
            latency_ms=statistics.median(self.latencies) * 1000 if self.latencies else None,
        )


def installed_versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that influence a result."""
    versions = {"python": platform.python_version()}
    for name in ("wrongturn-client", "wrongturn-agents", "numpy"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions
