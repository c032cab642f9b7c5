"""Building of towns and suites; towns need SUMO's netconvert. ``docs/extending.md`` shows one of each."""

from wrongturn_networks.making.netconvert import build
from wrongturn_networks.making.recipes import Recipe, Street
from wrongturn_networks.making.writing_suites import write_suite

__all__ = ["Recipe", "Street", "build", "write_suite"]
