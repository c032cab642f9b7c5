"""The file of ``wrongturn dose``: each trial with its dose, and what they say of D50."""

from pathlib import Path
from typing import Final, Literal, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from wrongturn_agents.errors import RunError
from wrongturn_protocol import FaultKind, JunctionType, Verdict
from wrongturn_protocol.run_file import UNREADABLE, read_unpacked, reason_of

Estimate = dict[Literal["value", "low", "high"], float | None]
"""A number and its 95 % interval. None: outside the range of doses."""
_REMEDY: Final = "name a new file, or the file of the run to resume"


class _Values(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class DoseTrial(_Values):
    """One trial."""

    trial: str
    dose: float
    junction_type: JunctionType
    verdict: Verdict
    failed: bool
    """Whether it counts: it was unsafe in the strict column; with a disturbance, it was not completed."""


class DoseFile(_Values):
    """The trials of one agent with one fault."""

    agent: str
    fault: FaultKind
    low: float
    high: float
    """The range of doses."""
    unit: str
    towns: tuple[str, ...]
    types: tuple[JunctionType, ...]
    seed: int
    counted: Literal["unsafe", "not completed"]
    trials: tuple[DoseTrial, ...] = ()
    """In the order in which they were driven."""
    d50: Estimate | None = None
    """The dose at which half of the trials fail; None before the first trial."""
    side: Literal["easier", "harder"] | None = None
    """On which side of the range D50 lies; None if it lies within it."""
    width: Estimate | None = None
    """Over how much dose the rate rises from 10 to 90 % of its whole rise."""

    def resumed(self, file: Path | None) -> Self:
        """Return what a file has of the same run, or this if there is none.

        Raises RunError if the file cannot be read, or is of another run.
        """
        if file is None or not file.exists():
            return self
        try:
            found = self.model_validate_json(read_unpacked(file))
        except UNREADABLE as error:
            raise RunError(f"--json: {file} cannot be read ({reason_of(error)}); {_REMEDY}") from error
        except ValidationError as error:
            raise RunError(f"--json: {file} is no file of 'wrongturn dose'; {_REMEDY}") from error
        if found.model_copy(update={"trials": (), "d50": None, "side": None, "width": None}) != self:
            raise RunError(f"--json: {file} is of another run; {_REMEDY}")
        return found

    def text(self) -> str:
        """Return the file's JSON."""
        return self.model_dump_json(indent=1) + "\n"
