"""The calls that need no token: the service's state, suites, towns and leaderboards."""

from typing import Any
from urllib.parse import urlencode

from wrongturn_client.errors import ProtocolError
from wrongturn_client.rest import RestCalls
from wrongturn_client.transport import CSV, path_of
from wrongturn_protocol import (
    Comparison,
    Leaderboard,
    LeaderboardList,
    LeaderboardSummary,
    SuiteDetail,
    SuiteList,
    SuiteSummary,
    TownDetail,
    TownList,
    TownSummary,
    TrialDetail,
    TrialList,
)


class PublicCalls(RestCalls):
    """What anybody may ask a service."""

    def live(self) -> bool:
        """Return True if the service's process answers."""
        self._transport.call("GET", "/health/live")
        return True

    def ready(self) -> bool:
        """Return True once the service can take episodes; wait for the patience at most."""
        self._transport.call("GET", "/health/ready")
        return True

    def submissions_state(self) -> str | None:
        """Return whether the service takes submissions: ``on: …``, or ``off:`` and why; None if it does not say."""
        state = self._readiness().get("submissions")
        return state if isinstance(state, str) else None

    def simulators(self) -> int | None:
        """Return how many episodes all agents together can drive at a time; None if the service does not say."""
        number = self._readiness().get("simulators")
        return number if isinstance(number, int) else None

    def _readiness(self) -> dict[str, Any]:
        found = self._transport.call("GET", "/health/ready").message()
        return found if isinstance(found, dict) else {}

    def suites(self) -> tuple[SuiteSummary, ...]:
        """Return all suites."""
        return self._get(SuiteList, "suites").suites

    def suite(self, suite: str) -> SuiteDetail:
        """Return a suite by its id, such as ``wrong-command@2``."""
        return self._get(SuiteDetail, "suites", suite)

    def trials(self, suite: str) -> tuple[TrialDetail, ...]:
        """Return the trials of a suite's open split, for practice. You can practise their twins too."""
        return self._get(TrialList, "suites", suite, "trials").trials

    def towns(self) -> tuple[TownSummary, ...]:
        """Return all towns."""
        return self._get(TownList, "towns").towns

    def town(self, town: str) -> TownDetail:
        """Return a town with its approaches and geometry."""
        return self._get(TownDetail, "towns", town)

    def leaderboards(self) -> tuple[LeaderboardSummary, ...]:
        """Return the suites that have a leaderboard."""
        return self._get(LeaderboardList, "leaderboards").leaderboards

    def leaderboard(self, suite: str) -> Leaderboard:
        """Return the ranking on a suite."""
        return self._get(Leaderboard, "leaderboards", suite)

    def leaderboard_csv(self, suite: str) -> str:
        """Return the ranking on a suite as CSV, a row for each agent.

        Raises:
            ProtocolError: The service is of a version without it.
        """
        reply = self._transport.call("GET", path_of("v1", "leaderboards", suite), media_type=CSV)
        if reply.media_type != CSV:
            raise ProtocolError(
                f"leaderboard: {self._transport.url} has none as CSV; its operator can upgrade the service"
            )
        return reply.content.decode("utf-8")

    def compare(self, suite: str, a: str, b: str) -> Comparison:
        """Compare two agents' results on a suite, with an exact test.

        Args:
            suite: The suite's id.
            a: Id or name of an agent with an entry on the suite.
            b: Id or name of another one.
        """
        return self._get(Comparison, "leaderboards", suite, "compare", query="?" + urlencode({"a": a, "b": b}))
