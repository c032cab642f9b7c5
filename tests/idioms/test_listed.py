"""The page lists every idiom, and none that has no test."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "idioms.md"


def test_the_page_lists_each_idiom() -> None:
    files = sorted(Path(__file__).parent.glob("test_*.py"))
    tests = {name for file in files for name in re.findall(r"^def (test_\w+)", file.read_text(encoding="utf-8"), re.M)}
    listed = set(re.findall(r"`(test_\w+)`", PAGE.read_text(encoding="utf-8")))
    assert listed == tests - {"test_the_page_lists_each_idiom"}
    assert len(listed) >= 30
