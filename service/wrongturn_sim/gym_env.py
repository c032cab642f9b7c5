"""The Gymnasium environment in process: ``gymnasium.make("wrongturn_sim:WrongturnSim-v0", town=..., track=...)``."""

from typing import TYPE_CHECKING, Any, SupportsFloat, Unpack

import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol import ActionLike, Rig, Track, TrialKeywords, TrialOptions
from wrongturn_protocol.actions import three_numbers
from wrongturn_protocol.environments import TrialEnv
from wrongturn_protocol.observations import Observation, observation_space
from wrongturn_protocol.rigs import rig_of, sight_of
from wrongturn_protocol.trial_options import check_keywords, check_options
from wrongturn_sim.episode import Episode
from wrongturn_sim.errors import EpisodeNotStartedError, InvalidActionError
from wrongturn_sim.simulator_process import EnvironmentSimulator
from wrongturn_sim.trial_source import TrialSource, a_flag, picture_size

if TYPE_CHECKING:
    from wrongturn_sim.camera import Camera


class WrongturnSimEnv(TrialEnv):
    """Drive trials in this process. It can have any number of these environments.

    A car that drives alone needs no SUMO. With ``traffic``, the second environment of a process and each further one
    start a process for their SUMO at their first reset; it ends with them. All give the same bytes.

    Each reset draws a new trial from the environment's random generator; ``reset(seed=...)`` seeds it. To choose the
    trial, pass ``trial`` here, or ``options={"trial": ...}`` to ``reset``. ``info`` names the trial, and at the end
    holds ``verdict`` and ``outcome``.

    Args:
        town: town in which trials are drawn; ``Town01`` by default.
        track: decides what observations show.
        strict: for training: a journey ends when the car leaves its road or lane, or stands.
        render_mode: ``rgb_array``, to get pictures from ``render``; ``human``, to watch them in a window, which needs
            pygame (the extra ``wrongturn-client[human]``).
        camera: camera of observations and of ``render``; the benchmark's by default.
        rig: cameras, navigation inputs and rate instead of the track's. Actions stay controls.
        options: ``approach``, ``fault``, ``task``, ``suite`` and so on; see :class:`~wrongturn_protocol.TrialOptions`.

    Raises:
        ValueError: a name does not exist, or two options exclude each other.
    """

    def __init__(
        self,
        town: str | None = None,
        track: Track | str = Track.STATE,
        *,
        strict: bool = False,
        render_mode: str | None = None,
        camera: "Camera | None" = None,
        rig: Rig | None = None,
        **options: Unpack[TrialKeywords],
    ) -> None:
        check_keywords(WrongturnSimEnv, options)
        trials = TrialOptions.of(town, track, **options)
        self._prepare(trials.track, render_mode, picture_size(camera))
        self._sight = sight_of(self.track, rig_of(rig))
        if rig is not None:
            self.observation_space = observation_space(self._sight)  # type: ignore[assignment]
        self._source = TrialSource(trials)
        self.strict = a_flag("strict", strict)
        self._camera = camera
        self._simulator = EnvironmentSimulator()
        self.episode: Episode | None = None
        """The last episode, with its trajectory; None before the first reset."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin a trial: ``options["trial"]`` (a Trial, or an id of the suite), else a drawn one. Raises SimError."""
        super().reset(seed=seed)
        given = check_options(options, ("trial",)).get("trial")
        trial = self._source.draw(self.np_random) if given is None else self._source.find(given)
        self.episode = Episode(trial, self._sight, simulator=self._simulator, camera=self._camera, strict=self.strict)
        observation = self.episode.reset()
        self._watch()
        return observation, {"trial": trial.id, "town": trial.town}

    def step(self, action: ActionLike) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Drive for 0.1 s by steer, throttle, brake: an array (3,), a tuple, a list or an Action. Raises SimError."""
        if self.episode is None:
            raise EpisodeNotStartedError("step before the first reset; call reset")
        controls = three_numbers(action, InvalidActionError)
        observation, reward, terminated, truncated = self.episode.step(*controls)
        self._watch()
        info: dict[str, Any] = {}
        if self.episode.outcome is not None:
            info["verdict"] = str(self.episode.outcome.verdict)
            # Gymnasium's vector environments make arrays of the numbers, so None must not be among them.
            info["outcome"] = self.episode.outcome.model_dump(mode="json", exclude_none=True)
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """End the process of SUMO and close the window, if there are any; ``reset`` begins anew."""
        self._simulator.close()
        super().close()

    def _picture(self) -> NDArray[np.uint8]:
        if self.episode is None:
            raise EpisodeNotStartedError("render before the first reset; call reset")
        return self.episode.view(camera=self._camera)
