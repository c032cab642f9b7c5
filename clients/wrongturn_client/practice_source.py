"""The trials that an environment over the wire draws."""

import numpy as np

from wrongturn_client.client import Client
from wrongturn_protocol import ApproachDetail, OptionError, PracticeRequest, Trial, TrialOptions
from wrongturn_protocol.trial_options import DEFAULT_TOWN


class PracticeSource:
    """Draws practice trials in a town (``Town01`` by default) or out of a suite's open split."""

    def __init__(self, options: TrialOptions) -> None:
        """Raise OptionError for an option that works in process only."""
        if options.journeys is not None:
            raise OptionError("journeys: the service draws cruises its own way; leave it out, or drive in process")
        if isinstance(options.trial, Trial):
            raise OptionError(f"trial: a service takes no Trial; give suite and trial={options.trial.id!r}")
        self._options = options
        self._town = options.town or DEFAULT_TOWN
        self._approaches: tuple[str, ...] = () if options.approach is None else (options.approach,)
        self._trials: tuple[str, ...] = () if options.trial is None else (options.trial,)

    def draw(self, client: Client, random: np.random.Generator, trial: str | None = None) -> PracticeRequest:
        """Return the request of the next trial, or of the suite's named one; equal generators give equal trials.

        The first call asks the service for the approaches or trials to draw from.
        """
        options = self._options
        if options.suite is not None:
            if trial is None and not self._trials:
                self._trials = _trials(client, options.suite)
            chosen = trial or self._trials[int(random.integers(len(self._trials)))]
            return PracticeRequest(suite=options.suite, trial=chosen, track=options.track)
        if trial is not None:
            raise OptionError(f"options: the trial {trial!r} needs an environment that was made with its suite")
        if options.task is not None:  # a journey may begin anywhere
            approach, weather = options.approach, options.draw_weather(random)
            seed = options.draw_seed(random)
        else:
            self._approaches = self._approaches or self._suitable(client)
            approach = self._approaches[int(random.integers(len(self._approaches)))]
            seed, weather = options.draw_seed(random), options.draw_weather(random)
        return PracticeRequest.model_validate(
            {
                "town": self._town,
                "approach": approach,
                "task": options.task,
                "route": options.route,
                "fault": options.fault,
                "weather": weather,
                "traffic": options.traffic,
                "seed": seed,
                "track": options.track,
            }
        )

    def _suitable(self, client: Client) -> tuple[str, ...]:
        """Return the town's approaches that have the route and where the fault can be applied.

        If the fault can be applied nowhere, it returns all approaches: the service then says why it refuses the fault,
        for example that it is not built yet.
        """
        approaches = client.town(self._town).approaches
        if all(self._options.fault.kind not in one.faults for one in approaches):
            return tuple(sorted(one.id for one in approaches))
        found = tuple(sorted(one.id for one in approaches if self._suits(one)))
        if not found:
            offered = ", ".join(sorted({kind for one in approaches for kind in one.faults}))
            raise OptionError(
                f"fault: {self._options.fault.kind} can be applied at no such approach of {self._town}, "
                f"whose approaches offer {offered}; take another"
            )
        return found

    def _suits(self, approach: ApproachDetail) -> bool:
        options = self._options
        return options.fault.kind in approach.faults and (options.route is None or options.route in approach.exits)


def _trials(client: Client, suite: str) -> tuple[str, ...]:
    """Return the ids of a suite's open trials and of their twins."""
    found = tuple(name for one in client.trials(suite) for name in (one.id, one.twin) if name)
    if not found:
        raise OptionError(f"suite: {suite} shows no trials for practice; take another")
    return found
