"""The list of the tests that CI leaves out."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]


@cache
def defined_in(file: str) -> set[str]:
    """The names of a file's tests, after the class of those that have one."""
    found = set()
    for one in ast.parse((ROOT / file).read_text("utf-8")).body:
        inside = one.body if isinstance(one, ast.ClassDef) else [one]
        prefix = f"{one.name}::" if isinstance(one, ast.ClassDef) else ""
        found |= {prefix + test.name for test in inside if isinstance(test, ast.FunctionDef | ast.AsyncFunctionDef)}
    return found


def test_each_name_is_a_tests_name() -> None:
    names = (ROOT / "tests/slow.txt").read_text("utf-8").splitlines()
    assert names == sorted(set(names))
    for name in names:
        whole = name.split("[")[0]
        assert name == whole or whole not in names, name
        file, test = whole.split("::", 1)
        assert test in defined_in(file), name
