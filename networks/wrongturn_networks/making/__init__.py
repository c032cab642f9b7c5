"""Building of towns and suites. Towns need SUMO's netconvert."""
