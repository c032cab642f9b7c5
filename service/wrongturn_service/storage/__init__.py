"""What outlives the service: agents, evaluations, finished episodes, trajectories, idempotency keys.

- :mod:`~wrongturn_service.storage.models`: the tables.
- :mod:`~wrongturn_service.storage.location`: the database's URL, its file's folder and lock.
- :mod:`~wrongturn_service.storage.database`: the engine, migrations at start.
- :mod:`~wrongturn_service.storage.check`: whether a service could use it, for ``wrongturn doctor``.
- :mod:`~wrongturn_service.storage.store`: every query, one method each.
"""
