"""Clients that generators make of the OpenAPI document drive a suite to a rank, as ``docs/examples`` shows."""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from contract_document import operations
from service_harness import RunningService

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
PACKAGES = ("openapi-fetch@0.17", "openapi-typescript@7", "typescript@5", "@types/node@20")


def run(*command: str | Path, folder: Path, **environment: str) -> str:
    """Both outputs of a program, which has to succeed."""
    done = subprocess.run(
        [str(word) for word in command],
        cwd=folder,
        env={"PATH": f"{Path(sys.executable).parent}:/usr/local/bin:/usr/bin:/bin", "HOME": str(folder), **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_ids_of_operations_are_words_and_each_is_there_once(document: dict[str, Any]) -> None:
    ids = [operation["operationId"] for operation in operations(document).values()]
    assert len(set(ids)) == len(ids)
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+)+", name) for name in ids), ids


def test_constants_are_scalars_and_what_openapi_cannot_say_has_a_link(document: dict[str, Any]) -> None:
    def constants(part: Any) -> list[Any]:
        below = part.values() if isinstance(part, dict) else part if isinstance(part, list) else ()
        here = [part["const"]] if isinstance(part, dict) and "const" in part else []
        return here + [one for each in below for one in constants(each)]

    found = constants(document["components"]["schemas"])
    assert found
    assert all(isinstance(one, str | int) for one in found), found
    assert document["externalDocs"]["url"] == "docs#websocket"


def test_a_python_client_drives_a_suite_to_a_rank(service: RunningService, tmp_path: Path) -> None:
    pytest.importorskip("openapi_python_client", reason="the generator is not installed")
    said = run("openapi-python-client", "generate", "--url", f"{service.url}/openapi.json", folder=tmp_path)
    assert re.fullmatch(r"Generating \S*wrongturn-api-client\s*", said), said
    command = (sys.executable, EXAMPLES / "generated_client.py", service.url, "generated in Python")
    said = run(*command, folder=tmp_path, PYTHONPATH=str(tmp_path / "wrongturn-api-client"))
    assert re.fullmatch(r"finished\nrank \d+\n", said)


def test_a_typescript_client_drives_a_suite_to_a_rank(service: RunningService, tmp_path: Path) -> None:
    if shutil.which("npm") is None:
        pytest.skip("needs npm, which not every machine has")
    (tmp_path / "package.json").write_text('{"type": "module"}')
    try:
        run("npm", "install", "--fetch-retries=0", *PACKAGES, folder=tmp_path, HOME=str(Path.home()))
    except AssertionError as error:
        pytest.skip(f"npm has no packages here: {str(error)[-200:]}")
    shutil.copy(EXAMPLES / "generated_client.ts", tmp_path)
    source = (EXAMPLES / "generated_client.ts").read_text(encoding="utf-8")
    for line in re.findall(r"^//     npx (.*)$", source, re.MULTILINE):
        tool, *words = line.replace("http://127.0.0.1:8000", service.url).split()
        said = run(tmp_path / "node_modules/.bin" / tool, *words, folder=tmp_path)
        assert "⚠" not in said, said
    said = run("node", "generated_client.js", service.url, "typed in TypeScript", folder=tmp_path)
    assert re.fullmatch(r"finished\nrank \d+\n", said)
