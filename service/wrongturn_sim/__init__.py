"""Wrongturn's simulation: towns on SUMO, a car, command faults and episodes, judged by their trajectories."""

from wrongturn_sim.home import set_cache

set_cache()
