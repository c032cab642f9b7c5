"""What forks of a drive show, and the file of ``wrongturn whatif --sweep --all``."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field

from wrongturn_agents.json_file import resume
from wrongturn_protocol import Command, Outcome, Verdict


class _Values(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class Difference(_Values):
    """The first action before a fork that is not the stored one: the agent is not deterministic."""

    at: float
    """Seconds."""
    stored: tuple[float, float, float]
    """Steer, throttle and brake of the stored drive."""
    now: tuple[float, float, float]
    """The same of the agent, shown the same observations."""

    def __str__(self) -> str:
        """Return it in words."""
        names = ("steer", "throttle", "brake")
        field, was, now = next(one for one in zip(names, self.stored, self.now, strict=True) if one[1] != one[2])
        return (
            f"The agent is not deterministic, or not the one that drove: at {self.at:.1f} s it gives {field} {now:g} "
            f"where the stored drive has {was:g}, after the same observations. Another sweep may find other times."
        )


class ForkResult(_Values):
    """What an agent does with another command."""

    at: float
    """When the other command begins, seconds."""
    command: Command | None
    """The other command; None: the route's."""
    was: Verdict | None
    """The stored drive's verdict; None if it ended without one."""
    outcome: Outcome
    """How the fork ends."""
    reacts_s: float | None
    """The first action that differs from the stored drive's, seconds; None if there is none."""
    differs: Difference | None


class SweepResult(_Values):
    """What the right command would have changed in a drive, and until when."""

    trial: str
    verdict: Verdict | None
    """The stored drive's verdict; None if it ended without one."""
    wrong_s: float | None
    """The first wrong command, seconds; None if all were right."""
    right: Verdict | None
    """The verdict with the right command throughout."""
    detection_s: float | None
    """The first action that differs from those with the right command throughout, seconds; None if there is none."""
    no_return_s: float | None
    """The last moment at which the right command still ends safely, seconds. None for a drive that is safe itself, or
    if the right command is never safe."""
    forks: tuple[tuple[float, Verdict], ...]
    """The forks with the right command that were driven: when it begins, and their verdicts."""
    differs: Difference | None


class SweepFile(_Values):
    """The sweeps of an evaluation's unsafe trials."""

    agent: str
    evaluation: str
    every: Annotated[float, Field(gt=0)]
    """Seconds between the forks that were driven first."""
    trials: dict[str, SweepResult] = {}

    def resumed(self, file: Path | None) -> Self:
        """Return what a file has of the same sweep, or this if there is none.

        Raises RunError if the file cannot be read, or is of another sweep.
        """
        return resume(self, file, {"trials": {}})

    def text(self) -> str:
        """Return the file's JSON."""
        return self.model_dump_json(indent=1) + "\n"
