"""Where no sandbox can be opened, the operator learns why and what to do."""

from pathlib import Path

import pytest

from wrongturn_sandbox import SandboxUnavailableError, confinement, libraries, probe


def a_bubblewrap(folder: Path, words: str, status: int = 1) -> None:
    """Put a program called bwrap into a folder; it writes words to stderr and ends."""
    program = folder / "bwrap"
    program.write_text(f"#!/bin/sh\necho '{words}' >&2\nexit {status}\n")
    program.chmod(0o755)


def test_bubblewrap_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(SandboxUnavailableError, match="apt-get install bubblewrap"):
        probe(None)


def test_the_kernel_refuses_namespaces(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    a_bubblewrap(tmp_path, "bwrap: No permissions to create new namespace")
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(SandboxUnavailableError, match=r"No permissions.*runner container"):
        probe(None)


def test_bubblewrap_ends_without_a_word(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    a_bubblewrap(tmp_path, "", 3)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(SandboxUnavailableError, match="status 3"):
        probe(None)


def test_libseccomp_is_missing(monkeypatch: pytest.MonkeyPatch, bubblewrap: None) -> None:
    def missing() -> None:
        raise OSError(2, "libseccomp.so.2 is missing; install it, on Debian: apt-get install libseccomp2")

    libraries.shared_libraries.cache_clear()
    monkeypatch.setattr(libraries, "load_seccomp", missing)
    with pytest.raises(SandboxUnavailableError, match="apt-get install libseccomp2"):
        probe(None)
    assert confinement.SECCOMP_LIBRARY == "libseccomp.so.2"


def test_nobody_listens(tmp_path: Path) -> None:
    with pytest.raises(SandboxUnavailableError, match=r"cannot be reached at .*runner\.sock.*start it"):
        probe(tmp_path / "runner.sock")
