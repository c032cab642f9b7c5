"""Trained agents that come with this package, as ONNX files with a model card beside each.

They need onnxruntime, which comes with an extra: ``wrongturn-agents[onnx]``.
"""

from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from wrongturn_agents.agent import Agent
from wrongturn_agents.doubting_agent import DoubtingAgent
from wrongturn_agents.errors import ModelFileError, OnnxRuntimeMissingError
from wrongturn_agents.onnx_agent import OnnxAgent, open_session
from wrongturn_client.invocation import program
from wrongturn_protocol import AgentKind, Track
from wrongturn_protocol.installing import install

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
    """An agent of the paper's kinds, the teacher of one, or one that doubts its command, trained by this project."""

    name: str
    track: Track
    description: str
    drives: str = ""
    """Name of the trained agent that drives behind this one's gate; empty for an agent that drives by itself."""
    kind: AgentKind = AgentKind.REFERENCE
    """Kind on the leaderboard: a published method."""

    @property
    def trained_on_faults(self) -> bool:
        """Whether it met wrong commands in its training."""
        return bool(self.drives)

    @property
    def file(self) -> Path:
        """Path of the weights; of an agent that doubts, of its gate."""
        return WEIGHTS / f"{self.name}{'.gate' if self.drives else ''}.onnx"

    @property
    def files(self) -> tuple[Path, ...]:
        """Paths of all files that drive: another agent drives if one of them changes."""
        return (self.file, SHIPPED_AGENTS[self.drives].file) if self.drives else (self.file,)

    @property
    def card(self) -> Path:
        """Path of the model card in Markdown: the weights, their training and their results."""
        return WEIGHTS / f"{self.name}.md"

    def make(self) -> Agent:
        """Load the agent.

        Raises:
            ModelFileError: The weights are missing or broken.
            OnnxRuntimeMissingError: onnxruntime is not installed.
        """
        if not self.file.is_file():
            algorithm, checkpoint = trained_with(self.name)
            raise ModelFileError(
                f"agent: {self.name} can be trained, but this version ships no weights of it; train it "
                f"('{program()} train {algorithm} --seed 1'), export it ('{program()} export "
                f"runs/{algorithm}-1/{checkpoint} {self.name}.onnx') and run the file "
                f"('{program()} run {self.name}.onnx')"
            )
        try:
            if not self.drives:
                return OnnxAgent(self.file)
            # Copies share the loaded files, so many cars cost no more memory than one.
            doubt, driving = _loaded(self.file, self.drives)
            return DoubtingAgent(doubt, copy(driving))
        except OnnxRuntimeMissingError:
            raise OnnxRuntimeMissingError(
                f"agent: {self.name} needs onnxruntime; install it with: {install('wrongturn-agents[onnx]')}"
            ) from None
        except ModelFileError as error:
            raise ModelFileError(
                f"agent: the weights of {self.name} are broken; install wrongturn-agents again ({error})"
            ) from error


@lru_cache(maxsize=8)
def _loaded(file: Path, drives: str) -> tuple[Any, OnnxAgent]:
    return open_session(file), OnnxAgent(SHIPPED_AGENTS[drives].file)


SHIPPED_AGENTS: Final = MappingProxyType(
    {
        name: ShippedAgent(name, track, f"Learned by {learned}.")
        for name, track, learned in (
            (
                "ppo-segmentation",
                Track.SEGMENTATION,
                "PPO to drive by the true segmentation, with a head for each command",
            ),
            (
                "ppo-image",
                Track.CAMERA,
                "PPO to drive by pictures, with a ResNet-34 that had learned segmentation beforehand",
            ),
            ("ppo-auxiliary", Track.CAMERA, "PPO to drive by pictures and, at the same time, to segment them"),
            (
                "lbc",
                Track.CAMERA,
                "imitation to drive by pictures, from an agent that saw the truth (Learning by Cheating)",
            ),
            (
                "lbc-privileged",
                Track.PRIVILEGED,
                "imitation of rules to drive by a bird's-eye view of the truth; it taught lbc",
            ),
            (
                "marln",
                Track.CAMERA,
                "Rainbow-IQN to drive by four pictures, with a ResNet-18 pretrained on affordances",
            ),
        )
    }
)
"""Trained agents by name."""

DOUBTING_AGENTS: Final = MappingProxyType(
    {
        name: ShippedAgent(
            name,
            SHIPPED_AGENTS[drives].track,
            f"Drives as {drives}, behind a gate that questions the command: by the {sees} it tells which exits the "
            "next junction has. Made for wrong commands.",
            drives,
        )
        for name, drives, sees in (
            ("doubting", "lbc", "picture"),
            ("doubting-segmentation", "ppo-segmentation", "segmentation"),
        )
    }
)
"""Trained agents that question their command, by name."""
