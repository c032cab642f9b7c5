"""Batches: practice without a service, by processes of this machine or of a Ray cluster.

With :mod:`wrongturn_agents.training`, this is the only package of the agents that imports the simulation.
"""
