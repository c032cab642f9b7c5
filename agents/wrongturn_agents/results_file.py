"""File with the results of one agent, of one training seed, on one suite."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Final, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, TypeAdapter, ValidationError

from wrongturn_agents.errors import ResultsError, RunError
from wrongturn_agents.suites import SuiteTrials, installed_suite
from wrongturn_protocol import STRICT_FLAGS, Flag, Outcome, Reaction, Verdict
from wrongturn_protocol.accounts import AgentName
from wrongturn_protocol.run_file import UNREADABLE, read_unpacked, reason_of

Driven = Literal["in process", "over the service"]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
_REMEDY: Final = "make a new file with 'wrongturn score'"
_TRIALS_NAMED: Final = 3  # trials that an error names as examples
_T = TypeVar("_T")


class TrialResult(BaseModel):
    """Result of one trial."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    verdict: Verdict
    reaction: Reaction | None = None
    """Reaction to the fault; None if the trial has no fault."""
    flags: tuple[Flag, ...] = ()
    """Flags of the outcome; those of ``STRICT_FLAGS`` make the trial unsafe in the strict column."""
    clean: bool | None = None
    """Whether a journey was driven without infractions; None if the trial is not a journey."""
    speed_at_verdict: float | None = None
    """Speed at the verdict of an unsafe trial, metres per second; None with others, and in older results."""
    trajectory_sha256: str | None = None
    """SHA-256 of the trajectory's canonical JSON; None where it was not kept."""

    @classmethod
    def of(cls, outcome: Outcome, trajectory_sha256: str | None = None) -> Self:
        """Return the part of an episode's outcome that is stored."""
        clean = None if outcome.journey is None else outcome.journey.clean
        speed = outcome.speed_at_verdict if outcome.unsafe_strict and clean is None else None
        return cls(
            verdict=outcome.verdict,
            reaction=outcome.reaction,
            flags=outcome.flags,
            clean=clean,
            speed_at_verdict=None if speed is None else round(speed, 2),
            trajectory_sha256=trajectory_sha256,
        )

    @property
    def unsafe(self) -> bool:
        """Whether the trial is unsafe in the paper's column."""
        return self.verdict.unsafe

    @property
    def unsafe_strict(self) -> bool:
        """Whether the trial is unsafe in the strict column."""
        return self.verdict.unsafe_strict or not STRICT_FLAGS.isdisjoint(self.flags)

    @property
    def completed(self) -> bool:
        """Whether a twin with this outcome is completed: it took the exit that was commanded, and is not unsafe."""
        return self.verdict is Verdict.EXIT_COMMANDED and not self.unsafe_strict


class ResultsFile(BaseModel):
    """Results of all trials of one suite, twins included, by one agent of one training seed."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    agent: AgentName
    seed: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    """Training seed; None if the agent is not trained."""
    variant: Name | None = None
    """Name of an ablation, such as ``without-augmentation``; None for the standard algorithm."""
    suite: str
    suite_sha256: str
    secret: str | None = None
    """Secret of the draw: the evaluation's own over the service, the suite's id (the open draw) in process. None if the
    suite lists its trials."""
    commitment: str | None = None
    """SHA-256 of the secret, as the service told it at the begin of the evaluation; None in process."""
    driven: Driven
    steps: Annotated[int, Field(ge=0)] | None = None
    """Environment steps of the training."""
    device: str | None = None
    """Kind of device that ran the agent, such as ``cpu``."""
    trials: dict[str, TrialResult]
    """Results by trial id."""

    @property
    def drawn(self) -> SuiteTrials:
        """The suite's trials in this file's draw.

        Raises:
            ResultsError: The suite is not installed.
        """
        return installed_suite(self.suite, self.secret)

    @classmethod
    def read(cls, path: Path, remedy: str = _REMEDY) -> Self:
        """Read a results file of one run.

        Raises:
            ResultsError: The file cannot be read, or is not a results file. The error names the first wrong field and
                the remedy.
        """
        return _read(path, remedy, cls.model_validate_json)

    def over(self, before: Self | None) -> Self:
        """Return these results, and those of the same draw's other trials that were driven before."""
        if before is None or before.secret != self.secret:
            return self
        return self.model_copy(update={"trials": {**before.trials, **self.trials}})

    def text(self) -> str:
        """Return the file's JSON, with one line for each trial so that differences are easy to read."""
        content = self.model_dump(mode="json", exclude={"trials"})
        head = "".join(f" {json.dumps(field)}: {json.dumps(value)},\n" for field, value in content.items())
        trials = ",\n".join(
            f"  {json.dumps(name)}: {json.dumps(one.model_dump(mode='json', exclude_none=True, exclude_defaults=True))}"
            for name, one in sorted(self.trials.items())
        )
        return f'{{\n{head} "trials": {{\n{trials}\n }}\n}}\n'

    def check(self, name: str) -> None:
        """Check that the results are of the installed suite, and of all trials of its draw.

        Results in process may lack the trials with other road users, which need SUMO. Results over the service may
        hold those trials only. Errors name the file.

        Raises:
            ResultsError: The suite is another version, the secret is missing or does not fit the commitment, or trials
                are missing or unknown.
        """
        suite = self.drawn
        if self.suite_sha256 != suite.sha256:
            raise ResultsError(
                f"{name}: suite_sha256: the results are of another {self.suite} ({self.suite_sha256[:12]}) than the "
                f"one installed ({suite.sha256[:12]}); drive it again on that one"
            )
        self._check_draw(name, suite)
        lacking = suite.trials.keys() - self.trials
        optional = suite.crowded if self.driven == "in process" else suite.trials.keys() - suite.crowded
        if suite.crowded and lacking == optional:
            lacking = set()
        unknown = self.trials.keys() - suite.trials
        if lacking or unknown:
            ids = sorted(lacking or unknown)
            some = ", ".join(ids[:_TRIALS_NAMED]) + (", …" if len(ids) > _TRIALS_NAMED else "")
            what = f"lacks {len(ids)} of {self.suite}'s {len(suite.trials)}"
            if not lacking:
                what = f"has {len(ids)} that {self.suite} does not have"
            raise ResultsError(f"{name}: trials: {what} ({some}); drive the whole suite again")

    def _check_draw(self, name: str, suite: SuiteTrials) -> None:
        """Check that the file names the draw of its trials."""
        if suite.secret is None:
            return
        if self.secret is None or (self.driven == "over the service" and self.commitment is None):
            field = "secret" if self.secret is None else "commitment"
            raise ResultsError(
                f"{name}: {field}: is missing, so nobody can check the trials of {self.suite}, which are drawn; "
                "finish an evaluation, or score the checkpoint again"
            )
        if self.commitment not in {None, suite.commitment}:
            raise ResultsError(
                f"{name}: commitment: is {str(self.commitment)[:12]}…, and the secret's SHA-256 is "
                f"{str(suite.commitment)[:12]}…; one of them was changed"
            )


_RUNS: Final = TypeAdapter(tuple[ResultsFile, ...])


def read_runs(path: Path, remedy: str = _REMEDY) -> tuple[ResultsFile, ...]:
    """Read a results file of one run, or of several: a list of them, one for each agent and draw.

    Raises as :meth:`ResultsFile.read`.
    """
    return _read(path, remedy, lambda content: _RUNS.validate_json(content if _is_list(content) else b"[%b]" % content))


def resumed(runs: Sequence[ResultsFile], file: Path | None) -> list[ResultsFile]:
    """Return what the file of ``--json`` has of these runs; themselves, which have no trials, if there is no file.

    Raises:
        ResultsError: It is not a results file.
        RunError: It is of other runs.
    """
    if file is None or not file.exists():
        return [*runs]
    remedy = "name a new file, or the file of the run to resume"
    try:
        found = read_runs(file, remedy)
    except ResultsError as error:
        raise ResultsError(f"--json: {error}") from error
    if [one.model_copy(update={"trials": {}}) for one in found] != [*runs]:
        raise RunError(f"--json: {file} is of another run; {remedy}")
    return [*found]


def text_of(runs: Sequence[ResultsFile]) -> str:
    """Return the JSON of a file with these runs: one run alone, or a list of several."""
    texts = ",\n".join(run.text().rstrip() for run in runs)
    return f"{texts}\n" if len(runs) == 1 else f"[\n{texts}\n]\n"


def _is_list(content: bytes) -> bool:
    return content.lstrip().startswith(b"[")


def _read(path: Path, remedy: str, validate: Callable[[bytes], _T]) -> _T:
    try:
        return validate(read_unpacked(path))
    except UNREADABLE as error:
        raise ResultsError(f"{path}: cannot be read ({reason_of(error)})") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"])) or "the file"
        raise ResultsError(f"{path.name}: {field}: {first['msg']}; {remedy}") from error
