"""A prioritised replay memory on the device, for many cars that drive side by side.

Schaul et al., "Prioritized experience replay" (ICLR 2016). The sums over all priorities are taken anew for each
minibatch: on a GPU that costs less than a tree's steps, and a million numbers take a millisecond on a CPU.
"""

from typing import NamedTuple

import torch
from torch import Tensor


class Decisions(NamedTuple):
    """What n cars saw and did at one time; (n, ...) each, on the device."""

    features: Tensor
    """(n, width): encoded pictures."""
    measured: Tensor
    """(n, 2) float32: speed and steering."""
    command: Tensor
    """(n,) int64"""
    action: Tensor
    """(n,) int64"""
    reward: Tensor
    """(n,) float32"""
    ended: Tensor
    """(n,) bool: a verdict ended the drive."""
    cut: Tensor
    """(n,) bool: time ended the drive, so that nobody knows what would have followed."""


class Sample(NamedTuple):
    """A minibatch of b decisions."""

    now: Decisions
    returns: Tensor
    """(b,): discounted sum of the next n rewards, up to the drive's end."""
    following: Tensor
    """(b,): factor of the value of what follows; 0 if the drive ended before."""
    later: Decisions
    """The decisions after the return."""
    weight: Tensor
    """(b,): importance-sampling weights, the greatest is 1."""
    places: Tensor
    """(b,): places in the memory, for :meth:`Replay.update`."""


class Replay:
    """The newest ``size`` decisions of a number of cars, and how likely each is replayed.

    With an exponent of the priorities of 0, all are replayed alike.
    """

    def __init__(
        self,
        size: int,
        cars: int,
        width: int,
        *,
        n_step: int,
        gamma: float,
        exponent: float,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.bfloat16,
    ) -> None:
        self.times, self.cars, self.n_step, self.gamma = size // cars, cars, n_step, gamma
        self._exponent = exponent
        shape = self.times, cars

        def make(*more: int, kind: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros((*shape, *more), dtype=kind, device=device)

        self._kept = Decisions(
            features=make(width, kind=dtype),
            measured=make(2),
            command=make(kind=torch.int64),
            action=make(kind=torch.int64),
            reward=make(),
            ended=make(kind=torch.bool),
            cut=make(kind=torch.bool),
        )
        self._chance = make()
        """Priorities to the exponent; 0 where a decision cannot be replayed."""
        self._greatest = torch.ones((), device=device)
        self._next = 0
        self._added = 0

    def __len__(self) -> int:
        """Return the number of decisions that can be replayed, some of which have no whole return."""
        return max(0, min(self._added, self.times) - self.n_step) * self.cars

    def add(self, decisions: Decisions) -> None:
        """Keep a decision of every car in place of the oldest one."""
        for kept, given in zip(self._kept, decisions, strict=True):
            kept[self._next].copy_(given)
        self._chance[self._next] = 0.0
        self._added += 1
        if self._added > self.n_step:
            whole = (self._next - self.n_step) % self.times
            # A return that time cut off says nothing about what would have followed.
            times = torch.arange(whole, whole + self.n_step, device=self._chance.device) % self.times
            ended, cut = self._kept.ended[times].cummax(0).values, self._kept.cut[times]
            before = torch.cat([torch.zeros_like(ended[:1]), ended[:-1]])
            self._chance[whole] = torch.where((cut & ~before).any(0), 0.0, self._greatest)
        self._next = (self._next + 1) % self.times

    def sample(self, count: int, weight: float, generator: torch.Generator | None = None) -> Sample:
        """Draw decisions in proportion to their priorities, one in each of ``count`` equal parts of their sum.

        ``weight`` is the exponent of the importance-sampling weights; 1 corrects for the priorities in full.
        """
        chance = self._chance.flatten()
        sums = chance.double().cumsum(0)
        draws = torch.rand(count, device=chance.device, generator=generator, dtype=torch.float64)
        parts = (torch.arange(count, device=chance.device) + draws) / count * sums[-1]
        index = torch.searchsorted(sums, parts, right=True).clamp(max=len(sums) - 1)
        share = chance[index].double() / sums[-1]
        weights = (share * len(self)).pow(-weight)
        time, car = index // self.cars, index % self.cars
        returns, following = self._returns(time, car)
        after = (time + self.n_step) % self.times
        return Sample(
            now=Decisions(*(kept[time, car] for kept in self._kept)),
            returns=returns,
            following=following,
            later=Decisions(*(kept[after, car] for kept in self._kept)),
            weight=(weights / weights.max()).float(),
            places=index,
        )

    def update(self, places: Tensor, priority: Tensor) -> None:
        """Set the priorities (b,) of sampled decisions."""
        chance = (priority.detach().float() + 1e-6).pow(self._exponent)
        self._chance.view(-1)[places] = chance
        self._greatest = torch.maximum(self._greatest, chance.max())

    def _returns(self, time: Tensor, car: Tensor) -> tuple[Tensor, Tensor]:
        going = torch.ones_like(time, dtype=torch.float32)
        total = torch.zeros_like(going)
        for k in range(self.n_step):
            at = (time + k) % self.times
            total += going * self.gamma**k * self._kept.reward[at, car]
            going *= (~self._kept.ended[at, car]).float()
        return total, going * self.gamma**self.n_step
