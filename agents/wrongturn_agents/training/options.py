"""Settings that a user changes by ``name=value``."""

import dataclasses
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, TypeVar

from wrongturn_agents.training.errors import TrainingError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    Settings = TypeVar("Settings", bound=DataclassInstance)

_SHOWN = 40
_WORDS = {"true": True, "false": False}
_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a word"}


def in_words(kind: type) -> str:
    """Return what a setting of a type takes: ``a whole number``."""
    return _KINDS[kind]


def parsed(name: str, text: str, kind: type) -> Any:
    """Return a setting's value from its text.

    Args:
        name: name of the setting, for the error.
        text: its value as the user wrote it.
        kind: its type.

    Raises:
        TrainingError: the text is no value of that type.
    """
    if kind is bool:
        if text not in _WORDS:
            raise TrainingError(f"option {name}: is {text!r}; give true or false")
        return _WORDS[text]
    try:
        return kind(text)
    except ValueError as error:
        raise TrainingError(f"option {name}: is {text[:_SHOWN]!r}; give {in_words(kind)}") from error


def with_options(
    settings: "Settings", options: Iterable[str], parse: Callable[[str, str, type], Any] = parsed
) -> "Settings":
    """Return a dataclass with the fields of ``name=value`` options changed.

    Args:
        settings: the dataclass.
        options: what the user gave.
        parse: returns a value from a field's name, text and type.

    Raises:
        TrainingError: an option has an unknown name or a wrong value.
    """
    names = sorted(field.name for field in dataclasses.fields(settings))
    changed: dict[str, Any] = {}
    for option in options:
        name, equals, text = option.partition("=")
        if not equals or name not in names:
            raise TrainingError(f"option {option!r}: give name=value with one of {', '.join(names)}")
        changed[name] = parse(name, text, type(getattr(settings, name)))
    return dataclasses.replace(settings, **changed)
