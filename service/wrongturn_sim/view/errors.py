"""Errors of pictures and films.

::

    SimError
    └── ViewError (ValueError)           a picture or film cannot be made as asked; the message names the remedy
        └── FilmError                    the film's file
"""

from wrongturn_sim.errors import SimError


class ViewError(SimError, ValueError):
    """A picture or film cannot be made as asked. The message names the remedy."""


class FilmError(ViewError):
    """A film's file cannot be written, or its name ends wrongly."""
