"""Trials of one fault at doses that are chosen as outcomes come in."""

import random
from collections.abc import Iterator, Sequence
from typing import Final

from wrongturn_agents.batch.group import Group, drive_group
from wrongturn_agents.errors import RunError
from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.errors import NetworkError
from wrongturn_networks.faults import Dose, check_fault, fault_class
from wrongturn_networks.loading import load_town
from wrongturn_networks.starts import draw_trial
from wrongturn_protocol import Fault, FaultKind, JunctionType, Track, Trial
from wrongturn_statistics.dose_file import DoseFile, DoseTrial
from wrongturn_statistics.dose_response import DoseResponse

_SEEDS: Final = 2**31


def dose_of(kind: FaultKind, low: float | None, high: float | None, track: Track) -> Dose:
    """Return what a fault's dose means, in the range that is asked for.

    Raises RunError if it has none, the range does not fit, or agents of the track cannot notice it.
    """
    built = fault_class(kind)
    dose = built.dose
    if dose is None:
        raise RunError(f"--fault: {kind} has no dose; take another")
    if issubclass(built, Disturbance) and track not in built.tracks:
        raise RunError(f"--fault: agents of the track {track} do not notice {kind}; take another")
    for name, value in (("--low", low), ("--high", high)):
        wrong = dose.refusal("dose", value)
        if wrong is not None:
            raise RunError(f"{name}: {wrong.partition(': ')[2]}")
    found = dose._replace(low=dose.low if low is None else low, high=dose.high if high is None else high)
    if found.low >= found.high:
        raise RunError(f"--low: is {found.low:g}, and --high is {found.high:g}; give a range")
    return found


def counted_by(kind: FaultKind) -> str:
    """Return what counts as a failure: a command that is right must also be followed."""
    return "not completed" if issubclass(fault_class(kind), Disturbance) else "unsafe"


class DoseRun:
    """Drives trials one after another, each at the dose that tells most, and fits the outcomes.

    Types of junctions take turns, and of each type its approaches, in an order that the seed draws. Only approaches
    at which the fault can be applied at both ends of the range are used. Drives go one after another, because each
    dose depends on all outcomes before it.

    Args:
        agent: As :func:`wrongturn_agents.registry.resolve` takes it.
        folder: Working directory of the command, where a class of the user's is found.
        dose: What the dose means, and its range.
        file: What has been driven.

    Raises:
        RunError: No approach of a type takes the fault over the whole range.
        NetworkError: There is no such town.
    """

    def __init__(self, agent: str, folder: str, dose: Dose, file: DoseFile) -> None:
        self.file = file
        self._agent, self._folder, self._dose = agent, folder, dose
        self._response = DoseResponse(dose)
        self._places = [self._places_of(kind) for kind in file.types]
        for trial in file.trials:
            self._response.add(trial.dose, failed=trial.failed)

    def drive(self, trials: int) -> Iterator[DoseFile]:
        """Drive until there are so many trials, and yield the file after each.

        Raises AgentsError if the agent fails, and SimError if the simulation does.
        """
        while len(self.file.trials) < trials:
            trial = self._next()
            assert trial.fault.dose is not None
            result = drive_group(Group(0, self._agent, self._folder, (trial,)))[trial.id]
            failed = result.unsafe_strict if self.file.counted == "unsafe" else not result.completed
            self._response.add(trial.fault.dose, failed=failed)
            driven = DoseTrial(
                trial=trial.id,
                dose=trial.fault.dose,
                junction_type=trial.junction_type,
                verdict=result.verdict,
                failed=failed,
            )
            self.file = self.file.model_copy(
                update={
                    "trials": (*self.file.trials, driven),
                    "d50": self._response.d50()._asdict(),
                    "side": self._response.side(),
                    "width": self._response.width()._asdict(),
                }
            )
            yield self.file

    def _next(self) -> Trial:
        number = len(self.file.trials)
        turn, kind = divmod(number, len(self._places))
        lap, place = divmod(turn, len(self._places[kind]))
        order = random.Random(f"dose {self.file.seed} {self.file.types[kind]} {lap}")
        town, approach = order.sample(self._places[kind], len(self._places[kind]))[place]
        seed = random.Random(f"dose {self.file.seed} {number}").randrange(_SEEDS)
        return draw_trial(load_town(town), approach, self._fault(self._response.best()), seed)

    def _fault(self, dose: float) -> Fault:
        return Fault(kind=self.file.fault, dose=dose)

    def _places_of(self, kind: JunctionType) -> Sequence[tuple[str, str]]:
        """Return town and approach of all places that take both ends of the range."""
        found = []
        why = f"{', '.join(self.file.towns)} has no approach of this type"
        for name in self.file.towns:
            town = load_town(name)
            for approach in (one for one in town.approaches if town.approach(one).type is kind):
                try:
                    for end in (self._dose.low, self._dose.high):
                        check_fault(draw_trial(town, approach, self._fault(end), 0))
                except NetworkError as error:
                    why = str(error)
                else:
                    found.append((name, approach))
        if not found:
            raise RunError(f"--type: {kind} has no place for {self.file.fault} ({why}); narrow --low and --high")
        return found
