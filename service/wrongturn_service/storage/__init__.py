"""Storage of agents, evaluations, finished episodes, trajectories and idempotency keys.

- :mod:`~wrongturn_service.storage.models`: the tables.
- :mod:`~wrongturn_service.storage.location`: the database's URL, and the folder and lock of its file.
- :mod:`~wrongturn_service.storage.database`: the engine and its migrations.
- :mod:`~wrongturn_service.storage.check`: the check of the database for ``wrongturn doctor``.
- :mod:`~wrongturn_service.storage.store`: all queries, one method each.
"""
