"""The file that keeps what one agent of one seed came to on one suite."""

import json
import re
from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from wrongturn_agents.reporting.errors import ResultsError
from wrongturn_protocol import Reaction, Verdict

Driven = Literal["in process", "over the service"]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
_STEM: Final = re.compile(r"[^A-Za-z0-9@.]+")


class TrialResult(BaseModel):
    """What one trial came to."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    verdict: Verdict
    reaction: Reaction | None = None
    """To the fault; None where there is none."""
    clean: bool | None = None
    """Whether a journey was driven without infraction; None of what is no journey."""


class ResultsFile(BaseModel):
    """All trials of one suite, twins too, driven by one agent of one training seed."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)

    agent: Name
    seed: Annotated[int, Field(ge=0)] | None = None
    """Of the training; None of an agent that is not trained."""
    variant: Name | None = None
    """Of an ablation, such as ``without-augmentation``; None of the algorithm as it is."""
    suite: str
    suite_sha256: str
    driven: Driven
    steps: Annotated[int, Field(ge=0)] | None = None
    """Environment steps that the training took."""
    device: str | None = None
    """On which kind of device it drove, such as ``cpu``."""
    trials: dict[str, TrialResult]
    """By the trial's id."""

    @property
    def stem(self) -> str:
        """The name under which it is kept, the same for the same agent, seed, variant, suite and way of driving."""
        parts = [self.agent, self.variant, None if self.seed is None else f"s{self.seed}", self.suite, self.driven]
        return ".".join(_STEM.sub("-", part) for part in parts if part is not None)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read one.

        Raises:
            ResultsError: it cannot be read, or is no results file; the first wrong field is named.
        """
        try:
            return cls.model_validate_json(path.read_bytes())
        except OSError as error:
            raise ResultsError(f"{path}: cannot be read ({error.strerror})") from error
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            field = ".".join(map(str, first["loc"])) or "the file"
            raise ResultsError(
                f"{path.name}: {field}: {first['msg']}; write it anew by 'wrongturn score' or 'wrongturn results "
                "--import'",
            ) from error

    def write(self, directory: Path) -> Path:
        """Write it into a directory under its own name; gives the path.

        Raises:
            ResultsError: it cannot be written.
        """
        path = directory / f"{self.stem}.json"
        try:
            path.write_text(self.text(), encoding="utf-8")
        except OSError as error:
            raise ResultsError(f"{path}: cannot be written ({error.strerror}); name another --directory") from error
        return path

    def text(self) -> str:
        """Its JSON, a line for each trial: short to store, and a change of one is a change of one line."""
        content = self.model_dump(mode="json") | {
            "trials": {
                name: self.trials[name].model_dump(mode="json", exclude_none=True) for name in sorted(self.trials)
            },
        }
        trials = ",\n".join(f"  {json.dumps(name)}: {json.dumps(one)}" for name, one in content.pop("trials").items())
        head = "".join(f" {json.dumps(field)}: {json.dumps(value)},\n" for field, value in content.items())
        return f'{{\n{head} "trials": {{\n{trials}\n }}\n}}\n'
