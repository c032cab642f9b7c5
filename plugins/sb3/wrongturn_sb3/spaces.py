"""What a policy of Stable-Baselines3 takes, made from an observation, and what its actions mean."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecNormalize

from wrongturn_agents.training.action import ACTION_SPACE, controls
from wrongturn_agents.training.errors import TrainingError
from wrongturn_protocol import Track
from wrongturn_protocol.model_contract import CONTROLS
from wrongturn_protocol.observations import FIELDS, Field, Observation, action_space, in_short, observation_space
from wrongturn_sb3.policy import load_policy, load_statistics

_TRACKS: Final = (Track.STATE, Track.CAMERA, Track.SEGMENTATION, Track.PRIVILEGED)  # smaller tracks first
_CHANNELS_FIRST: Final = (2, 0, 1)
_TABLE = "a JSON list with [steer, accelerate] or [steer, throttle, brake] for each action, such as [[0, 0.5], [0, -1]]"


@dataclass(frozen=True)
class Scaling:
    """Statistics of one key, as ``VecNormalize`` applies them."""

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    clip: float
    """Greatest scaled value."""


@dataclass(frozen=True)
class Taken:
    """One key that a policy takes."""

    field: Field
    transposed: bool
    """Whether the policy takes a picture's channels first."""
    scaling: Scaling | None
    """Its normalisation; None for none."""

    @property
    def scaled_first(self) -> bool:
        """Whether the normalisation comes before the transposition, as when Stable-Baselines3 adds the latter."""
        return self.scaling is not None and self.scaling.mean.shape == self.field.shape


class DrivingPolicy:
    """A saved policy with what it takes, and what its actions mean. Making it runs code that its files name.

    Args:
        file: what ``model.save`` wrote.
        vecnormalize: what ``VecNormalize.save`` wrote, if training normalised observations.
        actions: JSON file with the controls of each discrete action.
    """

    def __init__(self, file: Path, vecnormalize: Path | None = None, actions: Path | None = None) -> None:
        self.policy, self.algorithm, last = load_policy(file)
        space = self.policy.observation_space
        self.takes_one = not isinstance(space, spaces.Dict)
        """Whether it takes the array of one key, as behind a wrapper that shows the picture alone."""
        self.statistics = None if vecnormalize is None else load_statistics(vecnormalize)
        seen = _by_key(space)
        self.track = _track(tuple(seen))
        fields = [field for field in FIELDS[self.track] if field.name in seen]
        self.keys = tuple(_taken(field, seen[field.name], self.statistics, alone=self.takes_one) for field in fields)
        if self.statistics is None:
            _check_scale(last, seen)
        self.meaning = meaning_of(self.policy.action_space, actions)

    def controls(self, observation: Observation) -> NDArray[np.float32]:
        """Return steer, throttle and brake, (3,), as training's wrappers and the policy itself make them."""
        given = {key.field.name: observation[key.field.name] for key in self.keys}
        self._transpose(given, scaled=False)
        if self.statistics is not None:
            if self.takes_one:
                given = {name: self.statistics.normalize_obs(array) for name, array in given.items()}
            else:
                given = self.statistics.normalize_obs(given)
        self._transpose(given, scaled=True)
        action, _ = self.policy.predict(next(iter(given.values())) if self.takes_one else given, deterministic=True)
        return self.meaning.controls(action)

    def _transpose(self, given: dict[str, NDArray[Any]], *, scaled: bool) -> None:
        """Put channels first, of the pictures for which that comes after their normalisation, or of the others."""
        for key in self.keys:
            if key.transposed and key.scaled_first is scaled:
                given[key.field.name] = given[key.field.name].transpose(_CHANNELS_FIRST)


def _by_key(space: spaces.Space[Any]) -> dict[str, spaces.Space[Any]]:
    """Return the space of each key that a policy takes. One array is a key's if it has its type and shape."""
    if isinstance(space, spaces.Dict):
        return dict(space.spaces)
    fields = {field.name: field for track in _TRACKS for field in FIELDS[track]}
    shape = tuple(space.shape or ())
    found = [field for field in fields.values() if shape in {field.shape, _first(field)}]
    if len(found) > 1:  # all the keys that are single numbers
        found = [field for field in found if space == spaces.Box(field.low, field.high, shape, field.numpy_dtype.type)]
    if len(found) != 1:
        flat = _flat(shape)
        if flat is not None:
            raise TrainingError(
                f"observation space: it was trained on {shape[0]} numbers ({flat}); drive it with WrappedAgent, see "
                "docs/wrappers.md"
            )
        raise TrainingError(
            f"observation space: {in_short(space)} is not one of ours; train on an environment of Wrongturn "
            "without wrappers that change the observation: a MultiInputPolicy, or another policy on one key, such as "
            "the picture"
        )
    return {found[0].name: space}


def _flat(shape: tuple[int, ...]) -> str | None:
    """Return the wrappers that make one vector of this shape from our observations; None if none do."""
    sizes = {track: spaces.flatdim(observation_space(track)) for track in _TRACKS}
    flat: dict[tuple[int, ...], str] = {(size,): "FlattenObservation" for size in sizes.values()}
    pose = spaces.flatdim(observation_space(Track.PRIVILEGED)["pose"])  # CarFrame leaves it out
    flat[(sizes[Track.PRIVILEGED] - pose,)] = "CarFrame and FlattenObservation"
    return flat.get(shape)


def _track(names: tuple[str, ...]) -> Track:
    """Return the smallest track with all keys."""
    for track in _TRACKS:
        if set(names) <= {field.name for field in FIELDS[track]}:
            return track
    known = {field.name for track in _TRACKS for field in FIELDS[track]}
    unknown = [name for name in names if name not in known]
    reason = f"{', '.join(unknown)}: no such observation key" if unknown else "no track has all of these keys"
    raise TrainingError(f"observation space: {reason}; train on an environment of one track, without wrappers")


def _taken(field: Field, space: spaces.Space[Any], statistics: VecNormalize | None, *, alone: bool) -> Taken:
    shape = tuple(space.shape or ())
    transposed = shape == _first(field)
    if not transposed and shape != field.shape:
        raise TrainingError(_wrong_shape(field, shape))
    scaling = _scaling(field, shape, statistics, alone=alone)
    ours = spaces.Box(field.low, field.high, shape, field.numpy_dtype.type)
    if space != ours and scaling is None:
        remedy = "give --vecnormalize, or " if space.dtype == np.float32 else ""
        raise TrainingError(
            f"observation space: {field.name} is {in_short(space)}, and the service shows {in_short(ours)}: "
            f"a wrapper changed it; {remedy}train without the wrapper, and put what it does into a features extractor"
        )
    return Taken(field, transposed, scaling)


def _wrong_shape(field: Field, shape: tuple[int, ...]) -> str:
    size, whole = math.prod(field.shape), math.prod(shape)
    if whole > size and whole % size == 0:
        return (
            f"observation space: {field.name} is {shape}, {whole // size} frames stacked; a model is shown one "
            "observation at a time: train without stacking, or write a network with a memory (docs/models.md)"
        )
    return (
        f"observation space: {field.name} is {shape}, and the service shows {field.shape}; train without the wrapper "
        "that changes it"
    )


def _scaling(field: Field, shape: tuple[int, ...], statistics: VecNormalize | None, *, alone: bool) -> Scaling | None:
    if statistics is None or not statistics.norm_obs:
        return None
    names = statistics.norm_obs_keys
    if isinstance(statistics.obs_rms, dict) == alone:
        wanted = "one array" if alone else "a Dict of observations"
        raise TrainingError(f"--vecnormalize: its statistics are not of {wanted}; name this policy's file")
    if not alone and field.name not in (names or ()):
        return None
    found = statistics.obs_rms if alone else statistics.obs_rms[field.name]
    if found.mean.shape not in {field.shape, shape}:
        raise TrainingError(
            f"--vecnormalize: its {field.name} is {found.mean.shape}, and the policy's is {shape}; name this policy's"
        )
    return Scaling(found.mean, np.sqrt(found.var + statistics.epsilon), float(statistics.clip_obs))


def _check_scale(last: Any, seen: Mapping[str, spaces.Space[Any]]) -> None:
    """Check by the observations that training saw last, if they are known, that no statistics are missing."""
    for name, space in seen.items() if last is not None else ():
        rows = np.asarray(last.get(name, np.empty(0, space.dtype)) if isinstance(last, Mapping) else last)
        if rows.dtype != space.dtype or not all(space.contains(row) for row in rows):
            raise TrainingError(
                f"--vecnormalize: is missing: training saw values of {name} that the environment does not have, so "
                "that VecNormalize scaled them; save its statistics (VecNormalize.save) and name the file"
            )


def _first(field: Field) -> tuple[int, ...] | None:
    """Return the shape of a picture with its channels first; None if the key is no picture with channels."""
    if not field.image or len(field.shape) != len(_CHANNELS_FIRST):
        return None
    return tuple(field.shape[axis] for axis in _CHANNELS_FIRST)


@dataclass(frozen=True)
class Meaning:
    """How a policy's actions become controls."""

    outputs: tuple[str, ...]
    """Names of the controls, as the contract of a model has them."""
    table: NDArray[np.float32] | None = None
    """(n, 2) or (n, 3): controls of each discrete action; None if an action is the controls."""

    def controls(self, action: NDArray[Any]) -> NDArray[np.float32]:
        """Return steer, throttle and brake, (3,), of an action from ``predict``."""
        given = action if self.table is None else self.table[int(action)]
        return controls(given) if len(self.outputs) == 2 else np.asarray(given, np.float32)


def meaning_of(space: spaces.Space[Any], file: Path | None) -> Meaning:
    """Return what the actions of a space mean: one of our environments', or discrete with a file of controls."""
    if isinstance(space, spaces.Discrete):
        if file is None:
            raise TrainingError(f"--actions: is missing: the policy has {space.n} discrete actions; name {_TABLE}")
        table = _table(file, int(space.n))
        return Meaning(CONTROLS[table.shape[1] - 2], table)
    if file is not None:
        raise TrainingError(f"--actions: is for discrete actions, and the policy's are {in_short(space)}; leave it out")
    for ours, outputs in ((ACTION_SPACE, CONTROLS[0]), (action_space(), CONTROLS[1])):
        if space == ours:
            return Meaning(outputs)
    raise TrainingError(
        f"action space: {in_short(space)} is none of ours; train with {action_space()} (steer, throttle, brake), with "
        f"{ACTION_SPACE} (steer, accelerate), or with discrete actions and --actions"
    )


def _table(file: Path, number: int) -> NDArray[np.float32]:
    """Return the controls of each discrete action."""
    try:
        rows = np.array(json.loads(file.read_text("utf-8")), np.float32)
    except OSError as error:
        raise TrainingError(f"--actions: {file} cannot be read ({error.strerror}); name another") from error
    except (ValueError, TypeError) as error:
        raise TrainingError(f"--actions: {file} is not as it should be ({error}); name {_TABLE}") from error
    if rows.ndim != 2 or rows.shape[0] != number or rows.shape[1] not in {2, 3}:
        raise TrainingError(f"--actions: {file} has shape {rows.shape}, and the policy {number} actions; name {_TABLE}")
    limits = ACTION_SPACE if rows.shape[1] == 2 else action_space()
    for row in rows:
        if not limits.contains(row):
            raise TrainingError(
                f"--actions: {row.tolist()} is out of range; steer and accelerate go from -1 to 1, "
                "throttle and brake from 0 to 1"
            )
    return rows
