"""Programs of ours on the nodes of a Ray cluster. Ray places and watches them; they talk with the service over TCP.

``node`` runs on a node, ``driver`` is the process that knows Ray, ``programs`` and ``listener`` are the service's ends.
"""
