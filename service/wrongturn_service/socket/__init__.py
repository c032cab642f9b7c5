"""The WebSocket ``/v1/drive``, from the bytes of a connection to the calls that they hold.

- :mod:`~wrongturn_service.socket.guards`: limits for connections and for slow clients, and uvicorn's HTTP within them.
- :mod:`~wrongturn_service.socket.protocol`: uvicorn's WebSocket, with a shorter path for binary messages.
- :mod:`~wrongturn_service.socket.limits`: how many connections an agent or an address may open.
- :mod:`~wrongturn_service.socket.session`: one client's connection.
- :mod:`~wrongturn_service.socket.calls`: the calls of a message.
"""
