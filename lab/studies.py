"""Stored studies of the figures themselves: other thresholds, and other draws.

``python -m lab.results --sensitivity`` and ``--draws`` make them. Their tables need no driving.
"""

from pathlib import Path
from typing import Annotated, Final, Self

from pydantic import BaseModel, ConfigDict, Field

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.results_file import read_model
from wrongturn_protocol import FaultKind, JunctionType

STUDIES: Final = "studies"
"""Folder of the studies in the directory of the stored results."""
_Count = Annotated[int, Field(ge=0)]
DrawCounts = dict[JunctionType, dict[FaultKind, _Count]]
"""Unsafe trials in the strict column, by junction type and fault."""


class StudyModel(BaseModel):
    """Base of the studies' models."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class Variant(StudyModel):
    """What another value of one threshold changes for an agent."""

    verdicts: _Count
    """Trials and twins with another verdict."""
    reactions: _Count
    """Trials with another reaction."""
    unsafe: _Count
    """Trials that move into the strict column or out of it."""
    strict: _Count
    """Unsafe trials in the strict column with this value."""


class JudgedAgent(StudyModel):
    """One agent's drives on the open draw, judged again and again."""

    weights_sha256: str | None
    """SHA-256 of the agent's weights; None if it has none."""
    strict: _Count
    """Unsafe trials in the strict column, by the published thresholds."""
    variants: dict[str, dict[str, Variant]]
    """What changes, by the threshold's name and its factor."""


class DrawnAgent(StudyModel):
    """One agent on several draws."""

    weights_sha256: str | None
    """SHA-256 of the agent's weights; None if it has none."""
    draws: dict[str, DrawCounts]
    """Unsafe trials of each draw, by its secret."""


class Study(StudyModel):
    """What all studies say of themselves."""

    suite: str
    suite_sha256: str
    thresholds: int
    """Version of the thresholds."""

    @classmethod
    def of(cls, suite: str, suite_sha256: str, thresholds: int, found: Self | None) -> Self:
        """Return what was found, if it is of this suite and these thresholds; otherwise an empty study."""
        empty = cls.model_validate(
            {"suite": suite, "suite_sha256": suite_sha256, "thresholds": thresholds, "agents": {}}
        )
        if found is None or found.model_copy(update={"agents": {}}) != empty:
            return empty
        return found

    @classmethod
    def read(cls, path: Path) -> Self | None:
        """Read a study; None if there is no such file.

        Raises:
            ResultsError: The file cannot be read, or is no such study.
        """
        if not path.is_file():
            return None
        return read_model(cls, path, "delete the file and make it anew")

    def write(self, path: Path) -> None:
        """Write the study, all at once or not at all.

        Raises:
            ResultsError: The file cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            beside = path.with_name(f".{path.name}.new")
            beside.write_text(self.model_dump_json(indent=1) + "\n", encoding="utf-8")
            beside.replace(path)
        except OSError as error:
            raise ResultsError(f"{path}: cannot be written ({error.strerror}); name another --directory") from error


class Judgings(Study):
    """Drives on the open draw, judged by other thresholds."""

    agents: dict[str, JudgedAgent]


class Draws(Study):
    """Drives on several draws."""

    agents: dict[str, DrawnAgent]


def secrets_of_draws(count: int) -> tuple[str, ...]:
    """Return the secrets of the draws that are compared. They are public, so that everybody can drive them."""
    return tuple(f"draw {number}" for number in range(count))


def judgings_file(directory: Path) -> Path:
    """Return the path of the study of thresholds."""
    return directory / STUDIES / "judging.json"


def draws_file(directory: Path) -> Path:
    """Return the path of the study of draws."""
    return directory / STUDIES / "draws.json"
