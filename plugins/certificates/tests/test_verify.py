"""A certificate verifies, nothing in it can be changed, and a service that lies is found out."""

import copy
import functools
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import rfc8785
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from service_harness import RunningService, expect, problem
from typer.testing import CliRunner, Result

from wrongturn_certificates import cli
from wrongturn_client.cli import app
from wrongturn_judge.metrics import compute
from wrongturn_networks import load_suite
from wrongturn_protocol.certificates import Record

Verify = Callable[..., Result]
STRANGER = Ed25519PrivateKey.from_private_bytes(bytes(32))
TRUSTED = STRANGER.public_key().public_bytes_raw().hex()


@pytest.fixture(scope="module")
def evaluation(service: RunningService) -> str:
    """The id of a finished evaluation: two driven, one aborted while it was driven, and the rest never begun."""
    with service.agent() as agent:
        found: str = agent.evaluate()["id"]
        path = f"/v1/evaluations/{found}"
        for _ in range(3):
            episode = expect(agent.reset(found), 201)["id"]
            problem(agent.http.get(f"{path}/certificate"), 409, "evaluation-open")
            agent.drive(episode) if _ else agent.step(episode, 1)
            agent.http.delete(f"/v1/episodes/{episode}")
        assert httpx.get(f"{service.url}{path}/certificate").status_code == 401
        expect(agent.http.delete(path), 200)
    return found


@pytest.fixture(scope="module")
def certificate(service: RunningService, evaluation: str) -> Any:
    return expect(httpx.get(f"{service.url}/v1/evaluations/{evaluation}/certificate"), 200)


@pytest.fixture
def verify(tmp_path: Path) -> Verify:
    def verify(content: Any, *options: str) -> Result:
        file = tmp_path / "certificate.json"
        file.write_bytes(content if isinstance(content, bytes) else json.dumps(content, indent=1).encode())
        return CliRunner().invoke(app, ["verify", str(file), *options])

    return verify


def leaves(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield each leaf and its path. Of lists of objects the first is enough, because all are alike."""
    items: Any = list(value.items()) if isinstance(value, dict) else list(enumerate(value))
    for key, item in items[:1] if value and isinstance(value, list) and isinstance(value[0], dict) else items:
        if isinstance(item, dict | list) and item:
            yield from leaves(item, (*path, key))
        else:
            yield (*path, key), item


def altered(value: Any) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, str):
        return value[:-1] + ("1" if value.endswith("0") else "0")
    return {"x": 1} if isinstance(value, dict) else ["x"] if isinstance(value, list) else "0" * 64


def test_a_good_one_says_what_was_checked_and_what_not(
    service: RunningService, certificate: Any, verify: Verify, tmp_path: Path
) -> None:
    alone = verify(certificate)
    assert alone.exit_code == 0, alone.output
    assert re.search(r"not checked +key: .*proves nothing", alone.stdout)
    (key,) = expect(httpx.get(f"{service.url}/v1/keys"), 200)["keys"]
    assert key["fingerprint"] in alone.stdout
    assert "Consistent: " in alone.stdout
    drives, keys = str(tmp_path / "drives"), tmp_path / "keys.json"
    whole = verify(certificate, "--url", service.url, "--rejudge", "--trajectories", drives)
    assert (whole.exit_code, "not checked" in whole.stdout) == (0, False), whole.output
    assert "trajectories: 3 judged again, with the same outcomes; 9 aborted" in whole.stdout
    for content in (key["key"], json.dumps({"keys": [key]})):
        keys.write_text(content)
        offline = verify(certificate, "--key", str(keys), "--rejudge", "--trajectories", drives)
        assert offline.exit_code == 0, offline.output
    some = next(Path(drives).iterdir())
    some.write_bytes(some.read_bytes() + b" ")
    changed = verify(certificate, "--rejudge", "--trajectories", drives)
    assert changed.exit_code == 1
    assert re.search(r"refused +trajectories: episodes\[\d\]\.trajectory_sha256: is not", changed.stdout)
    some.unlink()
    assert verify(certificate, "--rejudge", "--trajectories", drives).exit_code == 2
    versions = certificate["record"]["versions"]
    assert versions.keys() >= {"python", "libsumo", "wrongturn-networks", "wrongturn-service"}


@pytest.mark.parametrize("every", [4, pytest.param(1, marks=pytest.mark.soak)])
def test_a_change_of_any_field_is_refused_by_its_name(
    service: RunningService, certificate: Any, verify: Verify, monkeypatch: pytest.MonkeyPatch, every: int
) -> None:
    key = expect(httpx.get(f"{service.url}/v1/keys"), 200)["keys"][0]["key"]
    monkeypatch.setattr(cli, "_get", functools.cache(cli._get))
    paths = list(leaves(certificate))
    assert len(paths) > 100
    for path, value in paths[::every]:
        wrong = copy.deepcopy(certificate)
        functools.reduce(lambda within, name: within[name], path[:-1], wrong)[path[-1]] = altered(value)
        offline = verify(wrong, "--key", key)
        assert offline.exit_code in {1, 2}, path
        found = offline if offline.exit_code == 2 else verify(wrong, "--url", service.url)
        assert found.exit_code == offline.exit_code, path
        assert set(re.findall(r"\w+", str(path))) <= set(re.findall(r"\w+", found.output)), (path, found.output)


def test_a_service_that_lies_is_found_out(
    service: RunningService, certificate: Any, verify: Verify, tmp_path: Path
) -> None:
    """The signature fits in each case."""

    def signed(**changes: Any) -> Any:
        record = {**certificate["record"], **changes}
        return {"record": record, "key": TRUSTED, "signature": STRANGER.sign(rfc8785.dumps(record)).hex()}

    record = certificate["record"]
    trusted = "--key", TRUSTED
    assert verify(signed(), *trusted).exit_code == 0
    assert re.search(r"refused +key: is none that you trust", verify(signed(), "--url", service.url).stdout)
    for changes, named in (
        ({"secret": "another"}, "commitment: "),
        ({"suite_sha256": "0" * 64}, "install that"),
        ({"suite": "lost@7"}, "wrongturn-networks 0.1.0"),
        ({"episodes": record["episodes"][1:]}, "is missing or there twice"),
        ({"episodes": [*record["episodes"], record["episodes"][1]]}, "there are 13, not 12"),
    ):
        found = verify(signed(**changes), *trusted)
        assert (found.exit_code, named in found.stdout) == (1, True), (changes, found.output)
        assert "not checked metrics: depends on what is refused above" in found.stdout
    # An outcome that a drive with the pedal down cannot have, and the figures that follow: only the trajectory tells.
    drives = "--rejudge", "--trajectories", str(tmp_path / "drives")
    assert verify(certificate, "--url", service.url, *drives).exit_code == 0
    episodes = copy.deepcopy(record["episodes"])
    lied = next(one for one in episodes if one["trajectory_sha256"] and one["outcome"]["verdict"] != "aborted")
    lied["outcome"] |= {"verdict": "stopped_before_junction", "exit": None}
    outcomes = {one.trial.id: one.outcome for one in Record.model_validate({**record, "episodes": episodes}).episodes}
    metrics = compute(load_suite("smoke@3").draw(record["secret"]), outcomes).model_dump(mode="json")
    lie = signed(episodes=episodes, metrics=metrics)
    assert verify(lie, *trusted).exit_code == 0
    judged = verify(lie, *trusted, *drives)
    assert judged.exit_code == 1
    said = f"trajectories: episodes[{episodes.index(lied)}].outcome.verdict: is 'stopped_before_junction', not "
    assert said in judged.stdout
    shown = verify(lie, *trusted, "--url", service.url)
    assert (shown.exit_code, "record: record." in shown.stdout) == (1, True), shown.output


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is no JSON"),
        (b"\x00\xff\xfe", "is no JSON"),
        (b"[" * 100_000, "is no JSON"),
        (b'{"record": {"version": NaN}}', "NaN is no number"),
        (b'{"record": 1, "record": 2}', "a field twice"),
        (b"[]", "is no certificate"),
        (b'{"record": {"version": 2}, "signature": {}}', "record.version"),
        (b" " * ((64 << 20) + 1), "larger than 64 MiB"),
    ],
)
def test_another_file_gets_a_clear_error(content: bytes, said: str, verify: Verify) -> None:
    found = verify(content)
    assert found.exit_code == 2
    assert said in str(found.exception) or said in " ".join(found.output.split())
