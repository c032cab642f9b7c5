"""Messages about certificates: the signed record of a finished evaluation, and the keys that sign."""

import hashlib
from typing import Annotated, Literal

from pydantic import StringConstraints

from wrongturn_protocol.accounts import AgentDetail
from wrongturn_protocol.catalogue import Sha256
from wrongturn_protocol.episodes import Message, Outcome, Trial
from wrongturn_protocol.results import Metrics
from wrongturn_protocol.vocabulary import Entry

PublicKey = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
"""The 32 bytes of an Ed25519 public key, hexadecimal."""
Id = Annotated[str, StringConstraints(pattern=r"^\w{1,40}$")]
"""Id of an evaluation or an episode, which becomes part of an address and of a file's name."""


class CertifiedEpisode(Message):
    """A finished episode."""

    id: Id
    trial: Trial
    outcome: Outcome
    steps: int
    trajectory_sha256: Sha256 | None
    """Of the bytes of ``GET /v1/episodes/{id}/trajectory``; None if it was aborted without a simulator."""
    actions_sha256: Sha256 | None
    """Of the actions as little-endian float32 [n, 3] (steer, throttle, brake)."""


class Record(Message):
    """What a certificate says."""

    format: Literal["wrongturn-certificate"]
    version: Literal[1]
    evaluation: Id
    suite: str
    suite_sha256: Sha256
    agent: AgentDetail
    entry: Entry
    counts: bool
    """Whether it is the first evaluation that the agent began on the suite: the one that is ranked."""
    begun: str
    """ISO 8601 in UTC."""
    finished: str
    commitment: Sha256 | None
    """SHA-256 of the secret, told at the beginning. None for a suite that lists its trials."""
    secret: str | None
    versions: dict[str, str]
    """Versions of the service's packages when the evaluation finished."""
    episodes: tuple[CertifiedEpisode, ...]
    metrics: Metrics


class Certificate(Message):
    """``GET /v1/evaluations/{id}/certificate``."""

    record: Record
    key: PublicKey
    signature: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{128}$")]
    """Ed25519 signature of the record's canonical JSON (RFC 8785), hexadecimal."""


class SigningKey(Message):
    """A public key with which the service signs, or has signed."""

    key: PublicKey
    fingerprint: Sha256
    """SHA-256 of the key's 32 bytes, to compare by eye."""
    created: str
    """ISO 8601 in UTC."""
    retired: str | None
    """When the operator replaced it. None for the one that signs now."""


class KeyList(Message):
    """``GET /v1/keys``: the key that signs now, then those before it."""

    keys: tuple[SigningKey, ...]


def fingerprint(key: str) -> str:
    """Return the SHA-256 of a public key's bytes."""
    return hashlib.sha256(bytes.fromhex(key)).hexdigest()
