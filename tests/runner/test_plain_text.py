"""Text of strangers in a reason or a log."""

import pytest

from wrongturn_runner.errors import plain


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("output steer: is nan", "output steer: is nan"),
        ("two\nlines\tand a tab", "two lines and a tab"),
        ("\x1b[2Jcleared", "?[2Jcleared"),
        ("right to left \u202e and zero\u200bwidth", "right to left ? and zero?width"),
        ("Ümläut, 車", "Ümläut, 車"),
        ("\ud800 alone", "? alone"),
        ("", ""),
    ],
)
def test_it_is_one_printable_line(text: str, shown: str) -> None:
    assert plain(text) == shown


def test_it_is_cut() -> None:
    assert plain("x" * 10_000_000, 10) == "xxxxxxxxx…"
    assert plain("x" * 10, 10) == "x" * 10
