"""The contract of a model: what an ONNX file takes and gives, so that it can drive.

``wrongturn run FILE.onnx`` and the service's runner both go by it. This module knows the names, types and shapes of a
model, not the file; ``docs/models.md`` shows the contract as a table.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from math import prod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol.episodes import Action
from wrongturn_protocol.observations import FIELDS, Field, Observation
from wrongturn_protocol.vocabulary import Track

ACTION: Final = "action"
"""Output (N, 3) with steer, throttle and brake."""
CONTROLS: Final = (("steer", "accelerate"), ("steer", "throttle", "brake"), (ACTION,))
"""Sets of outputs, one of which a model has. Accelerate brakes below 0 and is throttle above."""
STATE_IN: Final = "state_in"
"""Input with what the model remembered at the step before; zeros at the start of an episode."""
STATE_OUT: Final = "state_out"
"""Output with what the model wants to remember."""
MAX_STATE_BYTES: Final = 1 << 20
"""Most bytes of a state."""
OPSETS: Final = (7, 26)
"""Least and greatest opset of ONNX's default domain that a model may have."""

_TRACKS: Final = (Track.STATE, Track.CAMERA, Track.SEGMENTATION, Track.PRIVILEGED)  # smaller tracks first
_FLOATS: Final = ("float32", "float64", "float16")
_CONTROL_NAMES: Final = tuple(dict.fromkeys(name for names in CONTROLS for name in names))
_SHOWN: Final = 60
_LISTED: Final = 8
_WAYS: Final = "steer and accelerate; or steer, throttle and brake; or action"

Shape = tuple[int | str | None, ...]


class ContractError(ValueError):
    """A model breaks the contract. The text names each tensor that is wrong, and the remedy."""

    def __init__(self, *messages: str) -> None:
        self.messages = messages
        """What is wrong, one message for each tensor."""
        super().__init__("; ".join(messages))


@dataclass(frozen=True)
class TensorSpec:
    """An input or output of a model, as onnxruntime describes it."""

    name: str
    dtype: str
    """Numpy's name of the type, such as ``float32``. For what is no tensor, onnxruntime's, such as ``seq(...)``."""
    shape: Shape
    """Sizes; a name or None for a free axis. Empty if the model declares none."""


@dataclass(frozen=True)
class ModelSignature:
    """All that the contract needs to know of a model."""

    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    opset: int
    """Version of ONNX's default domain."""
    metadata: Mapping[str, str]
    """Custom metadata of the file."""


@dataclass(frozen=True)
class ModelContract:
    """How to drive with a model that keeps the contract."""

    track: Track
    inputs: tuple[str, ...]
    """Names of its inputs that are keys of an observation."""
    outputs: tuple[str, ...]
    """Names of the outputs to ask for: the controls, and the state if it has one."""
    state_shape: tuple[int, ...] | None
    """Shape of its state, with a batch axis of 1; None for a model without a memory."""

    def feed(self, observation: Observation, state: NDArray[Any] | None = None) -> dict[str, NDArray[Any]]:
        """Return the model's inputs, each with a batch axis of 1.

        Args:
            observation: One array for each key of the track.
            state: What :meth:`state` returned for the step before; None at the start of an episode.
        """
        feed = {name: np.asarray(observation[name])[None] for name in self.inputs}
        if self.state_shape is not None:
            feed[STATE_IN] = np.zeros(self.state_shape, np.float32) if state is None else state
        return feed

    def action(self, outputs: Mapping[str, NDArray[Any]]) -> Action:
        """Return the action that a model's outputs mean. Values out of range are clipped.

        Args:
            outputs: The outputs by name; others than :attr:`outputs` are ignored.

        Raises:
            ContractError: A control is missing, is no number, has another shape, or is not finite.
        """
        if ACTION in self.outputs:
            steer, throttle, brake = _values(outputs, ACTION, 3)
        elif "accelerate" in self.outputs:
            (steer,), (accelerate,) = _values(outputs, "steer"), _values(outputs, "accelerate")
            throttle, brake = max(accelerate, 0.0), max(-accelerate, 0.0)
        else:
            (steer,), (throttle,), (brake,) = (_values(outputs, name) for name in CONTROLS[1])
        steer, throttle, brake = np.clip((steer, throttle, brake), (-1.0, 0.0, 0.0), 1.0).tolist()
        return Action(steer=steer, throttle=throttle, brake=brake)

    def state(self, outputs: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
        """Return what the model wants to remember for the next step; None for a model without a memory.

        Raises:
            ContractError: The state is missing, or has another type or shape than it had at the beginning.
        """
        if self.state_shape is None:
            return None
        state = np.asarray(_given(outputs, STATE_OUT))
        if state.dtype != np.float32 or state.shape != self.state_shape:
            raise ContractError(
                f"output {STATE_OUT}: is {state.dtype} {_written(state.shape)}; "
                f"it must be float32 {_written(self.state_shape)}, as {STATE_IN} is"
            )
        return state


def contract_of(signature: ModelSignature, tracks: Collection[Track] | None = None) -> ModelContract:
    """Return how to drive with a model.

    Args:
        signature: The model's inputs, outputs, opset and metadata.
        tracks: Tracks that the suite takes; None for any.

    Raises:
        ContractError: The model breaks the contract. The messages name each tensor and the remedy.
    """
    inputs = {put.name: put for put in signature.inputs}
    outputs = {put.name: put for put in signature.outputs}
    wrong: list[str] = []
    observed = tuple(name for name in inputs if name != STATE_IN)
    track: Track | None = None
    try:
        check_opset(signature.opset)
    except ContractError as error:
        wrong += error.messages
    try:
        track = _track(observed, signature.metadata.get("track"), tracks)
    except ContractError as error:
        wrong += error.messages
    if track is not None:
        fields = {field.name: field for field in FIELDS[track]}
        wrong += [message for name in observed for message in _wrong_input(inputs[name], fields[name])]
    controls = next((names for names in CONTROLS if set(names) == outputs.keys() & set(_CONTROL_NAMES)), ())
    wrong += [message for name in controls for message in _wrong_control(outputs[name])]
    if not controls:
        wrong.append(f"outputs: {_listed(outputs) or 'none'}; the contract wants {_WAYS}")
    wrong += _wrong_state(inputs.get(STATE_IN), outputs.get(STATE_OUT))
    if wrong or track is None:
        raise ContractError(*wrong)
    state = inputs.get(STATE_IN)
    return ModelContract(
        track=track,
        inputs=observed,
        outputs=controls if state is None else (*controls, STATE_OUT),
        state_shape=None if state is None else (1, *_static(state.shape)),
    )


def check_opset(opset: int) -> None:
    """Check the opset alone: onnxruntime does not load a model of an unknown one, so that nothing else is known of it.

    Raises:
        ContractError: The opset is out of range.
    """
    least, greatest = OPSETS
    if not least <= opset <= greatest:
        raise ContractError(f"opset: {opset}; export the model with one from {least} to {greatest}")


def _track(inputs: tuple[str, ...], said: str | None, tracks: Collection[Track] | None) -> Track:
    """Return the smallest track that has all inputs, or the one that the metadata names."""
    keys = {track: {field.name for field in FIELDS[track]} for track in _TRACKS}
    if said is not None and said not in keys:
        raise ContractError(f"metadata track: {_shown(said)} is none of {', '.join(_TRACKS)}")
    fitting = [track for track in _TRACKS if set(inputs) <= keys[track] and said in {None, track}]
    if not fitting:
        known = keys[Track(said)] if said is not None else set[str]().union(*keys.values())
        unknown = sorted(set(inputs) - known)
        reason = f"{_listed(unknown)}: no such observation key" if unknown else "no track has all of these"
        raise ContractError(f"inputs: {reason}; name each input after a key of one track's observations")
    if tracks is not None and fitting[0] not in tracks:
        allowed = ", ".join(track for track in _TRACKS if track in tracks)
        raise ContractError(
            f"inputs: they make it a model of the {fitting[0]} track, which the suite does not take; take keys of "
            f"another track ({allowed}), or name one that has these keys in the metadata's track"
        )
    return fitting[0]


def _wrong_input(put: TensorSpec, field: Field) -> Iterator[str]:
    """Yield what is wrong with an input that an observation's field goes into."""
    if put.dtype != field.dtype_name:
        inside = f"and convert it to {put.dtype} in the graph" if put.dtype in _FLOATS else "as observations have it"
        yield f"input {put.name}: takes {_shown(put.dtype)}; let it take {field.dtype_name}, {inside}"
    wanted = (1, *field.shape)
    if put.shape and not _fits(put.shape, wanted):
        yield (
            f"input {put.name}: takes {_written(put.shape)}; let it take {_written(('N', *field.shape))}, "
            f"where N is a batch axis of 1 or free{', and transpose it in the graph' if field.image else ''}"
        )


def _wrong_control(put: TensorSpec) -> Iterator[str]:
    """Yield what is wrong with an output that holds controls."""
    if put.dtype not in _FLOATS:
        yield f"output {put.name}: is {_shown(put.dtype)}; let it be float32"
    wide = 3 if put.name == ACTION else 1
    flat = wide == 1 and _fits(put.shape, (1,))
    if put.shape and not flat and not _fits(put.shape, (1, wide)):
        wanted = _written(("N", wide))
        yield f"output {put.name}: is {_written(put.shape)}; let it be {wanted}, where N is the batch axis"


def _wrong_state(taken: TensorSpec | None, given: TensorSpec | None) -> Iterator[str]:
    """Yield what is wrong with a state."""
    if taken is None or given is None:
        for put, missing, kind in ((taken, STATE_OUT, "output"), (given, STATE_IN, "input")):
            if put is not None:
                yield f"{put.name}: there is no {kind} {missing}; a model with a memory has both"
        return
    for put, kind in ((taken, "input"), (given, "output")):
        if put.dtype != "float32":
            yield f"{kind} {put.name}: is {_shown(put.dtype)}; let it be float32"
        if not put.shape or not _fits(put.shape[:1], (1,)):
            yield f"{kind} {put.name}: is {_written(put.shape)}; let it begin with a batch axis of 1, or a free one"
        elif not all(isinstance(size, int) and size > 0 for size in put.shape[1:]):
            yield f"{kind} {put.name}: is {_written(put.shape)}; give every axis after the batch axis a fixed size"
        elif put is taken and (size := 4 * prod(_static(put.shape))) > MAX_STATE_BYTES:
            yield f"{kind} {put.name}: takes {size} bytes; a state has at most {MAX_STATE_BYTES}, so remember less"
    if taken.shape[1:] != given.shape[1:]:
        yield (
            f"{STATE_OUT}: is {_written(given.shape)} and {STATE_IN} is {_written(taken.shape)}; "
            "give both the same shape"
        )


def _static(shape: Shape) -> tuple[int, ...]:
    """Return the sizes after the batch axis."""
    return tuple(size for size in shape[1:] if isinstance(size, int))


def _fits(shape: Shape, wanted: tuple[int, ...]) -> bool:
    """Return whether an array of the wanted shape can go where this one is declared."""
    return len(shape) == len(wanted) and all(
        not isinstance(size, int) or size == want for size, want in zip(shape, wanted, strict=True)
    )


def _values(outputs: Mapping[str, NDArray[Any]], name: str, wide: int = 1) -> list[float]:
    """Return the numbers of an output of shape (1, wide), or (1,) for a single one.

    Raises:
        ContractError: It is missing, is no number, has another shape, or is not finite.
    """
    given = np.asarray(_given(outputs, name))
    shapes = ((1, wide), (1,)) if wide == 1 else ((1, wide),)
    if given.dtype.name not in _FLOATS or given.shape not in shapes or not np.isfinite(given).all():
        shown = f"{given.tolist()}, " if given.size <= _LISTED else ""
        raise ContractError(
            f"output {name}: is {shown}{given.dtype} {_written(given.shape)}; "
            f"it must be finite and float32 {_written(shapes[0])}"
        )
    values: list[float] = given.astype(np.float64).reshape(-1).tolist()
    return values


def _given(outputs: Mapping[str, NDArray[Any]], name: str) -> NDArray[Any]:
    if name not in outputs:
        raise ContractError(f"output {name}: is missing; the model must give it at each step")
    return outputs[name]


def _written(shape: Shape) -> str:
    """Return a shape as a person writes it, free axes as N or by their names."""
    sizes = [str(size) if isinstance(size, int) else _shown(size or "N") for size in shape]
    return f"({', '.join(sizes)}{',' if len(sizes) == 1 else ''})"


def _shown(text: str) -> str:
    """Return a text of the model's, bounded and without control characters: its author chooses it."""
    short = text if len(text) <= _SHOWN else text[: _SHOWN - 1] + "…"
    return short if short.isprintable() else repr(short)


def _listed(names: Collection[str]) -> str:
    """Return the first names of a list."""
    first = [_shown(name) for name in list(names)[:_LISTED]]
    more = len(names) - len(first)
    return ", ".join(first) + (f" and {more} more" if more else "")
