"""The certificates that this service issues, and the key that signs them."""

import asyncio
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import orjson
import rfc8785
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from wrongturn_networks import commitment_of
from wrongturn_protocol import EpisodeState, EvaluationState, ProblemType
from wrongturn_protocol.certificates import KeyList, SigningKey, fingerprint
from wrongturn_service import catalogue
from wrongturn_service.accounts import detail
from wrongturn_service.errors import ConflictError, InvalidRequestError
from wrongturn_service.secret_file import read_secret
from wrongturn_service.storage.administration import Act, AdministrationStore
from wrongturn_service.storage.finished import FinishedStore
from wrongturn_service.storage.models import EvaluationRow
from wrongturn_service.storage.store import Store

_EPISODE = ("id", "steps", "trajectory_sha256", "actions_sha256")


def key_in(file: Path) -> bytes:
    """Return the private key that a file holds. Raises ValueError if it holds none."""
    digits = read_secret(file)
    if not re.fullmatch("[0-9a-fA-F]{64}", digits):
        raise ValueError(f"{file} holds no 64 hexadecimal digits; to make a key: openssl rand -hex 32")
    return bytes.fromhex(digits)


class Certificates:
    """Signs the records of finished evaluations, with one key at a time.

    ``file`` holds the private key. Without it the database does, so that backups keep it.
    """

    def __init__(self, rows: AdministrationStore, store: Store, finished: FinishedStore, file: Path | None) -> None:
        self._rows, self._store, self._finished, self._file = rows, store, finished, file
        self._key: Ed25519PrivateKey
        self.public = ""
        """The public key that signs now, hexadecimal."""

    async def use(self, act: Act | None = None) -> None:
        """Sign with the key of the file, or the stored one; with a new one if there is none, or for an operator's act.

        Raises ValueError if the file has no key, a retired one, or for an operator's act the one that signs.
        """
        now = next(iter(await self._rows.keys()), None)
        stored = None if now is None or act is not None else now.private
        if self._file is not None:
            stored = key_in(self._file)
        key = Ed25519PrivateKey.generate() if stored is None else Ed25519PrivateKey.from_private_bytes(stored)
        public = key.public_key().public_bytes_raw().hex()
        if now is None or now.public != public:
            await self._rows.add_key(public, None if self._file else key.private_bytes_raw(), act)
        elif act is not None:
            raise ValueError(f"{self._file} holds the key that signs; write a new one into it")
        self._key, self.public = key, public

    async def rotate(self, act: Act) -> SigningKey:
        """Sign with a new key from now on. Raises InvalidRequestError if the key's file has none."""
        try:
            await self.use(act)
        except ValueError as error:
            raise InvalidRequestError("WRONGTURN_SIGNING_KEY_FILE", str(error)) from None
        return (await self.keys()).keys[0]

    async def keys(self) -> KeyList:
        """Return the public keys, the one that signs first."""
        return KeyList(
            keys=tuple(
                SigningKey(
                    key=row.public,
                    fingerprint=fingerprint(row.public),
                    created=_iso(row.created),
                    retired=None if row.retired is None else _iso(row.retired),
                )
                for row in await self._rows.keys()
            )
        )

    async def of(self, row: EvaluationRow) -> bytes:
        """Return the certificate of an evaluation, as canonical JSON. Raises ConflictError if it is not finished."""
        agent = await self._store.agent(row.agent_id)
        if agent is None or row.state != EvaluationState.FINISHED:
            text = f"evaluation {row.id} is {row.state}; its certificate is there once it is finished"
            raise ConflictError(ProblemType.EVALUATION_OPEN, text)
        drawn, key, public = bool(catalogue.suite(row.suite).cells), self._key, self.public
        record: dict[str, Any] = {
            "format": "wrongturn-certificate",
            "version": 1,
            "evaluation": row.id,
            "suite": row.suite,
            "suite_sha256": row.suite_sha256,
            "agent": detail(agent).model_dump(mode="json"),
            "entry": row.entry,
            "counts": row.id in await self._finished.counting(row.agent_id),
            "begun": _iso(row.created),
            "finished": _iso(row.finished or row.created),
            "commitment": commitment_of(row.secret) if drawn else None,
            "secret": row.secret if drawn else None,
            "versions": orjson.loads(row.versions or "{}"),
            "metrics": orjson.loads(row.metrics or "{}"),
        }
        episodes = await self._store.episodes(row.id, EpisodeState.FINISHED)

        def signed() -> bytes:
            record["episodes"] = [
                {name: getattr(one, name) for name in _EPISODE}
                | {"trial": orjson.loads(one.trial), "outcome": orjson.loads(one.outcome or "{}")}
                for one in episodes
            ]
            signature = key.sign(rfc8785.dumps(record)).hex()
            return rfc8785.dumps({"record": record, "key": public, "signature": signature})

        return await asyncio.to_thread(signed)


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")
