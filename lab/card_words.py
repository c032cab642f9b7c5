"""What a card says of each kind of agent, and no file knows."""

from dataclasses import dataclass
from typing import Final

from wrongturn_protocol.model_contract import STATE_IN, STATE_OUT

_CARTON: Final = (
    "Carton et al., *Evaluating Robustness over High Level Driving Instruction for Autonomous Driving* (2021)"
)
_CHEATING: Final = "*Learning by Cheating* (Chen et al., CoRL 2019)"
_AFFORDANCES: Final = (
    "*End-to-End Model-Free Reinforcement Learning for Urban Driving using Implicit Affordances* (Toromanoff et al., "
    "CVPR 2020)"
)
_OWN_WEIGHTS: Final = "This agent was trained in this benchmark's simulation; none of its weights are from a paper."
_COMPARES: Final = f"{_CARTON}, compare their agents with it. {_OWN_WEIGHTS}"
_BY_EXAMPLE: Final = (
    "It does not see traffic lights or signs. It brakes for other road users only as examples taught it."
)


@dataclass(frozen=True)
class Words:
    """Sentences of a card."""

    origin: str
    """Whose method it is."""
    inside: str
    """What the graph does with its inputs, and what it remembers."""
    steps: str = "environment steps"
    """What its training counts."""
    int8: str = "convolutions and the wide layer behind them in 8 bits, the rest as 16-bit floating point"
    """Which weights have 8 bits."""
    others: str = "It does not see traffic lights or signs, and has learned no rule of right of way."
    """How it treats other road users."""


_PPO: Final = Words(
    f"It is one of the three agents of {_CARTON}. {_OWN_WEIGHTS}",
    "The graph scales the picture, or spreads its classes over planes. The agent has no memory between steps.",
)
_WORDS: Final = {
    "lbc": Words(
        f"The method is {_CHEATING}. {_COMPARES}",
        f"The graph scales the picture and turns waypoints into controls. The agent's memory (`{STATE_IN}`, "
        f"`{STATE_OUT}`) is two numbers: the mean errors of its steering and of its speed.",
        "samples",
        "convolutions in 8 bits, the rest as 16-bit floating point",
        _BY_EXAMPLE,
    ),
    "lbc-privileged": Words(
        f"It is the teacher of `lbc` in {_CHEATING}. It sees the truth, so it drives in the privileged track. "
        f"Carton et al. have no figure of it. {_OWN_WEIGHTS}",
        f"The graph draws the view from above and turns waypoints into controls. The agent's memory (`{STATE_IN}`, "
        f"`{STATE_OUT}`) is two numbers: the mean errors of its steering and of its speed.",
        "samples",
        "convolutions in 8 bits, the rest as 16-bit floating point",
        _BY_EXAMPLE,
    ),
    "marln": Words(
        f"The method is {_AFFORDANCES}. {_COMPARES}",
        f"The graph scales the pictures. The agent's memory (`{STATE_IN}`, `{STATE_OUT}`) holds the pictures of the "
        "three decisions before.",
    ),
}


def words_of(name: str) -> Words:
    """Return what the card of a shipped agent says."""
    return _WORDS.get(name, _PPO)
