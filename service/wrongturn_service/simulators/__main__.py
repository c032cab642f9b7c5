"""The program of a simulator process, see :mod:`wrongturn_service.simulators.worker`."""

import gc

if __name__ == "__main__":
    # Hardly anything that is imported is garbage. To look for it takes a sixth of the start.
    gc.disable()
    from wrongturn_service.simulators.worker import main

    main()
