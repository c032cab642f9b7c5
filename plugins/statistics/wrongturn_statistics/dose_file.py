"""The file of ``wrongturn dose``: each trial with its dose, and what they say of D50."""

from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict

from wrongturn_agents.json_file import resume
from wrongturn_protocol import FaultKind, JunctionType, Verdict

Estimate = dict[Literal["value", "low", "high"], float | None]
"""A number and its 95 % interval. None: outside the range of doses."""


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
        return resume(self, file, {"trials": (), "d50": None, "side": None, "width": None})

    def text(self) -> str:
        """Return the file's JSON."""
        return self.model_dump_json(indent=1) + "\n"
