"""Which runs a campaign trains, and in which order: the most valuable first."""

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, Final

from wrongturn_agents.training.config import config_of
from wrongturn_agents.training.errors import TrainingError

SUITES: Final = ("wrong-command@1", "navigation@1")
"""What each run is scored on."""
MINUTES: Final[Mapping[str, float]] = {"ppo-segmentation": 3.5, "ppo-image": 5.0, "ppo-auxiliary": 10.0}
"""Of a run, on an H200 that it shares with two others."""
SCORING: Final = 2.0
"""Minutes kept for scoring a run."""
_HEAVY: Final = "ppo-auxiliary"
_ABLATIONS: Final = (
    ("ppo-segmentation", "masked-classes", ("masked_classes=0.2",)),
    ("ppo-image", "without-augmentation", ("augment=false",)),
    ("ppo-auxiliary", "without-auxiliary-loss", ("auxiliary=false",)),
    ("ppo-image", "without-pretraining", ("pretrained=false",)),
)
_OFTEN: Final = {"ppo-segmentation": 600_000, "ppo-image": 800_000, "ppo-auxiliary": 500_000}


@dataclass(frozen=True, kw_only=True)
class Job:
    """A run to be trained and scored."""

    algorithm: str
    seed: int = 1
    variant: str | None = None
    """What its options make of the algorithm; told by them, and only part of the name here."""
    minutes: float | None = None
    """Of wall clock, with everything but scoring."""
    steps: int | None = None
    """Environment steps, where these are to end it."""
    options: tuple[str, ...] = ()
    """``name=value`` of the algorithm's configuration."""
    slots: int = 1
    """Of a GPU's; a GPU has three by default."""
    encoder_of: str | None = None
    """Name of the job whose pretrained encoder it takes; it waits for that one's pretraining."""

    @property
    def name(self) -> str:
        """Of the run, its directory and its log."""
        return ".".join([self.algorithm, *([self.variant] if self.variant else []), f"s{self.seed}"])

    @property
    def needs(self) -> float:
        """Minutes that must be left for it to be begun."""
        return (self.minutes or 0.0) + SCORING

    def as_dict(self) -> dict[str, Any]:
        """The fields by name, as JSON takes them."""
        return asdict(self)

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> "Job":
        """From its fields.

        Raises:
            TrainingError: a field is none of a job's, or has no sense.
        """
        unknown = sorted(set(told) - {field.name for field in fields(cls)})
        if unknown or "algorithm" not in told:
            wrong = f"{unknown[0]}: is no field of a job" if unknown else "algorithm: is missing"
            raise TrainingError(f"plan: {wrong}; a job has {', '.join(field.name for field in fields(cls))}")
        job = cls(**{**told, "options": tuple(told.get("options", ()))})
        variant = config_of(job.algorithm).with_options(job.options).variant
        if job.variant is None:
            job = replace(job, variant=variant)
        if job.minutes is None and job.steps is None:
            job = replace(job, minutes=MINUTES[job.algorithm])
        return job


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A campaign."""

    jobs: tuple[Job, ...]
    """In the order in which they are begun."""
    suites: tuple[str, ...] = SUITES
    slots: int = 3
    """Of each GPU: how many runs share it, a heavy one counting twice."""

    def __post_init__(self) -> None:
        names = [job.name for job in self.jobs]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise TrainingError(f"plan: {twice[0]} is in it twice; give each run a seed of its own")
        for job in self.jobs:
            if job.encoder_of is not None and job.encoder_of not in names:
                raise TrainingError(f"plan: {job.name}: encoder_of: there is no job {job.encoder_of}")
            if job.slots > self.slots:
                raise TrainingError(f"plan: {job.name}: slots: {job.slots} are more than a GPU's {self.slots}")


def default_plan(*, scale: float = 1.0, share_encoder: bool = False, options: tuple[str, ...] = ()) -> Plan:
    """Five seeds of each agent and the ablations: a seed of each agent first.

    Args:
        scale: factor of the runs' minutes.
        share_encoder: the image agent's other seeds take the first one's encoder.
        options: for all jobs whose algorithm has such a field.
    """

    def job(algorithm: str, seed: int, *more: str) -> Job:
        encoder = share_encoder and algorithm == "ppo-image" and seed > 1 and not more
        return Job.of(
            {
                "algorithm": algorithm,
                "seed": seed,
                "minutes": MINUTES[algorithm] * scale,
                "slots": 2 if algorithm == _HEAVY else 1,
                "options": (f"evaluate_every={_OFTEN[algorithm]}", "save_every=2", *more, *options),
                "encoder_of": "ppo-image.s1" if encoder else None,
            }
        )

    jobs = [job(algorithm, seed) for seed in (1, 2, 3) for algorithm in ("ppo-image", _HEAVY, "ppo-segmentation")]
    jobs += [job(algorithm, seed) for seed in (4, 5) for algorithm in ("ppo-image", "ppo-segmentation")]
    jobs += [job(algorithm, 1, *changed) for algorithm, _, changed in _ABLATIONS]
    jobs += [job(_HEAVY, seed) for seed in (4, 5)]
    return Plan(jobs=tuple(jobs))


def read_plan(path: Path) -> Plan:
    """A plan in TOML: ``suites``, ``slots``, and a ``[[jobs]]`` for each run with the fields of :class:`Job`.

    Raises:
        TrainingError: it cannot be read, or names what there is not.
    """
    try:
        told = tomllib.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise TrainingError(f"plan {path}: cannot be read ({error})") from error
    unknown = sorted(set(told) - {field.name for field in fields(Plan)})
    if unknown or not told.get("jobs"):
        raise TrainingError(f"plan {path}: {unknown[0] if unknown else 'jobs'}: give suites, slots and [[jobs]]")
    jobs = tuple(Job.of(job) for job in told["jobs"])
    return Plan(jobs=jobs, suites=tuple(told.get("suites", SUITES)), slots=told.get("slots", 3))
