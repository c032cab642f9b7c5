"""Write a policy of Stable-Baselines3 as one ONNX file that holds the whole agent. Its contract is ``docs/models.md``.

The file gives the deterministic action. Everything between an observation and that action happens in the graph: the
normalisation of ``VecNormalize``, the order of a picture's axes, and the limits of the action space.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import onnx
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import Tensor, nn

from wrongturn_agents.errors import AgentsError
from wrongturn_agents.onnx_agent import OnnxAgent
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.writing import check_target, export_graph, write_graph
from wrongturn_client.episode_calls import action_of
from wrongturn_protocol import Track
from wrongturn_protocol.observations import observation_space
from wrongturn_sb3.spaces import DrivingPolicy, Taken

COMPARED: Final = 200
"""Observations on which a file is compared with its policy."""
TOLERANCE: Final = 1e-3
"""Greatest difference of a control that counts as the same."""
_EXCEPTIONS: Final = 0.02
"""Share of the observations on which the difference may be greater: rounding can tip a choice of the network's, such as
the nearest of two points."""


@dataclass(frozen=True)
class Exported:
    """What was written, and how it compares with the policy."""

    algorithm: str
    track: Track
    inputs: tuple[str, ...]
    """Keys that the network looks at."""
    outputs: tuple[str, ...]
    greatest: float
    """Greatest difference of a control on the sampled observations."""
    exceptions: int
    """Observations on which a control differs by more than the tolerance."""


def export_sb3(
    source: Path | str,
    file: Path | str,
    *,
    vecnormalize: Path | str | None = None,
    actions: Path | str | None = None,
    name: str | None = None,
    description: str | None = None,
) -> Exported:
    """Write a policy of Stable-Baselines3 as an ONNX file, if their actions are the same. Loading it runs its code.

    The source and the two files of :class:`~wrongturn_sb3.spaces.DrivingPolicy` make the policy;
    the name, by default the file's, and the description are for the leaderboard.
    """
    source, file = Path(source), Path(file)
    check_target(file, name or file.stem, "--out")
    driving = DrivingPolicy(source, *(None if one is None else Path(one) for one in (vecnormalize, actions)))
    graph = _graph(source, driving)
    facts = {
        "name": name or file.stem,
        "track": str(driving.track),
        "description": description or f"Learned by {driving.algorithm} of Stable-Baselines3.",
        "algorithm": driving.algorithm,
    }
    unchecked = file.with_name(file.name + ".unchecked")
    try:
        write_graph(unchecked, graph, facts)
        differences = _differences(unchecked, driving)
        exceptions = int((differences > TOLERANCE).sum())
        if not exceptions <= _EXCEPTIONS * COMPARED:
            raise TrainingError(
                f"{source}: on {exceptions} of {COMPARED} sampled observations the file's action differs from the "
                f"policy's by more than {TOLERANCE}, at most by {differences.max():.2g}; does the network draw random "
                "numbers, or keep a memory?"
            )
        unchecked.replace(file)
    finally:
        unchecked.unlink(missing_ok=True)
    return Exported(
        algorithm=driving.algorithm,
        track=driving.track,
        inputs=tuple(put.name for put in graph.graph.input),
        outputs=driving.meaning.outputs,
        greatest=float(differences.max()),
        exceptions=exceptions,
    )


class _Prepare(nn.Module):
    """One array as the policy takes it: normalised, and with a picture's channels first."""

    mean: Tensor
    deviation: Tensor

    def __init__(self, key: Taken) -> None:
        super().__init__()
        self._key = key
        if key.scaling is not None:
            self.register_buffer("mean", torch.as_tensor(key.scaling.mean))
            self.register_buffer("deviation", torch.as_tensor(key.scaling.deviation))

    def forward(self, array: Tensor) -> Tensor:
        key = self._key
        if key.transposed and not key.scaled_first:
            array = array.permute(0, 3, 1, 2)
        if key.scaling is not None:
            # In float64, as VecNormalize has it.
            scaled = (array.double() - self.mean) / self.deviation
            array = scaled.clamp(-key.scaling.clip, key.scaling.clip).float()
        if key.transposed and key.scaled_first:
            array = array.permute(0, 3, 1, 2)
        return array


class _Driver(nn.Module):
    """The agent as the graph holds it, from an observation to the controls, each (1, 1)."""

    table: Tensor
    low: Tensor
    high: Tensor

    def __init__(self, driving: DrivingPolicy) -> None:
        super().__init__()
        meaning = driving.meaning
        self._policy = policy = driving.policy
        self._takes_one = driving.takes_one
        self._prepare = nn.ModuleDict({key.field.name: _Prepare(key) for key in driving.keys})
        self._discrete = meaning.table is not None
        self._number = len(meaning.outputs)
        if meaning.table is not None:
            self.register_buffer("table", torch.as_tensor(meaning.table))
        elif isinstance(policy.action_space, spaces.Box):
            self.register_buffer("low", torch.as_tensor(policy.action_space.low))
            self.register_buffer("high", torch.as_tensor(policy.action_space.high))

    def forward(self, observation: dict[str, Tensor]) -> tuple[Tensor, ...]:
        taken = {name: prepare(observation[name]) for name, prepare in self._prepare.items()}
        given = next(iter(taken.values())) if self._takes_one else taken
        actions = self._policy._predict(given, deterministic=True)
        if self._discrete:
            actions = self.table[actions.reshape(-1)]
        elif self._policy.squash_output:
            actions = self.low + 0.5 * (actions + 1.0) * (self.high - self.low)
        else:
            actions = torch.minimum(torch.maximum(actions, self.low), self.high)
        return tuple(actions[:, i : i + 1] for i in range(self._number))


def _graph(source: Path, driving: DrivingPolicy) -> onnx.ModelProto:
    """Return the agent's graph, with a batch axis of 1."""
    fields = [key.field for key in driving.keys]
    example = {field.name: torch.as_tensor(np.ones((1, *field.shape), field.numpy_dtype)) for field in fields}
    validated = torch.distributions.Distribution._validate_args
    torch.distributions.Distribution.set_default_validate_args(False)  # it looks at values, which a graph does not have
    try:
        graph = export_graph(_Driver(driving).eval(), {"observation": example}, list(example), driving.meaning.outputs)
        used = {name for node in graph.graph.node for name in node.input}
        for put in [put for put in graph.graph.input if put.name not in used]:
            graph.graph.input.remove(put)  # so that nobody has to send what the network does not look at
        onnx.checker.check_model(graph, full_check=True)
    except Exception as error:  # torch raises many classes
        raise TrainingError(
            f"{source}: torch cannot export the network: {_cause(error)}; a network whose steps depend on values (if, "
            "for, .item()) has to be written with torch.where and the like"
        ) from error
    finally:
        torch.distributions.Distribution.set_default_validate_args(validated)
    return graph


def _cause(error: BaseException) -> str:
    """Return the first line of what an exporter's error came from."""
    while error.__cause__ is not None:
        error = error.__cause__
    return f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0]}"


def _differences(file: Path, driving: DrivingPolicy) -> NDArray[np.float64]:
    """Return the greatest difference of a control on each sampled observation, (COMPARED,)."""
    space = observation_space(driving.track)
    space.seed(0)
    differences = []
    try:
        agent = OnnxAgent(file)
        for _ in range(COMPARED):
            observation = space.sample()
            made = action_of(agent.act(observation))
            wanted = driving.controls(observation)
            differences.append(np.abs(np.array([made.steer, made.throttle, made.brake]) - wanted).max())
    except AgentsError as error:
        raise TrainingError(f"the file that was made does not drive: {error}") from error
    return np.array(differences)
