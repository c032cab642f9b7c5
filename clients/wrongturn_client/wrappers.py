"""Wrappers of the environments: the names of :mod:`wrongturn_protocol.wrappers`."""

from wrongturn_protocol import wrappers as _wrappers
from wrongturn_protocol.wrappers import *  # noqa: F403 - every name, and no list to keep twice

__all__ = _wrappers.__all__
