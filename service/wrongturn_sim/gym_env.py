"""The Gymnasium environment in process: ``gymnasium.make("wrongturn_sim:WrongturnSim-v0", town=..., track=...)``."""

from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import NetworkError, draw_trial, load_suite, load_town
from wrongturn_protocol import Fault, FaultKind, Track, Trial, Weather
from wrongturn_protocol.observations import Observation, action_space, observation_space
from wrongturn_sim.episode import Episode
from wrongturn_sim.errors import EpisodeNotStartedError, InvalidActionError
from wrongturn_sim.faults import FaultNotApplicableError, make_fault
from wrongturn_sim.observation import check_track
from wrongturn_sim.simulator import Simulator

_SEEDS = 2**31


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
        weather: of the drawn trials.
        render_mode: None, since there are no pictures yet.

    Raises:
        ValueError: names that do not exist, or do not go together.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        town: str | None = None,
        track: Track | str = Track.STATE,
        *,
        approach: str | None = None,
        fault: Fault | FaultKind | str = FaultKind.NONE,
        suite: str | None = None,
        trial: Trial | str | None = None,
        weather: Weather | str = Weather.CLEAR_NOON,
        render_mode: str | None = None,
    ) -> None:
        self.track = Track(track)
        check_track(self.track)
        if render_mode is not None:
            raise ValueError(f"render_mode: {render_mode!r} is not there yet; leave it None")
        if suite is not None and (town is not None or approach is not None):
            raise ValueError("suite: its trials name their towns; leave town and approach out")
        if isinstance(trial, str) and suite is None:
            raise ValueError(f"trial: the id {trial!r} needs the suite that it stands in; give suite, or a Trial")
        if suite is None and town is None and trial is None:
            raise ValueError("town: missing; name a town, or a suite, or give a trial")
        self.render_mode = None
        self.observation_space = observation_space(self.track)  # type: ignore[assignment]
        self.action_space = action_space()  # type: ignore[assignment]
        self._suite = None if suite is None else load_suite(suite)
        self._fault = fault if isinstance(fault, Fault) else Fault(kind=FaultKind(fault))
        self._weather = Weather(weather)
        self._town = None if town is None else load_town(town)
        self._trial = None if trial is None else self._find(trial)
        self._approaches: tuple[str, ...] = ()
        if self._town is not None:
            names = sorted(self._town.approaches) if approach is None else [approach]
            self._approaches = tuple(name for name in names if self._admits(name, among=len(names)))
            if not self._approaches:
                raise FaultNotApplicableError(
                    f"fault: {self._fault.kind} suits no approach of {town}; take another fault or another town",
                )
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
        trial = self._next() if given is None else self._find(given)
        self.episode = Episode(trial, self.track, simulator=self._simulator)
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
            info["outcome"] = self.episode.outcome.model_dump(mode="json")
        return observation, reward, terminated, truncated, info

    def _find(self, trial: Trial | str) -> Trial:
        if isinstance(trial, Trial):
            return trial
        if self._suite is None:
            raise ValueError(f"trial: the id {trial!r} needs an environment that was made with its suite")
        return self._suite.trial(trial)

    def _admits(self, approach: str, *, among: int) -> bool:
        """Whether trials of the fault can be drawn at an approach; the reason why not, where it is the only one."""
        try:
            make_fault(self._draw(approach, 0))
        except NetworkError:
            if among == 1:
                raise
            return False
        return True

    def _draw(self, approach: str, seed: int) -> Trial:
        assert self._town is not None
        return draw_trial(self._town, approach, self._fault, seed, weather=self._weather)

    def _next(self) -> Trial:
        if self._trial is not None:
            return self._trial
        if self._suite is not None:
            episodes = self._suite.episodes
            return episodes[int(self.np_random.integers(len(episodes)))]
        approach = self._approaches[int(self.np_random.integers(len(self._approaches)))]
        return self._draw(approach, int(self.np_random.integers(_SEEDS)))
