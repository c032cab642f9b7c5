"""Errors in the values of command-line options, in one line."""

from typing import Any, Final

import typer

_NUMBERS: Final = {
    "int_parsing": "a whole number",
    "int_parsing_size": "a whole number",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
}
"""What to give instead, by the type of pydantic's error; typer reads values with pydantic."""
_SHOWN: Final = 40


def describe_option_error(error: typer.BadParameter) -> str:
    """Return one line with the option, the value that was given, and what to give instead."""
    option: Any = error.param
    name = max(option.opts, key=len) if option is not None else "option"
    message = error.message.removeprefix("Value error, ").rstrip(".").replace("\n", " ")
    errors = getattr(error.__cause__, "errors", None)
    if errors is None:
        return f"{name}: {message}"
    first = errors(include_url=False)[0]
    given = str(first["input"])[:_SHOWN]
    number = _NUMBERS.get(first["type"])
    if number is not None:
        return f"{name}: is {given!r}; give {number}{_range(option)}"
    if first["type"] in {"greater_than_equal", "less_than_equal"}:
        return f"{name}: is {given}; give {_kind(option)}{_range(option)}"
    return f"{name}: {message}"


def _kind(option: Any) -> str:
    whole = all(bound is None or isinstance(bound, int) for bound in (option.min, option.max))
    return "a whole number" if whole else "a number"


def _range(option: Any) -> str:
    least, most = option.min, option.max
    if least is None:
        return "" if most is None else f", {most} or less"
    return f", {least} or more" if most is None else f" from {least} to {most}"
