"""Reading what Stable-Baselines3 saved: a policy, and the statistics of ``VecNormalize``.

Both files are pickles inside: loading one runs code that it names.
"""

import json
import pickle
import sys
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.dqn.policies import DQNPolicy
from stable_baselines3.sac.policies import SACPolicy
from stable_baselines3.td3.policies import TD3Policy

from wrongturn_agents.errors import why_no_file
from wrongturn_agents.training.errors import TrainingError

ALGORITHMS: Final = "PPO, A2C, SAC, TD3, DDPG and DQN"
"""Algorithms whose policies can be exported and run."""
_NEEDED: Final = ("policy_class", "policy_kwargs", "observation_space", "action_space", "use_sde")
_WANTED: Final = f"name what model.save wrote; policies of {ALGORITHMS} are supported"


def check_files(file: Path, statistics: Path | None) -> None:
    """Check that a model's file is one, and that statistics can be read, without loading either."""
    _keys(file)
    if statistics is not None:
        try:
            statistics.open("rb").close()
        except OSError as error:
            raise _unreadable(statistics, error) from error


def load_policy(file: Path) -> tuple[BasePolicy, str, Any]:
    """Load the policy of a zip file. This runs code that the file names.

    Returns:
        policy: ready to act.
        algorithm: such as ``PPO``.
        last: the observations that training saw last, with a batch axis, an array or by key; None if it has none.
    """
    keys = _keys(file)
    data, weights = _load(file, keys)
    policy_class = data["policy_class"]
    options = {name: value for name, value in (data["policy_kwargs"] or {}).items() if name != "device"}
    algorithm = _algorithm(file, policy_class, keys, options)
    if issubclass(policy_class, ActorCriticPolicy):
        options["use_sde"] = bool(data.get("use_sde"))
    try:
        policy = policy_class(data["observation_space"], data["action_space"], lambda _: 0.0, **options)
        policy.load_state_dict(weights)
    except Exception as error:  # the user's classes may raise anything
        raise TrainingError(f"{file}: its policy cannot be made again: {_told(error)}") from error
    for name, tensor in policy.state_dict().items():
        if not tensor.isfinite().all():
            raise TrainingError(f"{file}: {name}: is not finite, so that it cannot drive; name an earlier one")
    policy.set_training_mode(False)
    return policy, algorithm, data.get("_last_obs")


def load_statistics(file: Path) -> VecNormalize:
    """Load what ``VecNormalize.save`` wrote. This runs code that the file names."""
    try:
        with file.open("rb") as opened:
            found = pickle.load(opened)  # noqa: S301 - the user is warned
    except OSError as error:
        raise _unreadable(file, error) from error
    except Exception as error:  # a pickle may raise anything
        raise TrainingError(
            f"--vecnormalize: {file} is not what VecNormalize.save wrote ({_told(error)}); name another"
        ) from error
    if not isinstance(found, VecNormalize):
        raise TrainingError(f"--vecnormalize: {file} holds a {type(found).__name__}; name what VecNormalize.save wrote")
    return found


def _unreadable(file: Path, error: OSError) -> TrainingError:
    return TrainingError(f"--vecnormalize: {file} cannot be read ({error.strerror}); name another")


def _keys(file: Path) -> tuple[str, ...]:
    """Return the names of all that a model's file holds, without loading any of it."""
    if not file.is_file():
        raise TrainingError(f"FILE: {file}: {why_no_file(file)}; {_WANTED}")
    try:
        with zipfile.ZipFile(file) as archive:
            if not {"data", "policy.pth"} <= set(archive.namelist()):
                raise TrainingError(f"FILE: {file} is a zip file of something else, or a damaged one; {_WANTED}")
            return tuple(json.loads(archive.read("data")))
    except (zipfile.BadZipFile, ValueError) as error:
        if isinstance(error, TrainingError):
            raise
        raise TrainingError(f"FILE: {file} is no zip file, or a damaged one ({error}); {_WANTED}") from error
    except OSError as error:
        raise TrainingError(f"FILE: {file} cannot be read ({error.strerror}); {_WANTED}") from error


def _load(file: Path, keys: tuple[str, ...]) -> tuple[dict[str, Any], Any]:
    """Return the entries that a policy needs, and its weights."""
    if "" not in sys.path:
        sys.path.insert(0, "")  # so that modules in the working directory are found, as with python -m
    # Schedules, callbacks and such are left out: they may need what is not there any more.
    unneeded = {key: None for key in keys if key not in (*_NEEDED, "_last_obs")}
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            data, parameters, _ = load_from_zip_file(file, device="cpu", custom_objects=unneeded)
    except ImportError as error:
        raise TrainingError(
            f"{file}: it needs the module {error.name}, which cannot be imported ({error}); start in the folder of "
            "your module, or name its folder in PYTHONPATH"
        ) from error
    except Exception as error:  # a pickle may raise anything
        raise TrainingError(f"{file}: it cannot be loaded: {_told(error)}") from error
    missing = [key for key in _NEEDED[:4] if key not in (data or {})]
    if data is None or missing:
        said = next((str(each.message) for each in caught if missing[0] in str(each.message)), "it is not there")
        raise TrainingError(f"{file}: its {missing[0]} cannot be loaded: {said.splitlines()[-1]}")
    return data, parameters["policy"]


def _algorithm(file: Path, policy_class: type, keys: tuple[str, ...], options: Mapping[str, Any]) -> str:
    """Return the algorithm that made a file: by its policy, and by settings that only one algorithm has."""
    supported = isinstance(policy_class, type) and not policy_class.__module__.startswith("sb3_contrib")
    if supported and issubclass(policy_class, ActorCriticPolicy):
        return "PPO" if "clip_range" in keys else "A2C"
    td3 = "DDPG" if options.get("n_critics") == 1 else "TD3"  # Stable-Baselines3 makes DDPG of it
    for kind, name in ((SACPolicy, "SAC"), (TD3Policy, td3), (DQNPolicy, "DQN")):
        if supported and issubclass(policy_class, kind):
            return name
    raise TrainingError(
        f"{file}: its policy is a {getattr(policy_class, '__name__', policy_class)}; the policies of {ALGORITHMS} are "
        "supported; write another as docs/models.md shows for plain torch"
    )


def _told(error: Exception) -> str:
    """Return an error in one line."""
    return f"{type(error).__name__}: {error}".splitlines()[0]
