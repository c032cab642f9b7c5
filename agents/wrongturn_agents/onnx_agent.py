"""Agent that runs an ONNX file.

The contract is the same for ``wrongturn run FILE.onnx`` and for a submitted model: ``wrongturn_protocol.contract_of``
checks it, and ``docs/models.md`` shows it as a table. onnxruntime comes with an extra:
``wrongturn-agents[onnx]``.
"""

import os
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from gymnasium import spaces
from numpy.typing import NDArray

from wrongturn_agents.errors import ModelFileError, OnnxRuntimeMissingError, why_no_file
from wrongturn_protocol import (
    ActionLike,
    AgentKind,
    ContractError,
    ModelContract,
    ModelSignature,
    TensorSpec,
    contract_of,
)
from wrongturn_protocol.installing import install
from wrongturn_protocol.model_contract import DOUBT, check_opset
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.onnx_file import opset_of, signature_of

_DTYPES: Final = {"tensor(float)": "float32", "tensor(double)": "float64"}


class OnnxAgent:
    """Agent whose actions come from an ONNX model.

    Raises:
        OnnxRuntimeMissingError: onnxruntime is not installed.
        ModelFileError: The file is missing, is not an ONNX model, or breaks the contract.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._session: Any = open_session(file)
        said: dict[str, str] = self._session.get_modelmeta().custom_metadata_map
        self.contract: ModelContract = _contract(file, self._session, said)
        self.track = self.contract.track
        self.rig = self.contract.rig
        self.name: str = said.get("name", file.stem)
        self.kind = AgentKind.SUBMITTED
        self.description: str = said.get("description", f"ONNX model {file.name}")
        self.trained_on_faults: bool = self.contract.trained_on_faults
        """Whether the file says that its agent met wrong commands in its training."""
        self.memoryless: bool = self.contract.state_shape is None
        """Whether :meth:`act` depends on the observation alone, so that several threads may call it at once."""
        self._state: NDArray[Any] | None = None
        self.doubt: float | None = None
        """Probability that the last command was wrong, of a model with an output ``doubt``; None before the first."""

    def reset(self, observation_space: spaces.Space[Any]) -> None:  # noqa: ARG002 - of the interface
        """Forget the last episode. A model with a memory starts from zeros again."""
        self._state, self.doubt = None, None

    def act(self, observation: Observation) -> ActionLike:
        """Return the model's action, in its rig's kind.

        Raises:
            ModelFileError: The model fails on the observation, or its action has another shape or is not finite.
        """
        names = [*self.contract.outputs, *([DOUBT] if self.contract.doubts else [])]
        try:
            given = self._session.run(names, self.contract.feed(observation, self._state))
        except Exception as error:
            raise ModelFileError(f"{self._file}: the model fails on an observation: {error}") from error
        try:
            outputs = dict(zip(names, given, strict=True))
            action = self.contract.action(outputs)
            if not self.memoryless:
                self._state = self.contract.state(outputs)
            self.doubt = self.contract.doubt(outputs)
        except ContractError as error:
            raise ModelFileError(f"{self._file}: {error}") from error
        return action

    def act_batch(self, observations: Observation) -> list[ActionLike]:
        """Return the model's action for each row of the observations, of a model without a memory.

        The model gets one row at a time: onnxruntime rounds differently in a larger batch.
        """
        rows = len(observations["speed"])
        return [self.act({key: array[row] for key, array in observations.items()}) for row in range(rows)]


def load_onnxruntime() -> ModuleType:
    """Import onnxruntime with its telemetry off, unless ``ORT_DISABLE_TELEMETRY`` says otherwise.

    From 1.29 on, it starts a thread that keeps a database in the home folder and looks for its maker's servers. So
    nothing else imports it. Raises ImportError if onnxruntime is not installed.
    """
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # read when it is imported
    import onnxruntime  # noqa: PLC0415 - comes with an extra, and is slow to import

    module: ModuleType = onnxruntime
    return module


def open_session(file: Path, threads: int = 1) -> Any:
    """Return an ``onnxruntime.InferenceSession``. On one thread, the same observation gives the same action.

    Raises:
        OnnxRuntimeMissingError: onnxruntime is not installed.
        ModelFileError: The file is missing, or is not an ONNX model.
    """
    try:
        onnxruntime = load_onnxruntime()
    except ImportError:
        raise OnnxRuntimeMissingError(
            f"{file}: an ONNX model needs onnxruntime; install it with: {install('wrongturn-agents[onnx]')}"
        ) from None
    if not file.is_file():
        raise ModelFileError(f"{file}: {why_no_file(file)}; name an .onnx file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    try:
        return onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises many classes
        _blame_file(file)
        raise ModelFileError(f"{file}: onnxruntime cannot load it: {error}") from error


def _blame_file(file: Path) -> None:
    """Raise ModelFileError if a file is damaged or of another opset, which onnxruntime says less well."""
    try:
        if opset := signature_of(file).opset:
            check_opset(opset)
    except OSError as error:
        raise ModelFileError(f"{file}: cannot be read ({error.strerror or error}); name another .onnx file") from error
    except ContractError as error:
        raise ModelFileError(f"{file}: {error}") from error


def _contract(file: Path, session: Any, metadata: dict[str, str]) -> ModelContract:
    """Return how to drive with the model of a session. Raises ModelFileError if it breaks the contract."""
    signature = ModelSignature(
        inputs=tuple(_spec(put) for put in session.get_inputs()),
        outputs=tuple(_spec(put) for put in session.get_outputs()),
        opset=opset_of(file),
        metadata=metadata,
    )
    try:
        return contract_of(signature)
    except ContractError as error:
        raise ModelFileError(f"{file}: {error}") from error


def _spec(put: Any) -> TensorSpec:
    """Return an input or output as the contract describes it: with numpy's name of the type."""
    inside: str = put.type.removeprefix("tensor(").removesuffix(")") if put.type.startswith("tensor(") else put.type
    return TensorSpec(put.name, _DTYPES.get(put.type, inside), tuple(put.shape))
