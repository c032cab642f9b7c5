"""The list of the tests that CI leaves out."""

from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_each_name_is_a_tests_name() -> None:
    names = (ROOT / "tests/slow.txt").read_text("utf-8").splitlines()
    assert names == sorted(set(names))
    for name in names:
        file, *_, function = name.split("[")[0].split("::")
        assert f"def {function}(" in (ROOT / file).read_text("utf-8"), name
