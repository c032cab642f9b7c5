"""Whether anybody answers at a URL, and a line in the log while a service is waited for."""

import logging
from typing import Final

_LOG: Final = logging.getLogger("wrongturn_client")
_FIRST_CONTACT: Final = 5.0
"""Seconds of patience with a URL at which nobody has answered yet: it may well be mistyped."""


class Availability:
    """What is known of the service at a URL; a client and its connections for driving share it."""

    def __init__(self, url: str) -> None:
        """Nothing is known yet.

        Args:
            url: of the service.
        """
        self.url = url
        self.offers_socket = False
        """Whether the WebSocket for driving has been there."""
        self._has_answered = False
        self._waiting = False

    def patience(self, wanted: float) -> float:
        """Seconds for which is tried again: as many as wanted where somebody has answered before, else a few."""
        return wanted if self._has_answered else min(wanted, _FIRST_CONTACT)

    def answered(self) -> None:
        """Somebody answered."""
        self._has_answered = True
        if self._waiting:
            self._waiting = False
            _LOG.info("%s answers again", self.url)

    def unanswered(self, why: str, seconds: float) -> None:
        """Nobody answers, and is waited for; logged once until somebody does or it is given up.

        A first contact is not logged: its error comes soon enough.
        """
        if self._has_answered and not self._waiting:
            self._waiting = True
            _LOG.warning("%s does not answer (%s); trying again for up to %.0f s", self.url, why, seconds)

    def given_up(self) -> None:
        """Nobody answered in time, which the caller is told by an error."""
        self._waiting = False
