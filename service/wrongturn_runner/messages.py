"""What the service and a runner tell each other: JSON, one message a line, over the runner's stdin and stdout.

The service starts ``python -m wrongturn_runner`` and writes a :class:`CheckJob` or :class:`DriveJob`. The runner writes
events and ends with status 0 after ``passed``, ``refused`` or ``driven``. It ends with status :data:`BUSY` if it got no
sandbox, because all of them are taken; the service then tries again. Any other end is the infrastructure's failure, and
the service starts another runner, but not for ever.
"""

from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, TypeAdapter

from wrongturn_protocol import Rig, Track
from wrongturn_protocol.episodes import Message

BUSY: Final = 75
"""Exit status of a runner that got no sandbox, because all of them are taken."""

REASON_MOST: Final = 500
"""Longest reason, characters."""


class _ModelJob(Message):
    model: Path
    sha256: str
    socket: Path | None = None
    """Unix socket of a runner container; None for sandboxes by bubblewrap on this machine."""
    memory: int
    """Bytes that the model's process may take."""
    gpu: bool = False
    """Whether the model is computed on a GPU."""
    url: str
    """URL of the service."""


class CheckJob(_ModelJob):
    """Look at a model, then let it drive six steps of practice."""

    task: Literal["check"] = "check"
    tracks: tuple[Track, ...]
    """Tracks that the suite takes."""
    agent_track: Track | None = None
    """Track of the agent whose token handed the model in; None if the check makes the agent."""
    agent_rig: Rig | None = None
    """Its rig."""


class PracticeJob(Message):
    """Answer to ``described``: go on with practice. Without it the runner ends when its stdin is closed."""

    token: str = Field(repr=False)
    suite: str
    trial: str


class DriveJob(_ModelJob):
    """Drive an evaluation to its end, from wherever it is."""

    task: Literal["drive"] = "drive"
    token: str = Field(repr=False)
    """Token that is good for this evaluation alone; it is in no log."""
    evaluation: str
    suite: str


class Described(Message):
    """The model was loaded and keeps the contract."""

    event: Literal["described"] = "described"
    track: Track
    description: str
    """One line for the log: inputs, outputs, opset, nodes, size."""
    about: Annotated[str, Field(max_length=2000)] | None = None
    """What the model's metadata says of the agent."""
    trained_on_faults: bool = False
    """Whether the metadata says that the agent met wrong commands in its training."""
    rig: Rig | None = None
    """The rig that the metadata declares."""


class Passed(Message):
    """The model drove its practice steps."""

    event: Literal["passed"] = "passed"
    step_ms: tuple[float, ...]
    """Milliseconds of each step in the sandbox."""


class Refused(Message):
    """The model is at fault: the submission has failed."""

    event: Literal["refused"] = "refused"
    reason: str
    """What is wrong and what to do, for its owner."""


class Progressed(Message):
    """An episode of the evaluation is over."""

    event: Literal["progressed"] = "progressed"
    finished: int
    episodes: int


class Driven(Message):
    """Every episode of the evaluation is over."""

    event: Literal["driven"] = "driven"


Job = Annotated[CheckJob | DriveJob, Field(discriminator="task")]
Event = Annotated[Described | Passed | Refused | Progressed | Driven, Field(discriminator="event")]
LAST: Final = Passed | Refused | Driven
"""The last words of a runner."""
JOB: TypeAdapter[Job] = TypeAdapter(Job)
"""Reads the first line of a runner's stdin."""
PRACTICE: Final = TypeAdapter(PracticeJob)
"""Reads the second line, of a check."""
EVENT: TypeAdapter[Event] = TypeAdapter(Event)
"""Reads a line of a runner's stdout."""
