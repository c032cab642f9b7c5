"""The Gymnasium environment in process: ``gymnasium.make("wrongturn_sim:WrongturnSim-v0", town=..., track=...)``."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium
import numpy as np
from numpy.typing import NDArray

from wrongturn_protocol import Fault, FaultKind, Task, Track, Traffic, Trial, Weather
from wrongturn_protocol.observations import IMAGE_SHAPE, Observation, action_space, observation_space
from wrongturn_sim.episode import Episode
from wrongturn_sim.errors import EpisodeNotStartedError, InvalidActionError
from wrongturn_sim.simulator import Simulator
from wrongturn_sim.trial_source import TrialSource, a_flag

if TYPE_CHECKING:
    from wrongturn_sim.camera import Camera


class WrongturnSimEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Drive trials in this process; there is one simulation to a process.

    Each reset draws a new trial from the environment's own generator (``reset(seed=...)`` sets it), unless one is
    given: for good by ``trial``, or for this reset by ``options={"trial": ...}``. ``info`` names the trial, and at the
    end holds ``verdict`` and ``outcome``.

    Args:
        town: where trials are drawn.
        track: what is shown.
        approach: the arm that all drawn trials drive in by; any that admits the fault where it is None.
        fault: of the drawn trials.
        suite: draw among this suite's trials and twins instead.
        trial: this trial each time; an id needs ``suite`` too.
        weather: of the drawn trials; of several, each trial draws its own.
        traffic: of the drawn trials, as ``{"vehicles": 20, "pedestrians": 10}``.
        task: draw journeys of this task (``cruise``, or one of CoRL 2017's), instead of single junctions.
        journeys: further arguments of :func:`wrongturn_networks.draw_cruise`, such as ``{"near_junctions": 0.4}``.
        strict: a journey ends where the car leaves its road or lane, or stands; for training.
        render_mode: ``rgb_array`` for pictures by ``render``, whatever the track shows.
        camera: of the tracks that have one, and of ``render``; the benchmark's own by default.

    Raises:
        ValueError: names that do not exist, or do not go together.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        town: str | None = None,
        track: Track | str = Track.STATE,
        *,
        approach: str | None = None,
        fault: Fault | FaultKind | str = FaultKind.NONE,
        suite: str | None = None,
        trial: Trial | str | None = None,
        weather: Weather | str | Sequence[Weather | str] = Weather.CLEAR_NOON,
        traffic: Traffic | Mapping[str, int] = Traffic(),  # noqa: B008 - immutable
        task: Task | str | None = None,
        journeys: Mapping[str, Any] | None = None,
        strict: bool = False,
        render_mode: str | None = None,
        camera: "Camera | None" = None,
    ) -> None:
        self.track = Track(track)
        if render_mode not in {None, "rgb_array"}:
            raise ValueError(f"render_mode: {render_mode!r} is not known; take rgb_array, or leave it None")
        self._source = TrialSource(
            town,
            approach=approach,
            fault=fault,
            suite=suite,
            trial=trial,
            weather=weather,
            traffic=traffic,
            task=task,
            journeys=journeys,
        )
        self.strict = a_flag("strict", strict)
        self.render_mode = render_mode
        self._camera = camera
        size = IMAGE_SHAPE if camera is None else (camera.height, camera.width)
        self.observation_space = observation_space(self.track, size)  # type: ignore[assignment]
        self.action_space = action_space()  # type: ignore[assignment]
        self._simulator = Simulator()
        self.episode: Episode | None = None
        """The one that was begun last, with its trajectory."""

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin a trial: the one in ``options["trial"]`` (a Trial, or an id of the suite), else the next.

        Raises:
            SimError: as :class:`~wrongturn_sim.episode.Episode`.
        """
        super().reset(seed=seed)
        given = (options or {}).get("trial")
        trial = self._source.draw(self.np_random) if given is None else self._source.find(given)
        self.episode = Episode(trial, self.track, simulator=self._simulator, camera=self._camera, strict=self.strict)
        return self.episode.reset(), {"trial": trial.id, "town": trial.town}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Drive on for 0.1 s.

        Args:
            action: float32 (3,): steer, throttle, brake.

        Raises:
            SimError: as :meth:`wrongturn_sim.episode.Episode.step`.
        """
        if self.episode is None:
            raise EpisodeNotStartedError("step before the first reset; call reset")
        try:
            steer, throttle, brake = np.asarray(action, np.float64).tolist()
        except (TypeError, ValueError):
            raise InvalidActionError(f"action: {action!r} is not three numbers; give steer, throttle, brake") from None
        observation, reward, terminated, truncated = self.episode.step(steer, throttle, brake)
        info: dict[str, Any] = {}
        if self.episode.outcome is not None:
            info["verdict"] = str(self.episode.outcome.verdict)
            # Without what is None: Gymnasium's vector environments make arrays of the numbers.
            info["outcome"] = self.episode.outcome.model_dump(mode="json", exclude_none=True)
        return observation, reward, terminated, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """What is seen now, uint8 (height, width, 3); None where ``render_mode`` is.

        Raises:
            EpisodeNotStartedError: call ``reset`` first.
        """
        if self.render_mode is None:
            return None
        if self.episode is None:
            raise EpisodeNotStartedError("render before the first reset; call reset")
        return self.episode.picture(self._camera)
