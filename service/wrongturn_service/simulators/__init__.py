"""Simulators: processes that each run one libsumo simulation.

- :mod:`~wrongturn_service.simulators.interface`: what the service asks of a simulator and of a pool of them.
- :mod:`~wrongturn_service.simulators.local_pool`: a pool of processes on this machine, started when they are needed.
- :mod:`~wrongturn_service.simulators.local_simulator`: one of these processes, as the service sees it.
- :mod:`~wrongturn_service.simulators.worker`: the program that runs in the process.
- :mod:`~wrongturn_service.simulators.shared_memory`: memory that the service and the process share.
- :mod:`~wrongturn_service.simulators.actions`: actions as they are driven.
- :mod:`~wrongturn_service.simulators.frames`: messages between the service and the process.
- :mod:`~wrongturn_service.simulators.memory`: how much memory a process has.
- :mod:`~wrongturn_service.simulators.check`: the check of simulators for ``wrongturn doctor``.
"""
