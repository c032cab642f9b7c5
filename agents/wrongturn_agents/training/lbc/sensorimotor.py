"""The second half: the agent with a camera learns what the privileged agent tells, and drives to learn more."""

from collections.abc import Callable

import torch
from torch import Tensor

from wrongturn_agents.models.augmentation import Augmentation
from wrongturn_agents.models.lbc import COMMANDS, SensorimotorAgent, WaypointAgent, commanded
from wrongturn_agents.models.waypoints import SIZE, to_picture
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.lbc.cars import Cars
from wrongturn_agents.training.lbc.config import LBCConfig
from wrongturn_agents.training.lbc.driving import Drivers, told
from wrongturn_agents.training.lbc.expert import plan
from wrongturn_agents.training.lbc.learning import Learner, Samples, precision

_SEEN = ("rgb", "speed", "command")


class Teacher:
    """Tells what the agent with a camera should tell: the privileged agent's waypoints, or the expert's.

    Args:
        privileged: the privileged agent.
        white_box: teach its waypoints for all commands; else the expert's for the one that is given.
    """

    def __init__(self, privileged: WaypointAgent, *, white_box: bool) -> None:
        self._privileged = privileged
        self._white_box = white_box

    def teach(self, cars: Cars, seen: dict[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Return waypoints to drive by (n, 5, 2), points in the picture to learn (n, 4, 5, 2), and weights (n, 4)."""
        if self._white_box:
            waypoints = self._privileged(seen).float()
            weights = torch.ones(waypoints.shape[:2], device=waypoints.device)
            return commanded(waypoints, seen["command"]), to_picture(waypoints), weights
        planned = plan(cars.situation(seen))
        numbers = torch.arange(1, len(COMMANDS) + 1, device=planned.device)
        points = to_picture(planned)[:, None].expand(-1, len(COMMANDS), -1, -1)
        return planned, points, (seen["command"] == numbers).float()


def learn_sensorimotor(
    learner: Learner,
    teacher: Teacher,
    config: LBCConfig,
    *,
    seed: int,
    budget: Budget,
    threads: int = 1,
    on_update: Callable[[Tensor, int, list[str]], bool],
) -> None:
    """Teach the agent with a camera until the budget is over.

    At first the teacher drives. Then the agent drives most of the cars, in rounds: each begins with a copy of it.

    Args:
        learner: the agent.
        teacher: tells what to learn.
        config: settings.
        seed: seed of the drives and of all that is drawn.
        budget: samples (its steps) and minutes.
        threads: threads of simulation and camera.
        on_update: called after each update with the loss, the number of samples collected, and the verdicts of drives
            that ended; False ends the learning.
    """
    device = learner.device
    generator = torch.Generator(device).manual_seed(seed)
    augmentation = Augmentation().to(device)
    cars = Cars(config.num_envs, config, seed=seed, pictures=True, device=device, threads=threads)
    drivers = Drivers(config.num_envs, config, generator)
    samples = Samples(config.buffer)
    begun, current = learner.seen, 0
    driving = SensorimotorAgent(config.width).to(device).eval().requires_grad_(False)
    try:
        while not budget.over(learner.seen):
            share = budget.fraction(learner.seen)
            if len(samples) < config.begin or learner.seen - begun >= config.uses * samples.added:
                if (number := round_of(share, config)) > current:
                    driving.load_state_dict(learner.average.state_dict())
                    current = number
                _collect(cars, teacher, driving if current else None, drivers, samples, config)
                continue
            if learner.seen == 0:
                budget.begun = budget.used  # compiling and the first samples do not count
            batch = samples.draw(config.batch_size)
            if config.augment:
                batch["rgb"] = augmentation(batch["rgb"])
            with precision(config, device):
                found = learner.live.points(batch)
            loss = picture_loss(found, batch["points"], batch["weights"])
            learner.learn(loss, config.batch_size, share)
            if not on_update(loss, samples.added, cars.ended):
                return
    finally:
        cars.close()


def round_of(share: float, config: LBCConfig) -> int:
    """Return the number of DAgger's round in which a share of the learning is over; 0 before the first."""
    if config.rounds == 0 or share < config.offline:
        return 0
    return min(config.rounds, 1 + int((share - config.offline) / max(1.0 - config.offline, 1e-9) * config.rounds))


def picture_loss(found: Tensor, wanted: Tensor, weights: Tensor) -> Tensor:
    """Return the mean distance of points in the picture along rows and columns, pixels.

    Args:
        found: (n, 4, 5, 2), -1 to 1.
        wanted: (n, 4, 5, 2).
        weights: (n, 4): 0 for commands that do not count.
    """
    half = torch.tensor(SIZE, device=found.device) / 2.0
    pixels = ((found.float() - wanted).abs() * half).mean((2, 3))
    return (pixels * weights).sum() / weights.sum().clamp_min(1.0)


@torch.no_grad()
def _collect(
    cars: Cars, teacher: Teacher, agent: WaypointAgent | None, drivers: Drivers, samples: Samples, config: LBCConfig
) -> None:
    """Add samples of what the cars see, and drive on: all by the teacher, or most of them by the agent."""
    seen = cars.observe()
    with precision(config, cars.device):
        waypoints, points, weights = teacher.teach(cars, seen)
        by_teacher = torch.arange(cars.count, device=cars.device) < (
            cars.count if agent is None else round(config.guided * cars.count)
        )
        if agent is not None:
            waypoints = torch.where(by_teacher[:, None, None], waypoints, told(agent, seen))
    samples.add({**{name: seen[name] for name in _SEEN}, "points": points, "weights": weights})
    action = drivers.act(waypoints, seen["speed"], by_teacher)
    drivers.begin(torch.from_numpy(cars.step(action)).to(cars.device))
