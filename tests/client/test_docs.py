"""What the page on the client says can be run as it stands."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

from wrongturn_client import Client, LocalService

PAGE = Path(__file__).parents[2] / "docs" / "client.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_examples_run(number: int, service: LocalService, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WRONGTURN_URL", service.url)
    done = subprocess.run(
        [sys.executable, "-c", EXAMPLES[number]], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_each_call_is_named() -> None:
    calls = {name for name, _ in inspect.getmembers(Client, callable) if not name.startswith("_")}
    named = set(re.findall(r"`(\w+)`", PAGE.read_text(encoding="utf-8")))
    assert calls - {"close", "evaluate"} <= named
