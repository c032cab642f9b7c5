"""Checks of a certificate against itself, what is installed here, and its trajectories. No service is asked."""

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import rfc8785
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from pydantic import BaseModel

from wrongturn_judge import JourneyGeometry, JudgeError, JudgeGeometry, Trajectory, UnscoredTrialError, compute, judge
from wrongturn_networks import NetworkError, commitment_of, load_suite
from wrongturn_networks.loading import town_of
from wrongturn_protocol import Verdict
from wrongturn_protocol.certificates import Certificate, CertifiedEpisode, Record, fingerprint

Finding = tuple[str, bool | None, str]
"""What was checked; whether it is good, None if it was not checked after all; and why, in words."""


def check_signature(
    certificate: Certificate, plain: Mapping[str, Any], trusted: Mapping[str, str]
) -> Iterator[Finding]:
    """Check who signed. ``plain`` is the record as the file has it. ``trusted`` has notes on the keys."""
    key = f"key {certificate.key}, fingerprint (SHA-256) {fingerprint(certificate.key)}"
    try:
        signer = Ed25519PublicKey.from_public_bytes(bytes.fromhex(certificate.key))
        signer.verify(bytes.fromhex(certificate.signature), rfc8785.dumps(dict(plain)))
    except (InvalidSignature, ValueError):
        yield "signature", False, "does not fit: record, key or signature was changed; --url names the record's field"
    else:
        yield "signature", True, f"fits the {key}"
    if not trusted:
        yield "key", None, "only the file names it, which proves nothing about who signed; give --key or --url"
    elif certificate.key in trusted:
        yield "key", True, f"is one that you trust{trusted[certificate.key]}"
    else:
        yield "key", False, f"is none that you trust: somebody else signed, or with a newer key: {key}"


def check_record(record: Record) -> Iterator[Finding]:
    """Check the commitment, that the secret draws these trials of the suite, and that the outcomes give the figures."""
    found = list(_check_draw(record))
    yield from found
    for about in sorted({"trials", "metrics"}.difference(about for about, *_ in found), reverse=True):
        yield about, None, "depends on what is refused above"


def _check_draw(record: Record) -> Iterator[Finding]:
    made = f"the certificate is from wrongturn-networks {record.versions.get('wrongturn-networks', '(unknown)')}"
    try:
        suite = load_suite(record.suite)
        if suite.sha256 != record.suite_sha256:
            yield "suite_sha256", False, f"that of the installed {suite.id} is {suite.sha256}; {made}: install that"
            return
        committed = None if record.secret is None else commitment_of(record.secret)
        good = committed == record.commitment and bool(suite.cells) is (record.secret is not None)
        yield "commitment", good, f"is {'' if good else 'not '}the SHA-256 of the secret"
        if not good:
            return
        draw = suite.draw(record.secret or "")
    except NetworkError as error:
        yield "suite", False, f"{error}; {made}"
        return
    drawn = {trial.id: trial for trial in draw.episodes}
    told = {episode.trial.id: (i, episode) for i, episode in enumerate(record.episodes)}
    wrong = [f"episodes: {name} is missing or there twice" for name in drawn if name not in told]
    wrong += [f"episodes: there are {len(record.episodes)}, not {len(drawn)}"] * (len(record.episodes) != len(drawn))
    for name, (i, episode) in told.items():
        wrong += differences(episode.trial, drawn.get(name), f"episodes[{i}].trial")
    yield (
        "trials",
        not wrong,
        in_words(wrong)
        or f"{'the secret draws' if suite.cells else 'the suite lists'} just these {len(drawn)} of {suite.id}",
    )
    if not wrong:
        try:
            found = compute(draw, {name: episode.outcome for name, (_, episode) in told.items()})
            wrong += differences(record.metrics, found, "metrics")
        except UnscoredTrialError as error:
            wrong.append(str(error))
        yield "metrics", not wrong, in_words(wrong) or "all counts, tables and intervals follow from the outcomes"


def check_trajectories(record: Record, trajectory: Callable[[str], bytes]) -> Iterator[Finding]:
    """Check the SHA-256 of each trajectory, and judge it again. ``trajectory`` returns that of an episode's id."""
    wrong: list[str] = []
    for i, episode in enumerate(record.episodes):
        if episode.trajectory_sha256 is not None:
            wrong += _wrong(episode, f"episodes[{i}]", trajectory(episode.id))
        elif episode.outcome.verdict is not Verdict.ABORTED:
            wrong.append(f"episodes[{i}].trajectory_sha256: is null, which only an aborted episode may have")
    judged = sum(episode.trajectory_sha256 is not None for episode in record.episodes)
    text = f"{judged} judged again, with the same outcomes; {len(record.episodes) - judged} aborted without one"
    yield "trajectories", not wrong, in_words(wrong) or text


def _wrong(episode: CertifiedEpisode, path: str, body: bytes) -> Iterator[str]:
    if hashlib.sha256(body).hexdigest() != episode.trajectory_sha256:
        yield f"{path}.trajectory_sha256: is not that of the trajectory"
        return
    try:
        driven, town = Trajectory.from_json(body), town_of(episode.trial)
        yield from differences(episode.trial, driven.trial, f"{path}.trial")
        geometry = JudgeGeometry.of(town, driven.trial) if driven.trial.journey is None else JourneyGeometry.of(town)
        yield from differences(episode.outcome, judge(driven, geometry), f"{path}.outcome")
    except (JudgeError, NetworkError) as error:
        yield f"{path}: cannot be judged: {error}"


def differences(told: Any, found: Any, path: str) -> Iterator[str]:
    """Yield each field in which two messages or plain values differ. Floats may differ by rounding."""
    told, found = (one.model_dump(mode="json") if isinstance(one, BaseModel) else one for one in (told, found))
    if isinstance(told, dict) and isinstance(found, dict):
        for key in dict.fromkeys((*told, *found)):
            yield from differences(told.get(key), found.get(key), f"{path}.{key}")
    elif isinstance(told, list) and isinstance(found, list) and len(told) == len(found):
        for i, pair in enumerate(zip(told, found, strict=True)):
            yield from differences(*pair, f"{path}[{i}]")
    elif isinstance(told, float) and isinstance(found, float):
        if not math.isclose(told, found, rel_tol=1e-6, abs_tol=1e-6):
            yield f"{path}: is {told}, not {found}"
    elif told != found:
        yield f"{path}: is {told!r}, not {found!r}"


def in_words(wrong: list[str]) -> str:
    """Return the first things that are wrong, and how many more there are; an empty text for none."""
    return "; ".join(wrong[:5]) + (f"; and {len(wrong) - 5} more" if len(wrong) > 5 else "")
