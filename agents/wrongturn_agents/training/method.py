"""What a training method is, and which ones are installed."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import torch
from torch import nn

from wrongturn_agents.training.checkpoint import load_checkpoint, load_weights
from wrongturn_agents.training.drive import AnyModel
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.progress import COLUMNS
from wrongturn_agents.training.settings import Settings
from wrongturn_protocol import Track

if TYPE_CHECKING:
    from wrongturn_agents.training.run import Run

_OURS: Final = "wrongturn_agents."
METHODS: Final = "wrongturn.methods"
"""Group of the entry points. Each names a :class:`Method`, and has its name."""


@dataclass(frozen=True)
class TrainedAgent:
    """A kind of agent that a method trains."""

    name: str
    """Its algorithm in checkpoints."""
    track: Track
    """Track whose observations it drives by."""
    keys: tuple[str, ...]
    """Keys of the observation that it looks at."""
    description: str
    """The agent in a sentence, for the leaderboard."""


@dataclass(frozen=True)
class Loaded:
    """An agent from its checkpoint, ready to drive."""

    method: "Method"
    agent: TrainedAgent
    model: AnyModel
    settings: Settings
    told: Mapping[str, Any]
    """The checkpoint."""

    @property
    def variant(self) -> str | None:
        """Name of the ablation; None for the unchanged algorithm, and for an agent that is not the method's own."""
        return self.settings.variant if self.agent.name == self.method.name else None


class Method(ABC):
    """A way to train an agent, which ``wrongturn train NAME`` offers."""

    settings: type[Settings]
    """Its settings. Their ``algorithm`` is the method's name."""
    agents: tuple[TrainedAgent, ...]
    """What it trains. The first has the method's name."""
    unit: ClassVar[str] = "steps"
    """What ``--steps`` counts."""
    columns: Sequence[str] = COLUMNS
    """Columns of ``progress.csv``. Figures of a row without a column are left out."""

    @property
    def name(self) -> str:
        """Name for ``wrongturn train``."""
        return self.settings.algorithm

    @abstractmethod
    def build(self, settings: Any, algorithm: str) -> nn.Module:
        """Return an untrained agent, one of :attr:`agents`, on the CPU. Torch's random state gives its weights."""

    @abstractmethod
    def learn(self, run: "Run") -> None:
        """Train until the run's budget is over, and leave ``best.pt`` in its directory."""

    def prepare(self, settings: Any) -> Any:  # noqa: ARG002 - most methods need nothing
        """Return, as ``run.given``, what the settings name, such as a file. Nothing has been written by then.

        Raises:
            TrainingError: it is missing or damaged.
        """
        return None

    def load(self, told: Mapping[str, Any], settings: Any, device: torch.device | str = "cpu") -> Any:
        """Return the agent of a checkpoint, ready to drive.

        Raises:
            TrainingError: its weights do not fit this version's networks, or are not finite.
        """
        model = self.build(settings, told["algorithm"])
        load_weights(model, told["state_dict"])
        return model.to(device).eval()

    def export(self, loaded: Loaded, file: Path, precision: str, **options: Any) -> Any:
        """Write an agent as an ONNX file; see :func:`~wrongturn_agents.training.export.export.export`."""
        from wrongturn_agents.training.export.export import write_agent  # noqa: PLC0415 - needs onnx

        return write_agent(loaded, file, precision, **options)


def method_names() -> list[str]:
    """Return the names of the installed methods, without loading any."""
    return sorted(_points())


def find_method(name: str) -> Method:
    """Return the method of a name.

    Raises:
        TrainingError: there is none, or it cannot be loaded.
    """
    point = _points().get(name)
    if point is None:
        raise TrainingError(f"ALGORITHM: there is no {name!r}; choose one of {', '.join(method_names())}")
    return _loaded(point)


def load(checkpoint: Path | str, device: torch.device | str = "cpu") -> Loaded:
    """Load an agent from a checkpoint of ``wrongturn train``.

    Raises:
        TrainingError: the file is missing, damaged, or of a method that is not installed.
    """
    told, points = load_checkpoint(checkpoint), _points()
    for name in sorted(points, key=lambda name: not told["algorithm"].startswith(name)):  # the likeliest first
        method = _loaded(points[name])
        for agent in method.agents:
            if agent.name == told["algorithm"]:
                try:
                    settings = method.settings.of(told["config"])
                except TrainingError as error:
                    raise TrainingError(f"checkpoint {checkpoint}: {error}") from error
                return Loaded(method, agent, method.load(told, settings, device), settings, told)
    names = ", ".join(method_names())
    raise TrainingError(f"checkpoint {checkpoint}: there is no {told['algorithm']!r}; choose one of {names}")


def _points() -> dict[str, EntryPoint]:
    """Return the installed methods by name. No other package's replaces one of ours."""
    points = entry_points(group=METHODS)
    return {point.name: point for point in sorted(points, key=lambda point: point.module.startswith(_OURS))}


def _loaded(point: EntryPoint) -> Method:
    try:
        found = point.load()
    except Exception as error:  # another package's code may raise anything
        package = point.dist.name if point.dist is not None else "its package"
        raise TrainingError(
            f"ALGORITHM: {point.name} of {package} ({point.value}) cannot be loaded: {type(error).__name__}: {error}"
        ) from error
    if not isinstance(found, Method) or found.name != point.name:
        raise TrainingError(f"ALGORITHM: {point.value} is no method of the name {point.name}; see docs/extending.md")
    return found
