"""Ray for Wrongturn: simulators and runners of a service, batches and training on the nodes of a cluster.

Ray places and watches programs of ours; they talk with the service over TCP. ``cluster`` is what the service loads,
``node`` runs on a node, ``driver`` is the process that knows Ray, ``programs`` and ``listener`` are the service's ends.
"""
