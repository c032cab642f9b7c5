"""The command gate of ``doubting``: from a command and what the picture tells to a command that can be obeyed."""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn

from wrongturn_protocol import Command
from wrongturn_protocol.vehicle import DECISION_S

BELIEF, DISTANCE, CHOICE, TRAVELLED, LOOKS, CLEAR = slice(0, 3), 3, 4, 5, 6, 7
"""Columns of the gate's memory: belief in each exit (logits); distance to the stop line, metres; the exit that was
chosen (0: none yet); metres travelled since; number of pictures in the belief; pictures in a row without a junction."""
MEMORY: Final = 8
"""Width of the memory. It begins with zeros."""
_CERTAIN: Final = 6.0


@dataclass(frozen=True)
class GateConfig:
    """Settings of the gate."""

    begin: float = 16.0
    """A junction this near is obeyed, metres to the stop line: the car slows for it, command or not. Farther away, each
    command is LANE_FOLLOW."""
    choose: float = 5.0
    """Here the choice is made, metres to the stop line. It holds until the junction is left."""
    belief: float = 28.0
    """Pictures from this far on count for the belief, metres."""
    forget: float = 0.2
    """Least weight of the newest picture in the belief."""
    follow: float = 0.15
    """Weight of the newest picture in the distance, against the old distance less what was driven since. A car that
    comes out of a bend askew may see a junction for some pictures where none is."""
    leave_travelled: float = 12.0
    """Least distance travelled since the choice before it ends, metres."""
    leave_distance: float = 12.0
    """A choice ends when the next stop line is farther than this, metres, in three pictures in a row ..."""
    leave_at_last: float = 40.0
    """... or after this many metres."""
    infeasible: bool = True
    """*Ablation.* Replace a commanded exit that does not exist."""
    omission: bool = True
    """*Ablation.* Choose an exit where the command is LANE_FOLLOW or VOID."""
    memory: bool = True
    """*Ablation.* Remember pictures and choices."""


class Gate(nn.Module):
    """Replaces commands that the road does not offer.

    * Far from a junction, the command is LANE_FOLLOW.
    * Near one, a commanded exit that exists is obeyed. Any other command becomes the best exit that exists: straight on
      or else the likelier turn.
    * Shortly before the stop line the choice is made. It holds until the junction is left, whatever the command.

    All of it is arithmetic on tensors, so that an exported graph holds it.
    """

    def __init__(self, config: GateConfig | None = None) -> None:
        super().__init__()
        self.config = config or GateConfig()

    def forward(
        self, exits: Tensor, distance: Tensor, speed: Tensor, command: Tensor, memory: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the command to obey (B, 1) int64, and the memory for the next step (B, MEMORY).

        Args:
            exits: (B, 3) logits that the exits exist: left, right, straight.
            distance: (B, 1) metres to the stop line, 0 inside a junction.
            speed: (B, 1) m/s.
            command: (B, 1) int64, as it was delivered.
            memory: (B, MEMORY) of the last step; zeros at the start.
        """
        config = self.config
        if not config.memory:
            memory = torch.zeros_like(memory)
        driven = speed * DECISION_S
        before = memory[:, CHOICE : CHOICE + 1]
        free = before < 0.5
        # What is known about the junction ahead.
        looks = memory[:, LOOKS : LOOKS + 1]
        first = looks < 0.5
        weight = torch.clamp(1.0 / (looks + 1.0), min=config.forget)
        ahead = torch.where(first, distance, memory[:, DISTANCE : DISTANCE + 1] - driven)
        ahead = torch.where(free, ahead + config.follow * (distance - ahead), distance)
        counts = free & (ahead < config.belief)
        clipped = exits.clamp(-_CERTAIN, _CERTAIN)
        belief = torch.where(counts, memory[:, BELIEF] + weight * (clipped - memory[:, BELIEF]), memory[:, BELIEF])
        looks = looks + torch.where(counts | first, 1.0, 0.0)
        wanted = self._wanted(belief, command)
        # A choice is made, kept or left.
        choosing = free & (ahead < config.choose) & (wanted < int(Command.LANE_FOLLOW))
        choice = torch.where(choosing, wanted.to(before.dtype), before)
        travelled = torch.where(free, torch.zeros_like(driven), memory[:, TRAVELLED : TRAVELLED + 1] + driven)
        clear = torch.where(
            (distance > config.leave_distance) & (travelled > config.leave_travelled),
            memory[:, CLEAR : CLEAR + 1] + 1.0,
            torch.zeros_like(driven),
        )
        left = (choice > 0.5) & ((clear > 2.5) | (travelled > config.leave_at_last))
        near = torch.where(ahead < config.begin, wanted, int(Command.LANE_FOLLOW))
        obeyed = torch.where(left, int(Command.LANE_FOLLOW), torch.where(choice > 0.5, choice.long(), near))
        after = torch.cat([belief, ahead, choice, travelled, looks, clear], 1)
        return obeyed, torch.where(left, self._behind_a_junction(after), after)

    def _behind_a_junction(self, memory: Tensor) -> Tensor:
        """Return the memory of a car that has just left a junction: the next one is far, until pictures say otherwise.

        The car may still be turning, and single pictures of the road's far side show stop lines that are not ahead.
        """
        forgotten = [0.0] * MEMORY
        forgotten[DISTANCE], forgotten[LOOKS] = self.config.belief, 1.0
        return memory.new_tensor(forgotten).expand_as(memory)

    def _wanted(self, belief: Tensor, command: Tensor) -> Tensor:
        """Return the command, or the best exit where it offers none (B, 1) int64."""
        left, right, straight = (belief[:, k : k + 1] for k in range(3))
        turn = torch.where(left > right, int(Command.LEFT), int(Command.RIGHT))
        best = torch.where((straight > 0.0) | (straight > torch.maximum(left, right)), int(Command.STRAIGHT), turn)
        named = (command >= int(Command.LEFT)) & (command <= int(Command.STRAIGHT))
        index = torch.where(named, command - int(Command.LEFT), 0)
        exists = belief.gather(1, index) > 0.0
        follow = torch.full_like(command, int(Command.LANE_FOLLOW))
        obeyed = torch.where(exists, command, best) if self.config.infeasible else command
        return torch.where(named, obeyed, best if self.config.omission else follow)
