"""What outlives the service: agents, evaluations, finished episodes, trajectories, idempotency keys.

- :mod:`~wrongturn_service.storage.models`: the tables.
- :mod:`~wrongturn_service.storage.database`: the engine, the file's lock, migrations at start.
- :mod:`~wrongturn_service.storage.store`: every query, one method each.
"""
