"""Ids of environments that have wrappers in them, for programs that take nothing but an id."""

from typing import Final

from gymnasium import register
from gymnasium.envs.registration import WrapperSpec

_OURS: Final = "wrongturn_protocol.wrappers"
_FLAT: Final = (f"{_OURS}:CarFrame", "gymnasium.wrappers:FlattenObservation")
_VARIANTS: Final = {
    "Flat": ("privileged", (*_FLAT, f"{_OURS}:SteerAndPedal")),
    "FlatDiscrete": ("privileged", (*_FLAT, f"{_OURS}:DiscreteActions")),
    "Pixels": ("camera", (f"{_OURS}:OnlyPicture", f"{_OURS}:SteerAndPedal")),
}
"""What follows the name of an id: the track, and the wrappers, innermost first."""


def register_variants(name: str, entry_point: str) -> None:
    """Register ``<name>Flat-v0``, ``<name>FlatDiscrete-v0`` and ``<name>Pixels-v0`` of a class, ``module:name``."""
    for suffix, (track, wrappers) in _VARIANTS.items():
        register(
            f"{name}{suffix}-v0",
            entry_point=entry_point,
            kwargs={"track": track},
            additional_wrappers=tuple(WrapperSpec(one.partition(":")[2], one, {}) for one in wrappers),
        )
