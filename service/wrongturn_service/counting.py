"""Counters of who holds how many of something, without a word of those who hold none."""

from collections import Counter


def one_less(counter: Counter[str], name: str) -> None:
    """Take one off; who has none left is forgotten."""
    counter[name] -= 1
    if not counter[name]:
        del counter[name]
