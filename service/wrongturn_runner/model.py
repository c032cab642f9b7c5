"""The model of a submission: loaded in its sandboxes, and one policy for each of its episodes."""

import contextlib
import hashlib
import queue
import time
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Final

from gymnasium import spaces
from numpy.typing import NDArray

from wrongturn_protocol import ActionLike, Rig, Track
from wrongturn_protocol.model_contract import ContractError, ModelContract, ModelSignature, TensorSpec, contract_of
from wrongturn_protocol.observations import Observation
from wrongturn_runner.conversation import ModelAtFaultError, NoRoomError, RunnerFailedError
from wrongturn_runner.messages import REASON_MOST, Job
from wrongturn_runner.pace import LOAD_S, Pace
from wrongturn_sandbox.errors import ModelRefusedError, SandboxBusyError, SandboxLostError, SandboxUnavailableError
from wrongturn_sandbox.host import Sandbox, open_sandbox
from wrongturn_sandbox.messages import Description, Limits
from wrongturn_sandbox.reasons import printable

_ROOM_S: Final = 20.0
"""Seconds to wait for a sandbox while all are taken."""
_LOOK_S: Final = 0.5
_LONGEST_ABOUT: Final = 2000
"""Most characters of an agent's description."""


class SandboxedModel:
    """A model that keeps the contract, loaded in one sandbox or more. Several threads may use it at once."""

    def __init__(self, sandboxes: Collection[Sandbox], description: Description, contract: ModelContract) -> None:
        """Take over sandboxes that have loaded the model."""
        self.contract = contract
        self.description = _line(description)
        """One line about its inputs, outputs and size."""
        self.about = printable(description.metadata.get("description", ""), _LONGEST_ABOUT) or None
        """What its metadata says of the agent."""
        self._idle: queue.SimpleQueue[Sandbox] = queue.SimpleQueue()
        for sandbox in sandboxes:
            self._idle.put(sandbox)

    def run(self, inputs: dict[str, NDArray[Any]]) -> tuple[dict[str, NDArray[Any]], float]:
        """Return the model's outputs and the seconds it took, once a sandbox is free.

        Raises ModelAtFaultError if the model fails or breaks a limit, RunnerFailedError if the sandbox is gone.
        """
        sandbox = self._idle.get()
        try:
            begin = time.perf_counter()
            with _explained():
                outputs = sandbox.run(inputs)
            return outputs, time.perf_counter() - begin
        finally:
            self._idle.put(sandbox)


class EpisodePolicy:
    """Drives one episode with a model, and holds the model's state between its steps."""

    def __init__(self, model: SandboxedModel, pace: Pace) -> None:
        self._model = model
        self._pace = pace
        self._step = 0
        self._state: NDArray[Any] | None = None

    def reset(self, _space: spaces.Space[Any], /) -> None:
        """Begin an episode with a state of zeros."""
        self._step = 0
        self._state = None

    @property
    def rig(self) -> Rig | None:
        """The model's rig."""
        return self._model.contract.rig

    def act(self, observation: Observation) -> ActionLike:
        """Return the model's action, in its rig's kind.

        Raises as :meth:`SandboxedModel.run`, also for a wrong or too slow one.
        """
        self._step += 1
        try:
            outputs, seconds = self._model.run(self._model.contract.feed(observation, self._state))
            with _explained():
                action = self._model.contract.action(outputs)
                self._state = self._model.contract.state(outputs)
        except ModelAtFaultError as error:
            raise ModelAtFaultError(f"at step {self._step} of an episode: {error}") from error
        self._pace.add(seconds)
        return action


@contextlib.contextmanager
def sandboxed_model(
    job: Job,
    *,
    step_s: float,
    life_s: float,
    tracks: Collection[Track] | None = None,
    agent_track: Track | None = None,
    agent_rig: Rig | None = None,
    sandboxes: int = 1,
) -> Iterator[SandboxedModel]:
    """Load a job's model in sandboxes for the ``with`` block.

    A step takes at most ``step_s``, and each sandbox at most ``life_s`` of processor time. The model drives in one of
    ``tracks``, and as an agent of ``agent_track`` and ``agent_rig`` if there is one. It can take as
    many steps at a time as it has sandboxes, fewer if no more are free. Raises ModelAtFaultError if its sandbox refuses
    it or it breaks the contract, RunnerFailedError if the file is damaged or there is no sandbox.
    """
    data = _read(job.model, job.sha256)
    limits = Limits(memory=job.memory, load_s=LOAD_S, step_s=step_s, life_s=life_s, gpu=job.gpu)
    with contextlib.ExitStack() as stack:
        with _explained():
            loaded = [stack.enter_context(_first_sandbox(job.socket, limits))]
            with contextlib.suppress(SandboxBusyError):  # fewer are slower, but do
                for _ in range(sandboxes - 1):
                    loaded.append(stack.enter_context(open_sandbox(job.socket, limits)))  # noqa: PERF401
            descriptions = [sandbox.load(data) for sandbox in loaded]
            del data
            contract = contract_of(_signature(descriptions[0]), tracks, agent_track, agent_rig)
        yield SandboxedModel(loaded, descriptions[0], contract)


def _first_sandbox(socket: Path | None, limits: Limits) -> Sandbox:
    """Open a sandbox, once one is free if all are taken. Raises NoRoomError, SandboxUnavailableError."""
    until = time.monotonic() + _ROOM_S
    while True:
        try:
            return open_sandbox(socket, limits)
        except SandboxBusyError as error:
            if time.monotonic() > until:
                raise NoRoomError(str(error)) from error
        time.sleep(_LOOK_S)


def _read(file: Path, sha256: str) -> bytes:
    try:
        data = file.read_bytes()
    except OSError as error:
        raise RunnerFailedError(f"the stored model cannot be read: {error.strerror}") from error
    if hashlib.sha256(data).hexdigest() != sha256:
        raise RunnerFailedError("the stored model is damaged: its SHA-256 is not that of the model handed in")
    return data


@contextlib.contextmanager
def _explained() -> Iterator[None]:
    """Turn errors of sandbox and contract into the runner's own."""
    try:
        yield
    except (ModelRefusedError, ContractError) as error:
        raise ModelAtFaultError(str(error)) from error
    except (SandboxLostError, SandboxUnavailableError) as error:
        raise RunnerFailedError(str(error)) from error


def _signature(description: Description) -> ModelSignature:
    def specs(tensors: Collection[Any]) -> tuple[TensorSpec, ...]:
        return tuple(TensorSpec(tensor.name, tensor.dtype, tuple(tensor.shape)) for tensor in tensors)

    return ModelSignature(
        specs(description.inputs), specs(description.outputs), description.opset, description.metadata
    )


def _line(description: Description) -> str:
    """Return one line about a model, for the log of its submission."""

    def axes(tensor: Any) -> str:
        # onnxruntime describes a tensor of free shape as it does a scalar, which no contract has.
        return ", ".join("?" if size is None else str(size) for size in tensor.shape) or "?"

    def names(tensors: Collection[Any]) -> str:
        return ", ".join(f"{tensor.name} {tensor.dtype}[{axes(tensor)}]" for tensor in tensors)

    return printable(
        f"inputs {names(description.inputs)}; outputs {names(description.outputs)}; opset {description.opset}; "
        f"{description.nodes} nodes, {description.parameters} parameters",
        REASON_MOST,
    )
