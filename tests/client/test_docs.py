"""What the page on the client says can be run as it stands."""

import contextlib
import inspect
import re
from pathlib import Path

import pytest

import wrongturn_client
from wrongturn_client import Client, LocalService

PAGE = Path(__file__).parents[2] / "docs" / "client.md"
EXAMPLES = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("number", range(len(EXAMPLES)))
def test_examples_run(
    number: int, service: LocalService, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("WRONGTURN_URL", service.url)
    # The service of these tests stands for one of the example's own, whose start takes seconds.
    monkeypatch.setattr(wrongturn_client, "LocalService", lambda: contextlib.nullcontext(service))
    exec(compile(EXAMPLES[number], f"example {number}", "exec"), {"__name__": "__main__"})
    assert capsys.readouterr().out.strip()


def test_each_call_is_named() -> None:
    calls = {name for name, _ in inspect.getmembers(Client, callable) if not name.startswith("_")}
    named = set(re.findall(r"`(\w+)`", PAGE.read_text(encoding="utf-8")))
    assert calls - {"close", "evaluate"} <= named
