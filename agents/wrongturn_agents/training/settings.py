"""Settings of a training method: a dataclass whose fields explain themselves, changed by ``name=value``."""

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Self

from wrongturn_agents.training.errors import TrainingError
from wrongturn_protocol.suggestions import did_you_mean

SHARE: Final = (0.0, 1.0)
"""Range of a share."""
ANY: Final = (-1e12, 1e12)
"""Range of a number that may be negative."""
PIXELS: Final = 64 * 192
"""Pixels of a picture."""
_MOST: Final = 1e12
_SHOWN: Final = 40
_WORDS: Final = {"true": True, "false": False, "1": True, "0": False, "yes": True, "no": False}
_KINDS: Final = {bool: "true or false", int: "a whole number", float: "a number", str: "a word"}


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of one method. Each field is a bool, int, float or str, and has a default and a docstring.

    Subclasses check in ``__post_init__`` what the ranges do not say, and call this class's first.
    """

    algorithm: ClassVar[str] = ""
    """Name of the method, and of its agent in checkpoints."""
    RANGES: ClassVar[Mapping[str, tuple[float, float]]] = {}
    """Least and greatest value by field. Without an entry, a whole number is at least 1, and another at least 0."""
    POSITIVE: ClassVar[tuple[str, ...]] = ()
    """Fields that cannot be 0."""
    BEFORE: ClassVar[Mapping[str, Any]] = {}
    """What runs had that are older than a field and do not name it, where that is not the default."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            self._check(field.name, getattr(self, field.name), type(field.default))

    def _check(self, name: str, value: Any, kind: type) -> None:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and kind in {float, type(value)} if kind in {int, float} else isinstance(value, kind)):
            raise TrainingError(f"option {name}: is {value!r}; give {_KINDS[kind]}")
        if not number:
            return
        least, most = self.RANGES.get(name, (1 if kind is int else 0, _MOST))
        if not least <= value <= most:
            raise TrainingError(f"option {name}: is {value}; give a number from {least:g} to {most:g}")
        if name in self.POSITIVE and value == 0.0:
            raise TrainingError(f"option {name}: is 0; give a number above 0")

    @property
    def length(self) -> int:
        """Default length of a run, in what the method counts: its field ``steps``."""
        return int(getattr(self, "steps"))  # noqa: B009 - subclasses have the field, or override this

    @property
    def variant(self) -> str | None:
        """Name of the ablation for tables; None for the unchanged algorithm."""
        return None

    def memory(self) -> Iterable[tuple[str, int, str]]:
        """Return each option whose size decides how much memory a run needs: name, bytes in all, and of what."""
        return ()

    def with_options(self, options: Iterable[str]) -> Self:
        """Return these settings with the fields of ``name=value`` options changed."""
        names = sorted(field.name for field in dataclasses.fields(self))
        changed: dict[str, Any] = {}
        for option in options:
            name, equals, text = option.partition("=")
            if not equals or name not in names:
                meant = did_you_mean(name, names)
                raise TrainingError(f"--option: {option!r}: give name=value with one of {', '.join(names)}{meant}")
            changed[name] = _parsed(name, text, type(getattr(self, name)))
        return dataclasses.replace(self, **changed)

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name, ready for JSON."""
        return dataclasses.asdict(self)

    @classmethod
    def of(cls, fields: Mapping[str, Any]) -> Self:
        """Return the settings of a stored run."""
        known = {field.name for field in dataclasses.fields(cls)}
        unknown = [name for name in fields if name not in known]
        if unknown:
            raise TrainingError(
                f"config: this version knows no {unknown[0]!r} of {cls.algorithm}; install the one it is of"
            )
        return cls(**{**cls.BEFORE, **fields})


def without(**present: bool) -> str | None:
    """Return the name of the ablation that leaves parts out: ``without-pretraining``; None if all are present."""
    left_out = [name.replace("_", "-") for name, there in present.items() if not there]
    return "without-" + "-and-".join(left_out) if left_out else None


def _parsed(name: str, text: str, kind: type) -> Any:
    if kind is bool:
        if text.lower() not in _WORDS:
            raise TrainingError(f"option {name}: is {text[:_SHOWN]!r}; give true or false")
        return _WORDS[text.lower()]
    try:
        return int(text.replace("_", "")) if kind is int else kind(text)
    except ValueError as error:
        raise TrainingError(f"option {name}: is {text[:_SHOWN]!r}; give {_KINDS[kind]}") from error
