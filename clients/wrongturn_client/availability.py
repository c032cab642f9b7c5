"""Whether a service answers, and a line in the log while the client waits for it."""

import logging
from typing import Final

_LOG: Final = logging.getLogger("wrongturn_client")
_FIRST_CONTACT: Final = 5.0
"""Seconds to wait for a URL that has never answered. It may be mistyped."""


class Availability:
    """What a client and its driving connections know of the service at a URL."""

    def __init__(self, url: str) -> None:
        self.url = url
        self.offers_socket = False
        """Whether the WebSocket for driving was there once."""
        self._has_answered = False
        self._waiting = False

    def patience(self, wanted: float) -> float:
        """Return the seconds for which to try again: ``wanted`` if the service has answered before, else a few."""
        return wanted if self._has_answered else min(wanted, _FIRST_CONTACT)

    def answered(self) -> None:
        """Note that the service answered."""
        self._has_answered = True
        if self._waiting:
            self._waiting = False
            _LOG.info("%s answers again", self.url)

    def unanswered(self, why: str, seconds: float) -> None:
        """Log once that the client waits. Before the first answer it logs nothing: the error then comes soon."""
        if self._has_answered and not self._waiting:
            self._waiting = True
            _LOG.warning("%s does not answer (%s); trying again for up to %.0f s", self.url, why, seconds)

    def given_up(self) -> None:
        """Note that the client stops waiting; its caller gets an error."""
        self._waiting = False
