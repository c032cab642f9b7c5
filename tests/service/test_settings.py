"""Each setting is documented, and read from where the documentation says."""

import runpy
from pathlib import Path

import pytest
from pydantic import ValidationError

from wrongturn_service.cli import wrong_settings
from wrongturn_service.machine import Machine
from wrongturn_service.settings import PREFIX, Registration, Settings

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in Settings.model_fields:
        monkeypatch.delenv(PREFIX + name.upper(), raising=False)


def test_the_page_is_what_the_settings_say() -> None:
    written = runpy.run_path(str(ROOT / "lab/settings_page.py"))
    assert written["page"]() == written["PAGE"].read_text("utf-8"), "run python lab/settings_page.py"
    assert all(field.description for field in Settings.model_fields.values())


def test_the_environment_is_read(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("WRONGTURN_PORT", "0")
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path))
    monkeypatch.setenv("WRONGTURN_REGISTRATION", "operator")
    monkeypatch.setenv("WRONGTURN_SIMULATORS", "3")
    monkeypatch.setenv("WRONGTURN_DATABASE", "")
    settings = Settings()
    assert settings.port == 0
    assert settings.database_url == f"sqlite+aiosqlite:///{tmp_path}/wrongturn.db"
    assert settings.registration is Registration.OPERATOR
    assert (settings.max_parallel, settings.max_open, Settings(max_open=5).max_open) == (3, 12, 5)
    assert Settings(port=81).port == 81


@pytest.mark.parametrize(
    ("name", "value"),
    [("PORT", "70000"), ("PORT", "x"), ("LEASE_ABORT_S", "nan"), ("SIMULATORS", "0"), ("LOG_LEVEL", "loud")],
)
def test_a_value_that_cannot_be(monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
    monkeypatch.setenv(PREFIX + name, value)
    with pytest.raises(ValidationError) as error:
        Settings()
    (line,) = wrong_settings(error.value)
    assert line.startswith(f"{PREFIX}{name}: ")


def test_the_operators_token_is_not_shown() -> None:
    assert "abc" not in repr(Settings(operator_token="abc", metrics_token="abc"))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("database", "expected"),
    [
        ("postgresql+asyncpg://me@host/name", "postgresql+asyncpg://me:it%27s a %40%2Fsecret@host/name"),
        ("postgresql+asyncpg://me:known@host/name", "postgresql+asyncpg://me:known@host/name"),
        ("sqlite+aiosqlite:////data/w.db", "sqlite+aiosqlite:////data/w.db"),
        ("no url", "no url"),
    ],
)
def test_the_databases_password_comes_from_its_file(tmp_path: Path, database: str, expected: str) -> None:
    file = tmp_path / "password"
    file.write_text("it's a @/secret\n")
    url = Settings(database=database, database_password_file=file).database_url
    assert url == expected


@pytest.mark.parametrize(("content", "says"), [(None, "cannot be read"), (b"\n", "is empty"), (b"\xff", "not UTF-8")])
def test_a_file_without_a_password(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes | None, says: str
) -> None:
    file = tmp_path / "password"
    if content is not None:
        file.write_bytes(content)
    monkeypatch.setenv("WRONGTURN_DATABASE_PASSWORD_FILE", str(file))
    with pytest.raises(ValidationError, match=rf"database_password_file\n.*{says}"):
        Settings()


def test_the_gateway_is_a_proxy_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Machine, "gateway", lambda _: "172.21.0.1")
    assert Settings(trusted_proxies="gateway, 10.0.0.0/8").proxies == "172.21.0.1,10.0.0.0/8"
    assert Settings(trusted_proxies="10.0.0.1").proxies == "10.0.0.1"
    monkeypatch.setattr(Machine, "gateway", lambda _: None)
    assert Settings(trusted_proxies="gateway").proxies == ""
