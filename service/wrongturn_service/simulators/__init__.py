"""Simulators: processes that each run one libsumo simulation.

- :mod:`~wrongturn_service.simulators.interface`: what the service asks of a simulator and of a pool of them.
- :mod:`~wrongturn_service.simulators.local_pool`: a pool of processes on this machine, started when they are needed.
- :mod:`~wrongturn_service.simulators.local_simulator`: one of these processes, as the service sees it.
- :mod:`~wrongturn_service.simulators.worker`: the program that runs in the process.
- :mod:`~wrongturn_service.simulators.check`: the check of simulators for ``wrongturn doctor``.
"""
