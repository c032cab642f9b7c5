"""Trained agents that come with this package, as ONNX files with a model card beside each.

They need onnxruntime, which comes with an extra: ``python -m pip install 'wrongturn-agents[onnx]'``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, TypeVar

from wrongturn_agents.errors import ModelFileError, OnnxRuntimeMissingError
from wrongturn_client.invocation import program, python
from wrongturn_protocol import AgentKind, Track

if TYPE_CHECKING:
    from wrongturn_agents.onnx_agent import OnnxAgent

T = TypeVar("T")

WEIGHTS: Final = Path(__file__).parent / "weights"
"""Directory of the files and their cards."""


_TRAINED_WITH: Final = MappingProxyType({"lbc-privileged": ("lbc", "privileged.pt")})


def trained_with(name: str) -> tuple[str, str]:
    """Return the algorithm of ``wrongturn train`` that makes an agent, and the file of its run that holds it.

    Example: ``("ppo-image", "best.pt")`` for ``ppo-image``
    """
    return _TRAINED_WITH.get(name, (name, "best.pt"))


@dataclass(frozen=True)
class ShippedAgent:
    """An agent of the paper's kinds, or the teacher of one, trained by this project."""

    name: str
    track: Track
    description: str
    kind: AgentKind = AgentKind.REFERENCE
    """Kind on the leaderboard: a published method."""
    trained_on_faults: bool = False
    """Whether it met wrong commands in its training."""

    @property
    def file(self) -> Path:
        """Path of the weights."""
        return WEIGHTS / f"{self.name}.onnx"

    @property
    def card(self) -> Path:
        """Path of the model card in Markdown: the weights, their training and their results."""
        return WEIGHTS / f"{self.name}.md"

    def make(self) -> "OnnxAgent":
        """Load the agent.

        Raises:
            ModelFileError: The weights are missing or broken.
            OnnxRuntimeMissingError: onnxruntime is not installed.
        """
        from wrongturn_agents.onnx_agent import OnnxAgent  # noqa: PLC0415 - loads an optional extra

        return load_shipped(self.name, self.file, OnnxAgent)


def load_shipped(name: str, file: Path, load: Callable[[Path], T]) -> T:
    """Load an agent's file. Raises ModelFileError or OnnxRuntimeMissingError, which say what to do."""
    if not file.is_file():
        algorithm, checkpoint = trained_with(name)
        raise ModelFileError(
            f"agent: {name} can be trained, but this version ships no weights of it; train it "
            f"('{program()} train {algorithm} --seed 1'), export it ('{program()} export "
            f"runs/{algorithm}-1/{checkpoint} {name}.onnx') and run the file ('{program()} run {name}.onnx')"
        )
    try:
        return load(file)
    except OnnxRuntimeMissingError:
        raise OnnxRuntimeMissingError(
            f"agent: {name} needs onnxruntime; install it with: {python()} -m pip install 'wrongturn-agents[onnx]'"
        ) from None
    except ModelFileError as error:
        raise ModelFileError(
            f"agent: the weights of {name} are broken; install wrongturn-agents again ({error})"
        ) from error


SHIPPED_AGENTS: Final = MappingProxyType(
    {
        agent.name: agent
        for agent in (
            ShippedAgent(
                "ppo-segmentation",
                Track.SEGMENTATION,
                "Learned by PPO to drive by the true segmentation, with a head for each command.",
            ),
            ShippedAgent(
                "ppo-image",
                Track.CAMERA,
                "Learned by PPO to drive by pictures, with a ResNet-34 that had learned segmentation beforehand.",
            ),
            ShippedAgent(
                "ppo-auxiliary",
                Track.CAMERA,
                "Learned by PPO to drive by pictures and, at the same time, to segment them.",
            ),
            ShippedAgent(
                "lbc",
                Track.CAMERA,
                "Learned by imitation to drive by pictures, from an agent that saw the truth (Learning by Cheating).",
            ),
            ShippedAgent(
                "lbc-privileged",
                Track.PRIVILEGED,
                "Learned by imitation of rules to drive by a bird's-eye view of the truth; it taught lbc.",
            ),
            ShippedAgent(
                "marln",
                Track.CAMERA,
                "Learned by Rainbow-IQN to drive by four pictures, with a ResNet-18 pretrained on affordances.",
            ),
        )
    }
)
"""Trained agents by name."""
