"""What the environments in process and over the wire share: arguments, spaces, generators, ends and pictures."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Final

import gymnasium
import numpy as np
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from wrongturn_protocol.episodes import CONTROLS
from wrongturn_protocol.installing import install
from wrongturn_protocol.observations import IMAGE_SHAPE, Observation, action_space, observation_space
from wrongturn_protocol.suggestions import did_you_mean
from wrongturn_protocol.trial_options import OptionError, check_options, one_of, whole_number
from wrongturn_protocol.vocabulary import Track

Flags = NDArray[np.bool_]
RENDER_MODES: Final = ("human", "rgb_array")
VECTOR_RENDER_MODES: Final = ("rgb_array",)
"""Render modes of the vector environments, which have no window."""
FRAMES_A_SECOND: Final = 10
"""Pictures a second of an environment that is watched: a decision takes 0.1 s."""


class TrialEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Base of the environments that drive one trial at a time."""

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": FRAMES_A_SECOND}  # noqa: RUF012

    def _prepare(self, track: Track, render_mode: str | None, size: tuple[int, int] = IMAGE_SHAPE) -> None:
        """Set the spaces, and open no window yet. ``size`` is rows and columns of a picture."""
        _check_render_mode(render_mode)
        self.track = track
        self.render_mode = render_mode
        self._screen = _Screen() if render_mode == "human" else None
        self.observation_space = observation_space(track, size)  # type: ignore[assignment]
        self.action_space = action_space()  # type: ignore[assignment]

    def render(self) -> NDArray[np.uint8] | None:
        """Return the view from above beside the camera's, uint8 (480, 864, 3); None unless ``rgb_array`` was asked for.

        It shows the route and the other road users, which agents may not see. Before the first reset it raises what
        ``step`` raises then.
        """
        return self._picture() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the window. Safe to call more than once."""
        if self._screen is not None:
            self._screen.close()

    def _watch(self) -> None:
        """Show the moment in the window, if there is one."""
        if self._screen is not None:
            self._screen.show(self._picture())

    @abstractmethod
    def _picture(self) -> NDArray[np.uint8]:
        """Draw the moment; raise an error if no episode has begun."""


class TrialVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Base of the environments that drive many trials at once, each with its own generator and its own end.

    After ``reset(seed=s)``, environment ``i`` drives the same trials as a single environment after
    ``reset(seed=s + i)``.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": list(VECTOR_RENDER_MODES),
        "render_fps": FRAMES_A_SECOND,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    _NOT_BEGUN: ClassVar[type[Exception]]
    """What ``step`` and ``render`` raise before the first reset."""
    _ENDED: ClassVar[type[Exception]]
    """What ``step`` raises for environments that ended, in the mode ``Disabled``."""
    _BAD_ACTION: ClassVar[type[Exception]]

    def _prepare(
        self,
        num_envs: int,
        track: Track,
        autoreset_mode: AutoresetMode | str,
        render_mode: str | None,
        size: tuple[int, int] = IMAGE_SHAPE,
    ) -> None:
        """Set the spaces and begin nothing. ``size`` is rows and columns of a picture. Raises OptionError."""
        _check_render_mode(render_mode, VECTOR_RENDER_MODES)
        self.num_envs = count = whole_number("num_envs", num_envs)
        self.track = track
        self.render_mode = render_mode
        self.autoreset_mode = one_of("autoreset_mode", AutoresetMode, autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space = observation_space(track, size)
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, count)
        self.action_space = batch_space(self.single_action_space, count)
        self._randoms: list[np.random.Generator] = []
        self._begun = np.zeros(count, np.bool_)
        self._over = np.zeros(count, np.bool_)

    def _asked(
        self, seed: int | Sequence[int | None] | None, options: dict[str, Any] | None, single: type | tuple[type, ...]
    ) -> dict[int, Any]:
        """Return the environments to reset, each with its trial (of a ``single`` type) or None; seed generators.

        Of one seed, each next environment gets 1 more. Of one trial, all get it.
        """
        count, known = self.num_envs, check_options(options, ("trial", "reset_mask"))
        seeds = [None if seed is None else seed + i for i in range(count)] if not isinstance(seed, Sequence) else seed
        trials = known.get("trial")
        if trials is None or isinstance(trials, single):
            trials = [trials] * count
        elif not isinstance(trials, Sequence):
            raise OptionError(f"options.trial: is {trials!r}; give one trial, or one for each environment")
        for name, given in (("seed", seeds), ("options.trial", trials)):
            if len(given) != count:
                raise OptionError(f"{name}: has {len(given)} entries; give one for each of {count} environments")
        mask = np.asarray(known.get("reset_mask", np.ones(count, np.bool_)))
        if mask.shape != (count,) or mask.dtype != np.bool_ or not mask.any():
            raise OptionError(f"options.reset_mask: give ({count},) of bool, one of them True at least")
        self._randoms = self._randoms or [seeding.np_random(one)[0] for one in seeds]
        chosen: list[int] = np.flatnonzero(mask).tolist()
        for i in chosen:
            if seeds[i] is not None:
                self._randoms[i], _ = seeding.np_random(seeds[i])
        return {i: trials[i] for i in chosen}

    def _driven(self, actions: Any) -> tuple[NDArray[np.float64], Flags]:
        """Return the checked actions and which environments they drive, (n,); the others begin their next episode."""
        if not self._begun.all():
            raise self._NOT_BEGUN("there is no trial to drive; call reset")
        begins_now = self.autoreset_mode is AutoresetMode.NEXT_STEP
        driven = ~self._over if begins_now else np.ones_like(self._over)
        if (self._over & driven).any():
            raise self._ENDED(
                f"environments {np.flatnonzero(self._over).tolist()} ended; reset them with options reset_mask"
            )
        return self._checked(actions, driven), driven

    def _checked(self, actions: Any, driven: Flags) -> NDArray[np.float64]:
        """Return the actions as float64 (n, 3); rows that are not driven are not checked."""
        count, error = self.num_envs, self._BAD_ACTION
        wanted = f"actions: give ({count}, 3) numbers, steer, throttle and brake of each environment"
        try:
            kind = np.asarray(actions).dtype
            # Converted from what was given: an Action is float32 unless float64 is asked for, and would lose digits.
            given = np.asarray(actions, np.float64) if kind.kind in "bfiu" else None
        except (RuntimeError, TypeError, ValueError) as cause:  # lists of different lengths, a tensor on a GPU
            raise error(f"{wanted} ({cause})") from cause
        if given is None:
            raise error(f"{wanted}, not {kind}")
        if given.shape != (count, 3):
            raise error(f"{wanted}, not the shape {given.shape}")
        right = (given >= (-1.0, 0.0, 0.0)) & (given <= 1.0) | ~driven[:, None]
        if not right.all():
            i, k = np.argwhere(~right)[0].tolist()
            low = -1 if k == 0 else 0
            raise error(f"actions[{i}].{CONTROLS[k]}: is {given[i, k]}; give a number from {low} to 1")
        return given

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture of each environment, uint8 (480, 864, 3); None unless ``rgb_array`` was asked for.

        It is the view from above beside the camera's, as a single environment shows it. Before the first reset it
        raises what ``step`` raises then.
        """
        if not self._begun.all():
            raise self._NOT_BEGUN("render before the first reset; call reset")
        return None if self.render_mode is None else tuple(self._picture(i) for i in range(self.num_envs))

    @abstractmethod
    def _picture(self, i: int) -> NDArray[np.uint8]:
        """Draw an environment's moment."""

    def _note(self, infos: dict[str, Any], i: int, **values: Any) -> None:
        """Add values to ``infos``; Gymnasium's ``_add_info`` would turn dicts into arrays of numbers."""
        for name, value in values.items():
            if name not in infos:
                infos[name] = np.full(self.num_envs, None, object)
                infos[f"_{name}"] = np.zeros(self.num_envs, np.bool_)
            infos[name][i] = value
            infos[f"_{name}"][i] = True

    def _note_end(self, infos: dict[str, Any], i: int, last: Observation, **info: Any) -> None:
        """Add an episode's end to ``infos``; with its last observation where the next episode began at once."""
        if self.autoreset_mode is not AutoresetMode.SAME_STEP:
            self._note(infos, i, **info)
            return
        self._note(infos, i, final_obs=last)
        self._note(infos.setdefault("final_info", {}), i, **info)
        infos["_final_info"] = infos["_final_obs"]


def _check_render_mode(render_mode: str | None, modes: Sequence[str] = RENDER_MODES) -> None:
    """Raise OptionError unless the mode is None or one of those that an environment has."""
    if render_mode is not None and render_mode not in modes:
        raise OptionError(
            f"render_mode: {render_mode!r} is not known; take {' or '.join(modes)}, or leave it None"
            f"{did_you_mean(render_mode, modes)}"
        )


class _Screen:
    """A window on the desktop for the render mode ``human``. The first picture opens it; it shows ten a second."""

    def __init__(self) -> None:
        try:
            import pygame  # noqa: PLC0415 - an extra, which only this window needs
        except ImportError as error:
            raise DependencyNotInstalled(
                f"render_mode: human needs pygame, which is missing: {install('pygame')}"
            ) from error
        self._pygame = pygame
        self._window: Any = None
        self._clock: Any = None

    def show(self, image: NDArray[np.uint8]) -> None:
        """Show a picture, RGB uint8 (height, width, 3), a tenth of a second after the one before."""
        pygame, size = self._pygame, (image.shape[1], image.shape[0])
        if self._window is None:
            pygame.display.init()  # not pygame.init(), which starts sound too
            pygame.display.set_caption("Wrongturn")
            self._window = pygame.display.set_mode(size)
            self._clock = pygame.time.Clock()
        self._window.blit(pygame.surfarray.make_surface(image.swapaxes(0, 1)), (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(FRAMES_A_SECOND)

    def close(self) -> None:
        """Close the window. Safe to call more than once."""
        if self._window is not None:
            self._pygame.display.quit()
            self._window = None
