"""The judge: how a drive ended, from its trajectory and the town's geometry alone.

:class:`Judge` takes rows while they are driven, :func:`judge` takes them from a trajectory. Both run the same code.
``__init__.pyi`` lists the public names.
"""

import lazy_loader

from wrongturn_judge.home import set_cache

set_cache()  # before numba is imported anywhere

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
