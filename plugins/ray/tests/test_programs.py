"""Programs on a node of a Ray cluster. Real clusters are in ``test_clusters.py``."""

import asyncio
import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from app_harness import until
from pydantic import ValidationError
from ray_nodes import Nodes
from service_harness import await_that
from typer.testing import CliRunner

from wrongturn_client.cli import app
from wrongturn_protocol import installing
from wrongturn_ray import listener as listening
from wrongturn_ray import node
from wrongturn_ray.connecting import CertificateError, connect, way
from wrongturn_ray.listener import Listener
from wrongturn_ray.settings import RaySettings, server_tls
from wrongturn_service.cli import wrong_settings
from wrongturn_service.settings import Settings


def test_a_program_on_a_node(tmp_path: Path) -> None:
    program = "import os, sys; print(open('a.txt').read(), os.environ['NAME'], file=sys.stderr); sys.exit(3)"
    end = node.run(["-c", program], {"NAME": "x"}, {"a.txt": b"text"}, node.versions())
    assert (end["status"], end["words"], end["why"]) == (3, "text x\n", None)
    end = node.run(["-c", program], {}, {}, {"Python": "3.1", "wrongturn-ray": "9"})
    assert end["status"] is None
    assert end["why"].endswith("but the service Python 3.1, wrongturn-ray 9; install the same versions on all nodes")


def test_a_program_ends_with_the_task_that_started_it(tmp_path: Path) -> None:
    command = "['-c', 'import time; time.sleep(99)']"
    code = f"from wrongturn_ray import node; node.run({command}, {{}}, {{}}, node.versions())"
    with subprocess.Popen([sys.executable, "-c", code]) as task:
        await_that(lambda: len(Nodes.children(task.pid)) == 1, "no program")
        (program,) = Nodes.children(task.pid)
        task.kill()
        await_that(lambda: not program.is_running() or program.status() == "zombie", "it lives on")


class Heard(asyncio.Protocol):
    """Keeps what it is sent."""

    def __init__(self) -> None:
        self.data = b""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        self.transport = transport

    def data_received(self, data: bytes) -> None:
        self.data += data


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    certificate, key = tmp_path / "certificate.pem", tmp_path / "key.pem"
    command = f"openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=w -keyout {key} -out"
    subprocess.run([*command.split(), str(certificate)], check=True, capture_output=True)
    return certificate, key


@pytest.mark.parametrize("secure", [False, True])
async def test_only_who_knows_the_secret_of_a_start_is_heard(
    pair: tuple[Path, Path], secure: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listening, "_PATIENCE_S", 0.5)
    listener = Listener(server_tls(*pair) if secure else None)
    address = f"127.0.0.1:{await listener.open('127.0.0.1', 0)}"
    pem = pair[0].read_text() if secure else None
    heard = Heard()
    with listener.expect(lambda: heard) as expected:
        for secret in ("", "wrong", expected.secret[:-1], "x" * 1000):
            stranger = await asyncio.to_thread(connect, address, way(secret, pem))
            assert await asyncio.to_thread(_read, stranger) == b""
        silent = await asyncio.open_connection(*address.split(":"))
        assert await asyncio.wait_for(silent[0].read(), 30) == b""
        silent[1].close()
        assert not expected.connected.done()
        if secure:
            lines = pair[0].read_text().splitlines()
            lines[2] = lines[2][::-1]
            with pytest.raises(CertificateError, match="another certificate than the service"):
                await asyncio.to_thread(connect, address, way(expected.secret, "\n".join(lines)))
        program = await asyncio.to_thread(connect, address, way(expected.secret, pem))
        assert f"pid {os.getpid()}" in await asyncio.wait_for(expected.connected, 30)
        await asyncio.to_thread(program.sendall, b"ready")
        await until(lambda: heard.data == b"ready")
        again = await asyncio.to_thread(connect, address, way(expected.secret, pem))
        assert await asyncio.to_thread(_read, again) == b"", "a secret counts once"
        program.close()
        heard.transport.abort()
    await listener.close()


def _read(stream: object) -> bytes:
    with contextlib.closing(stream), contextlib.suppress(ConnectionError):  # type: ignore[type-var]
        return stream.recv(1)  # type: ignore[attr-defined,no-any-return]
    return b""


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("simulators", "ray:0", "give a number from 1 to 4096, 'ray', or 'ray:' and a number"),
        ("simulators", "rays", "give a number"),
        ("ray_listen", "8001", "give an address and a port"),
        ("ray_advertise", "host:x", "give an address and a port"),
        ("ray_key", "/no/such/key", "WRONGTURN_RAY_CERTIFICATE is not set"),
    ],
)
def test_settings_that_cannot_be(name: str, value: str, says: str) -> None:
    with pytest.raises(ValidationError, match=f"{name}\n.*{says}"):
        (RaySettings if name.startswith("ray_") else Settings)(**{name: value})


def test_a_wrong_variable_is_named_if_ray_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WRONGTURN_RAY_LISTEN", "8001")
    assert Settings(simulators=2).checked().simulators == 2
    with pytest.raises(ValidationError) as error:
        Settings(simulators="ray").checked()
    assert [*wrong_settings(error.value)] == [
        "WRONGTURN_RAY_LISTEN: is '8001'; give an address and a port like 10.0.0.1:8001 or [::1]:8001"
    ]


def test_nothing_loads_ray_unless_it_is_asked_for() -> None:
    settings = Settings(simulators="ray:5")
    assert (settings.most_simulators, settings.max_parallel, settings.max_open) == (5, 5, 20)
    code = "import sys, wrongturn_service.server, wrongturn_service.simulators.worker; sys.exit('ray' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.fixture
def _not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installing, "entry_points", lambda **_: ())


@pytest.mark.usefixtures("_not_installed")
@pytest.mark.parametrize(("name", "value"), [("simulators", "ray"), ("simulators", "ray:5"), ("runners", "ray")])
def test_settings_name_the_package_that_is_missing(name: str, value: str) -> None:
    with pytest.raises(ValidationError) as error:
        Settings(**{name: value})
    assert f"{name}\n" in str(error.value)
    assert installing.install("wrongturn-ray") in str(error.value)
    assert Settings(simulators=2).simulators == 2


@pytest.mark.usefixtures("_not_installed")
@pytest.mark.parametrize("words", [("run", "careful", "--suite", "smoke@3"), ("train", "ppo-image", "--steps", "1")])
def test_commands_name_the_package_that_is_missing(words: tuple[str, ...]) -> None:
    done = CliRunner().invoke(app, [*words, "--ray"])
    assert str(done.exception).startswith("--ray: needs Ray")
    assert installing.install("wrongturn-ray") in str(done.exception)
