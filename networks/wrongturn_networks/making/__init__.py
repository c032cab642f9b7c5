"""Builds the towns and the suites; needs SUMO's netconvert."""
