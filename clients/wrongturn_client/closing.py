"""Base class of what a ``with`` block closes."""

from abc import abstractmethod
from contextlib import AbstractContextManager
from typing import Any, Self


class Closing(AbstractContextManager[Any]):
    """Base of classes with a ``close``."""

    def __enter__(self) -> Self:
        """Return the object itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Close it. Safe to call more than once."""
