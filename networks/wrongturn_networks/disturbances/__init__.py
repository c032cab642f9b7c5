"""Disturbances: faults of the camera, the sensors and the steering. The command is right. Each is one file.

They have the shape of :mod:`wrongturn_networks.faults`, which registers them.
"""
