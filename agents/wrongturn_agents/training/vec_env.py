"""Many cars for Stable-Baselines3, in this process or of a service."""

from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from wrongturn_client import RemoteVectorEnv
from wrongturn_protocol import OptionError
from wrongturn_protocol.trial_options import one_of
from wrongturn_sim import WrongturnVectorEnv


class WrongturnVecEnv(VecEnv):
    """A :class:`~wrongturn_sim.fleet.vector_env.WrongturnVectorEnv` as a ``VecEnv``; with ``url``, over the network.

    After an episode ends, the next one starts at once, as Stable-Baselines3 expects. ``infos[i]`` then has
    ``terminal_observation`` and ``TimeLimit.truncated``, the ended episode's ``verdict`` (and ``outcome`` in process),
    and the new episode's ``trial``.

    Args:
        num_envs: number of cars.
        options: options of the vectorised environment, such as ``town``, ``track``, ``fault``, ``weather``,
            ``threads``; with a service's ``url``, those of :class:`wrongturn_client.RemoteVectorEnv`.

    Raises:
        ValueError: an option does not exist, or does not fit the others.
    """

    def __init__(self, num_envs: int, **options: Any) -> None:
        mode = one_of("autoreset_mode", AutoresetMode, options.pop("autoreset_mode", AutoresetMode.SAME_STEP))
        if mode is not AutoresetMode.SAME_STEP:
            raise OptionError(f"autoreset_mode: is {mode.value}; Stable-Baselines3 needs SameStep, so leave it out")
        made = RemoteVectorEnv if "url" in options else WrongturnVectorEnv
        self.envs = made(num_envs, **options, autoreset_mode=mode)
        self._waiting: NDArray[Any] | None = None
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)

    def reset(self) -> VecEnvObs:
        """Start new episodes, with the ``seed`` and ``set_options`` given before."""
        options = [given for given in self._options if given]
        if options and any(given != options[0] for given in self._options):
            raise ValueError("options: differ between environments; give one for all of them")
        observation, infos = self.envs.reset(
            seed=None if all(seed is None for seed in self._seeds) else list(self._seeds),
            options=options[0] if options else None,
        )
        both = zip(infos["trial"], infos["town"], strict=True)
        self.reset_infos = [{"trial": trial, "town": town} for trial, town in both]
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for :meth:`step_wait`."""
        self._waiting = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Drive on for 0.1 s.

        Raises:
            InvalidActionError: a field is not a finite number in its range.
            RuntimeError: there are no actions.
        """
        observation, rewards, terminated, truncated, found = self.envs.step(self._take_actions())
        ended = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(ended).tolist():
            infos[i] = {
                "terminal_observation": found["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i]),
                **_of(found["final_info"], i),
                "trial": found["trial"][i],
                "town": found["town"][i],
            }
        return observation, rewards.astype(np.float32), ended, infos

    def _take_actions(self) -> NDArray[Any]:
        if self._waiting is None:
            raise RuntimeError("step_wait: there are no actions; call step_async first, or step")
        actions, self._waiting = self._waiting, None
        return actions

    def close(self) -> None:
        """Stop the threads."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the batch for each environment; a sequence with one value each is split."""
        value = getattr(self.envs, attr_name)
        shared = isinstance(value, tuple | np.ndarray) and len(value) == self.num_envs
        return [value[i] if shared else value for i in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refuse to set an attribute: single environments have none.

        Raises:
            NotImplementedError: always.
        """
        raise NotImplementedError(f"{attr_name}: cannot be set; make the environments with it")

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the batch that takes an environment's number, such as ``episode``, for each environment."""
        method = getattr(self.envs, method_name)
        return [method(i, *method_args, **method_kwargs) for i in self._chosen(indices)]

    def env_is_wrapped(
        self,
        wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]],  # noqa: ARG002
        indices: VecEnvIndices = None,
    ) -> list[bool]:
        """Return False for each environment: none is wrapped."""
        return [False for _ in self._chosen(indices)]

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return a picture of each environment; None for each unless ``render_mode`` is ``rgb_array``."""
        return (self.envs.render() if self.render_mode else None) or [None] * self.num_envs

    def _chosen(self, indices: VecEnvIndices) -> Iterable[int]:
        chosen: Iterable[int] = self._get_indices(indices)
        return chosen


def _of(infos: dict[str, Any], i: int) -> dict[str, Any]:
    """Return the infos of one environment."""
    return {name: infos[name][i] for name in infos if not name.startswith("_") and infos[f"_{name}"][i]}
