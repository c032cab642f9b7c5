"""Counters that forget names with a count of zero."""

from collections import Counter


def one_less(counter: Counter[str], name: str) -> None:
    """Lower a count by one, and forget the name at zero."""
    counter[name] -= 1
    if not counter[name]:
        del counter[name]
