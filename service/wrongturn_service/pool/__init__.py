"""Simulators: what the service asks of them, and where they run.

- :mod:`~wrongturn_service.pool.pool`: the interface; whatever runs simulators stands behind it.
- :mod:`~wrongturn_service.pool.local`: processes of this machine, started when they are needed.
- :mod:`~wrongturn_service.pool.local_simulator`: one of them.
- :mod:`~wrongturn_service.pool.process`: what runs in such a process.
- :mod:`~wrongturn_service.pool.frames`: how the two talk.
"""
