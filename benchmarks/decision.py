"""How long one decision takes in process, against bare libsumo calls.

A decision is ``Episode.step`` in the track ``state``, ego alone, unwrapped: two sub-steps of 0.05 s with their
judgement, the recorded rows, the route's command, the reward and a fresh observation. The bare calls are two
``vehicle.moveToXY`` and two ``simulationStep`` to the same places. Both run by turns in one process and
are timed by the processor time of their thread, so that a busy machine slows both alike; the figure is the median of
the rounds' ratios.

A car that drives alone needs no SUMO; the bare calls then have one other car. With traffic both sides carry it: the
ratio then tells what seeing, recording and judging the others costs beside SUMO's driving them.

    python benchmarks/decision.py [--rounds 60] [--town junctions] [--vehicles 0] [--pedestrians 0] [--json FILE]
"""

import math
import statistics
import time

from common import finish, parser

from wrongturn_networks import draw_trial, load_town
from wrongturn_protocol import VEHICLE, FaultKind, Start, Track, Traffic
from wrongturn_sim.ego import SUB_STEPS
from wrongturn_sim.episode import Episode
from wrongturn_sim.simulator import EGO, KEEP_ROUTE, load_libsumo

DECISIONS = 30
"""Of each round: three seconds, which end before any verdict falls."""
ACTION = (0.0, 0.3, 0.0)
ONE = Traffic(vehicles=1)
START = Start(distance=25.0, speed=5.0, lateral=0.0, yaw=0.0)


def drive(episode: Episode) -> float:
    """Seconds that a decision takes through the episode."""
    episode.reset()
    step = episode.step
    begin = time.thread_time()
    for _ in range(DECISIONS):
        step(*ACTION)
    return (time.thread_time() - begin) / DECISIONS


def bare(calls: list[tuple[str, str, int, float, float, float, int]]) -> float:
    """Seconds that the bare calls of a decision take."""
    sumo = load_libsumo()
    move, step = sumo.vehicle.moveToXY, sumo.simulationStep
    begin = time.thread_time()
    for call in calls:
        move(*call)
        step()
    return (time.thread_time() - begin) / (len(calls) / SUB_STEPS)


def measure(town_name: str, rounds: int, traffic: Traffic) -> dict[str, float]:
    """Microseconds a decision, both ways, and their ratio."""
    town = load_town(town_name)
    trial = draw_trial(town, min(town.approaches), FaultKind.NONE, 1, traffic=traffic)
    trial = trial.model_copy(update={"start": START})
    episode = Episode(trial, Track.STATE)
    beside = Episode(trial.model_copy(update={"traffic": traffic if traffic != Traffic() else ONE}), Track.STATE)
    drive(episode)
    calls = [
        (
            EGO,
            "",
            0,
            row.x + VEHICLE.half_length * math.cos(row.yaw),
            row.y + VEHICLE.half_length * math.sin(row.yaw),
            90.0 - math.degrees(row.yaw),
            KEEP_ROUTE,
        )
        for row in episode.trajectory.rows[1:]
    ]
    pairs = []
    for _ in range(rounds):
        ours = drive(episode)
        beside.reset()
        pairs.append((ours, bare(calls)))
    decision, calls_alone = (statistics.median(values) * 1e6 for values in zip(*pairs, strict=True))
    return {
        "decision_us": decision,
        "bare_us": calls_alone,
        "ratio": statistics.median(ours / theirs for ours, theirs in pairs),
    }


def main() -> None:
    options = parser(__doc__)
    options.add_argument("--rounds", type=int, default=60)
    options.add_argument("--town", default="junctions")
    options.add_argument("--vehicles", type=int, default=0)
    options.add_argument("--pedestrians", type=int, default=0)
    arguments = options.parse_args()
    rounds = 2 if arguments.short else arguments.rounds
    traffic = Traffic(vehicles=arguments.vehicles, pedestrians=arguments.pedestrians)
    figures = measure(arguments.town, rounds, traffic)
    print(
        f"one decision {figures['decision_us']:.1f} us, bare libsumo calls {figures['bare_us']:.1f} us: "
        f"ratio {figures['ratio']:.2f} (at most 2)"
    )
    finish(figures, arguments)


if __name__ == "__main__":
    main()
