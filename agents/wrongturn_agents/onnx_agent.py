"""Agent that runs an ONNX file.

The contract is the same for ``wrongturn run FILE.onnx`` and for a submitted model:

* Each input has the name of an observation key. It takes that array with a batch axis in front and the observation's
  dtype: ``speed`` float32 (1, 1), ``command`` int64 (1, 1), ``rgb`` uint8 (1, 64, 192, 3) and so on. A model need not
  take every key. Its track is the smallest one with all of its inputs, unless its metadata names a larger one.
* One output is called ``action``: float32 (1, 3) with steer, throttle and brake. Values out of range are clipped.
* The model's metadata may hold ``name``, ``track`` and ``description``.
* The model keeps no memory between steps, so that it can drive several episodes at once.

onnxruntime comes with an extra: ``python -m pip install 'wrongturn-agents[onnx]'``.
"""

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from gymnasium import spaces

from wrongturn_agents.errors import ModelFileError, OnnxRuntimeMissingError
from wrongturn_client.invocation import python
from wrongturn_protocol import Action, AgentKind, Track
from wrongturn_protocol.observations import FIELDS, Observation

_TRACKS: Final = (Track.STATE, Track.CAMERA, Track.SEGMENTATION, Track.PRIVILEGED)  # smaller tracks first
ACTION: Final = "action"
"""Name of the output."""


class OnnxAgent:
    """Agent whose actions come from an ONNX model.

    Raises:
        OnnxRuntimeMissingError: onnxruntime is not installed.
        ModelFileError: The file is missing, is not an ONNX model, or breaks the contract.
    """

    memoryless = True
    """True: :meth:`act` depends on the observation alone, and several threads may call it at once."""

    def __init__(self, file: Path) -> None:
        self._session: Any = open_session(file)
        said: dict[str, str] = self._session.get_modelmeta().custom_metadata_map
        self._inputs: tuple[str, ...] = tuple(put.name for put in self._session.get_inputs())
        self.track: Track = _track(file, self._inputs, said.get("track"))
        self.name: str = said.get("name", file.stem)
        self.kind = AgentKind.SUBMITTED
        self.description: str = said.get("description", f"ONNX model {file.name}")
        outputs = [put.name for put in self._session.get_outputs()]
        if ACTION not in outputs:
            raise ModelFileError(f"{file}: outputs: {', '.join(outputs)}; the contract wants one called {ACTION}")
        self._file = file

    def reset(self, observation_space: spaces.Space[Any]) -> None:
        """Do nothing, because a model keeps no memory."""

    def act(self, observation: Observation) -> Action:
        """Return the model's action.

        Raises:
            ModelFileError: The model fails on the observation, or its action has another shape or is not finite.
        """
        try:
            (batch,) = self._session.run([ACTION], {name: observation[name][None] for name in self._inputs})
        except Exception as error:
            raise ModelFileError(f"{self._file}: the model fails on an observation: {error}") from error
        action = np.asarray(batch, np.float64)
        if action.shape != (1, 3) or not all(map(math.isfinite, action[0])):
            raise ModelFileError(f"{self._file}: output {ACTION} is {action.tolist()}; it must be finite and (1, 3)")
        steer, throttle, brake = np.clip(action[0], (-1.0, 0.0, 0.0), 1.0).tolist()
        return Action(steer=steer, throttle=throttle, brake=brake)


def open_session(file: Path) -> Any:
    """Return an ``onnxruntime.InferenceSession`` on one thread.

    Raises:
        OnnxRuntimeMissingError: onnxruntime is not installed.
        ModelFileError: The file is missing, or is not an ONNX model.
    """
    try:
        import onnxruntime  # noqa: PLC0415 - comes with an extra, and is slow to import
    except ImportError:
        raise OnnxRuntimeMissingError(
            f"{file}: an ONNX model needs onnxruntime; install it with: "
            f"{python()} -m pip install 'wrongturn-agents[onnx]'",
        ) from None
    if not file.is_file():
        raise ModelFileError(f"{file}: there is no such file; name an .onnx file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # so that the same observation gives the same action
    try:
        return onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime raises many classes
        raise ModelFileError(f"{file}: onnxruntime cannot load it: {error}") from error


def _track(file: Path, inputs: tuple[str, ...], said: str | None) -> Track:
    keys = {track: {field.name for field in FIELDS[track]} for track in _TRACKS}
    if said is not None and said not in keys:
        raise ModelFileError(f"{file}: metadata track: {said!r} is none of {', '.join(_TRACKS)}")
    fitting = [track for track in _TRACKS if set(inputs) <= keys[track] and said in {None, track}]
    if not fitting:
        known = keys[Track(said)] if said is not None else set[str]().union(*keys.values())
        unknown = sorted(set(inputs) - known)
        reason = f"{', '.join(unknown)}: no such observation key" if unknown else "no track has all of these"
        raise ModelFileError(f"{file}: inputs: {reason}; name each input after a key of one track's observations")
    return fitting[0]
