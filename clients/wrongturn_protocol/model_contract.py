"""The contract of a model: what an ONNX file takes and gives, so that it can drive.

``wrongturn run FILE.onnx`` and the service's runner both go by it. This module knows the names, types and shapes of a
model, not the file; ``docs/models.md`` shows the contract as a table.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import prod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol.actions import ActionLike
from wrongturn_protocol.episodes import Action
from wrongturn_protocol.observations import FIELDS, Field, Observation, fields_of
from wrongturn_protocol.rigs import Rig, RigError, Sight, rig_of, sight_of, track_of
from wrongturn_protocol.tracking import FAR
from wrongturn_protocol.vocabulary import Track

ACTION: Final = "action"
"""Output (N, 3) with steer, throttle and brake."""
WAYPOINTS: Final = "waypoints"
"""Output (N, n, 2) of a rig that answers with waypoints."""
CONTROLS: Final = (("steer", "accelerate"), ("steer", "throttle", "brake"), (ACTION,))
"""Sets of outputs, one of which a model has. Accelerate brakes below 0 and is throttle above."""
STATE_IN: Final = "state_in"
"""Input with what the model remembered at the step before; zeros at the start of an episode."""
STATE_OUT: Final = "state_out"
"""Output with what the model wants to remember."""
DOUBT: Final = "doubt"
"""Output (N, 1) with the probability that the command is wrong. It changes nothing: it is for studies of doubt."""
MAX_STATE_BYTES: Final = 1 << 20
"""Most bytes of a state."""
OPSETS: Final = (7, 26)
"""Least and greatest opset of ONNX's default domain that a model may have."""

_TRACKS: Final = (Track.STATE, Track.CAMERA, Track.WORDS, Track.SEGMENTATION, Track.PRIVILEGED)  # smaller tracks first
_KEYS: Final = {field.name: field for track in _TRACKS for field in FIELDS[track]}
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
    trained_on_faults: bool = False
    """Whether its metadata says that the agent met wrong commands in its training."""
    rig: Rig | None = None
    """The rig that its metadata declares; None: what its track shows."""
    doubts: bool = False
    """Whether it has an output ``doubt``."""

    @property
    def sight(self) -> Sight:
        """What it is shown."""
        return self.rig or self.track

    def feed(self, observation: Observation, state: NDArray[Any] | None = None) -> dict[str, NDArray[Any]]:
        """Return the model's inputs, each with a batch axis of 1.

        ``state`` is what :meth:`state` returned for the step before, None at the start of an episode.
        """
        feed = {name: np.asarray(observation[name])[None] for name in self.inputs}
        if self.state_shape is not None:
            feed[STATE_IN] = np.zeros(self.state_shape, np.float32) if state is None else state
        return feed

    def action(self, outputs: Mapping[str, NDArray[Any]]) -> ActionLike:
        """Return what a model's outputs mean, in its rig's kind of action. Controls out of range are clipped.

        Raises:
            ContractError: An output is missing, is no number, has another shape, or is not finite.
        """
        kind = "controls" if self.rig is None else self.rig.action.kind
        if self.rig is not None and kind == "waypoints":
            trajectory: NDArray[Any] = _checked(outputs, WAYPOINTS, ((1, len(self.rig.action.times), 2),))[0]
            if np.abs(trajectory).max() >= FAR:
                raise ContractError(f"output {WAYPOINTS}: is farther than {FAR:.0f} m; give metres from the car")
            return trajectory
        steer, *pedals = (value for name in self.outputs if name != STATE_OUT for value in _values(outputs, name))
        if "accelerate" in self.outputs:
            pedals = [max(pedals[0], 0.0), max(-pedals[0], 0.0)]
        if kind == "increments":
            return np.clip((steer, *pedals), (-2.0, 0.0, 0.0), (2.0, 1.0, 1.0))
        return Action(*np.clip((steer, *pedals), (-1.0, 0.0, 0.0), 1.0).tolist())

    def doubt(self, outputs: Mapping[str, NDArray[Any]]) -> float | None:
        """Return the probability that the command is wrong, kept from 0 to 1; None for a model without the output.

        Raises:
            ContractError: It is missing, is no number, has another shape, or is not finite.
        """
        return min(max(*_values(outputs, DOUBT), 0.0), 1.0) if self.doubts else None

    def state(self, outputs: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
        """Return what the model wants to remember for the next step; None for a model without a memory.

        Raises:
            ContractError: It is missing, is not finite, or has another type or shape than at the beginning.
        """
        if self.state_shape is None:
            return None
        state = np.asarray(_given(outputs, STATE_OUT))
        if state.dtype != np.float32 or state.shape != self.state_shape:
            raise ContractError(
                f"output {STATE_OUT}: is {state.dtype} {_written(state.shape)}; "
                f"it must be float32 {_written(self.state_shape)}, as {STATE_IN} is"
            )
        if not (finite := np.isfinite(state)).all():
            raise ContractError(
                f"output {STATE_OUT}: {int(np.count_nonzero(~finite))} of its {state.size} numbers are not finite; "
                "it must be finite"
            )
        return state


def contract_of(
    signature: ModelSignature,
    tracks: Collection[Track] | None = None,
    agent_track: Track | None = None,
    agent_rig: Rig | None = None,
) -> ModelContract:
    """Return how to drive with a model.

    ``tracks`` are those that the suite takes, None for any. ``agent_track`` and ``agent_rig`` are those of the agent as
    which the model has to drive; None if there is no agent yet.

    Raises:
        ContractError: The model breaks the contract. The messages name each tensor and the remedy.
    """
    inputs = {put.name: put for put in signature.inputs}
    outputs = {put.name: put for put in signature.outputs}
    observed = tuple(name for name in inputs if name != STATE_IN)
    wrong: list[str] = []
    track: Track | None = None
    try:
        check_opset(signature.opset)
    except ContractError as error:
        wrong += error.messages
    rig, said_track = _rig(signature.metadata)
    try:
        track = _track(observed, said_track, tracks, agent_track, rig)
        if agent_track is not None and rig != agent_rig:
            raise ContractError("metadata rig: is not the agent's; hand it in with the owner's token by another name")
    except ContractError as error:
        wrong += error.messages
    keys = _KEYS if rig is None else {field.name: field for field in fields_of(rig)}
    wrong += [message for name in observed if name in keys for message in _wrong_input(inputs[name], keys[name])]
    if rig is not None and rig.action.kind == "waypoints":
        controls: tuple[str, ...] = (WAYPOINTS,)
        wrong += _wrong_waypoints(outputs.get(WAYPOINTS), len(rig.action.times))
    else:
        controls = next((names for names in CONTROLS if set(names) == outputs.keys() & set(_CONTROL_NAMES)), ())
        wrong += [message for name in controls for message in _wrong_control(outputs[name])]
        if not controls:
            wrong.append(f"outputs: {_listed(outputs) or 'none'}; the contract wants {_WAYS}")
    wrong += _wrong_control(outputs[DOUBT]) if DOUBT in outputs else ()
    wrong += _wrong_state(inputs.get(STATE_IN), outputs.get(STATE_OUT))
    said = signature.metadata.get("trained_on_faults", "false")
    if said.lower() not in {"true", "false"}:
        wrong.append(f"metadata trained_on_faults: {_shown(said) or 'empty'}; write true or false")
    if wrong or track is None:
        raise ContractError(*wrong)
    state = inputs.get(STATE_IN)
    return ModelContract(
        track=track,
        inputs=observed,
        outputs=controls if state is None else (*controls, STATE_OUT),
        state_shape=None if state is None else (1, *_static(state.shape)),
        trained_on_faults=said.lower() == "true",
        rig=rig,
        doubts=DOUBT in outputs,
    )


def check_opset(opset: int) -> None:
    """Check the opset alone: onnxruntime does not load a model of an unknown one. Raises ContractError."""
    least, greatest = OPSETS
    if not least <= opset <= greatest:
        raise ContractError(f"opset: {opset}; export the model with one from {least} to {greatest}")


def _rig(metadata: Mapping[str, str]) -> tuple[Rig | None, str | None]:
    """Return the rig and the track that the metadata names; of a rig alone its own track. Raises ContractError."""
    said = metadata.get("track")
    try:
        rig = rig_of(metadata.get("rig"))
        if rig is not None and said in {None, *_TRACKS}:
            said = said or track_of(rig)
            sight_of(Track(said), rig)
    except RigError as error:
        raise ContractError(f"metadata {error}") from error
    return rig, said


def _track(
    inputs: tuple[str, ...],
    said: str | None,
    tracks: Collection[Track] | None,
    agent_track: Track | None,
    rig: Rig | None,
) -> Track:
    """Return the smallest track that has all inputs, or the one that the metadata names, if agent and suite take it."""
    if said is not None and said not in set(_TRACKS):
        raise ContractError(f"metadata track: {_shown(said)} is none of {', '.join(_TRACKS)}")
    if rig is not None:
        keys = [field.name for field in fields_of(rig)]
        if unknown := sorted(set(inputs) - set(keys)):
            raise ContractError(f"inputs: {_listed(unknown)}: not in the metadata's rig; it has {_listed(keys)}")
        fitting = [Track(said or "")]
    else:
        fitting = [track for track in _TRACKS if not _beyond(inputs, track)]
    if rig is None and (unknown := sorted(set(inputs) - _KEYS.keys())):
        raise ContractError(f"inputs: {_listed(unknown)}: no such observation key; the keys are {_keys_of_tracks()}")
    if not fitting:
        raise ContractError(f"inputs: no track has all of these; take the keys of one track: {_keys_of_tracks()}")
    track = fitting[0] if said is None else Track(said)
    if track not in fitting:
        raise ContractError(
            f"inputs: the metadata's track {track} does not have {_listed(_beyond(inputs, track))}; remove track from "
            f"the metadata, or let it be {' or '.join(fitting)}"
        )
    if agent_track is not None and track is not agent_track:
        wants, remedy = f"is of the {track} track", f"set the metadata's track to {agent_track}"
        if rig is None and (beyond := _beyond(inputs, agent_track)):
            wants, remedy = f"wants {_listed(beyond)}", "do without"
        raise ContractError(
            f"inputs: the agent is of the {agent_track} track, and the model {wants}; {remedy}, "
            "or hand it in with the owner's token by another name"
        )
    if agent_track is None and tracks is not None and track not in tracks:
        taken = [each for each in _TRACKS if each in tracks]
        remedy = f"take the keys of one of its tracks ({', '.join(taken)})"
        if both := [each for each in taken if each in fitting]:
            remedy = f"set the metadata's track to {' or '.join(both)}"
        raise ContractError(f"inputs: the suite does not take the model's track, {track}; {remedy}")
    return track


def _beyond(inputs: Iterable[str], track: Track) -> list[str]:
    """Return the inputs that a track does not have."""
    has = {field.name for field in FIELDS[track]}
    return [name for name in inputs if name not in has]


def _keys_of_tracks() -> str:
    """Return the keys of all tracks: those that all have, then what each adds."""
    common = [field.name for field in FIELDS[Track.STATE]]
    more = [f"{track}: {', '.join(_beyond([field.name for field in FIELDS[track]], Track.STATE))}" for track in _TRACKS]
    return f"{', '.join(common)}; also {'; '.join(more[1:])}"


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


def _wrong_waypoints(put: TensorSpec | None, count: int) -> Iterator[str]:
    """Yield what is wrong with an output that holds a trajectory."""
    wanted = _written(("N", count, 2))
    if put is None:
        yield f"outputs: there is no waypoints; the metadata's rig answers with waypoints, so give them as {wanted}"
        return
    if put.dtype not in _FLOATS:
        yield f"output {put.name}: is {_shown(put.dtype)}; let it be float32"
    if put.shape and not _fits(put.shape, (1, count, 2)):
        yield (
            f"output {put.name}: is {_written(put.shape)}; let it be {wanted}, one point for each of the rig's times "
            "and N a batch axis of 1 or free"
        )


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
        shown = _written(put.shape) if put.shape else "of free shape"
        if not put.shape or not _fits(put.shape[:1], (1,)):
            yield f"{kind} {put.name}: is {shown}; let it begin with a batch axis of 1, or a free one"
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
    return tuple(size for size in shape[1:] if isinstance(size, int))


def _fits(shape: Shape, wanted: tuple[int, ...]) -> bool:
    """Return whether an array of the wanted shape can go where this one is declared."""
    return len(shape) == len(wanted) and all(
        not isinstance(size, int) or size == want for size, want in zip(shape, wanted, strict=True)
    )


def _values(outputs: Mapping[str, NDArray[Any]], name: str) -> list[float]:
    """Return the numbers of an output of shape (1, 3) for an action, else (1, 1) or (1,). Raises ContractError."""
    values: list[float] = _checked(outputs, name, ((1, 3),) if name == ACTION else ((1, 1), (1,))).reshape(-1).tolist()
    return values


def _checked(outputs: Mapping[str, NDArray[Any]], name: str, shapes: Collection[Shape]) -> NDArray[np.float64]:
    """Return an output of one of some shapes, as float64. Raises ContractError."""
    given = np.asarray(_given(outputs, name))
    if given.dtype.name not in _FLOATS or given.shape not in shapes or not np.isfinite(given).all():
        shown = f"{given.tolist()}, " if given.size <= _LISTED else ""
        raise ContractError(
            f"output {name}: is {shown}{given.dtype} {_written(given.shape)}; "
            f"it must be finite and float32 {_written(next(iter(shapes)))}"
        )
    return given.astype(np.float64)


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
