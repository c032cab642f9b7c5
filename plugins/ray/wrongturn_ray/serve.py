"""The program of a simulator on a node: ``python -m wrongturn_ray.serve HOST:PORT SECONDS``.

It connects with the service that expects it there, and then is as :mod:`wrongturn_service.simulators.worker` says.
"""

import gc

if __name__ == "__main__":
    # Hardly anything that is imported is garbage. To look for it takes a sixth of the start.
    gc.disable()
    from wrongturn_ray.connecting import connect
    from wrongturn_service.simulators.worker import main

    main(connect)
