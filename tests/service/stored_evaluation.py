"""Evaluations that are put into the database without driving, so that pages have something to show."""

import json
import math
import time
import zlib
from collections.abc import Callable

from wrongturn_judge.metrics import compute
from wrongturn_networks import Suite, load_town
from wrongturn_protocol import EvaluationState, JourneyOutcome, Outcome, Trial, Verdict
from wrongturn_service.service import Service
from wrongturn_service.storage.evaluations import prepare_evaluation
from wrongturn_service.storage.models import EpisodeRow, EvaluationRow, TrajectoryRow
from wrongturn_service.tokens import new_id

Judge = Callable[[Trial], Outcome]


def outcome(verdict: Verdict, **values: object) -> Outcome:
    return Outcome.model_validate({"verdict": verdict, "time": 9.5, "max_deceleration": 1.0, **values})


def exits(trial: Trial) -> Outcome:
    """Let each trial end at its route's exit, and each journey at its goal."""
    if trial.journey is None:
        return outcome(Verdict.EXIT_COMMANDED, exit=trial.route)
    figures = JourneyOutcome(distance=100, completion=1, junctions=1, off_road=0, wrong_lane=0, collisions=0)
    return outcome(Verdict.ARRIVED, journey=figures)


async def store_evaluation(
    service: Service,
    agent: str,
    suite: Suite,
    judge: Judge = exits,
    *,
    secret: str = "a secret",
    state: EvaluationState = EvaluationState.FINISHED,
    trajectories: bool = True,
) -> str:
    """Store an evaluation with all of its episodes, and return its id."""
    draw, now = suite.draw(secret), time.time()
    outcomes = {trial.id: judge(trial) for trial in draw.episodes}
    evaluation = EvaluationRow(
        id=new_id("ev"),
        agent_id=agent,
        suite=suite.id,
        suite_sha256=suite.sha256,
        entry="remote",
        state=state.value,
        secret=secret,
        trials=len(draw.episodes),
        created=now,
        finished=now if state is EvaluationState.FINISHED else None,
        metrics=compute(draw, outcomes).model_dump_json() if state is EvaluationState.FINISHED else None,
        driven=now,
    )
    rows: list[EpisodeRow | TrajectoryRow] = []
    for number, trial in enumerate(draw.episodes, 1):
        found = outcomes[trial.id]
        row = EpisodeRow(
            id=new_id("ep"),
            evaluation_id=evaluation.id,
            agent_id=agent,
            trial_id=trial.id,
            trial=trial.model_dump_json(),
            track="privileged",
            state="finished",
            created=now + number,
            finished=now + number,
            verdict=found.verdict.value,
            outcome=found.model_dump_json(),
            steps=95,
            seq=number,
        )
        rows.append(row)
        if trajectories:
            body = json.dumps(straight_on(trial)).encode()
            rows.append(TrajectoryRow(episode_id=row.id, sha256="0" * 64, size=len(body), data=zlib.compress(body)))
    async with service.store._database.write() as session:
        await prepare_evaluation(session, evaluation)
        session.add(evaluation)
        await session.flush()
        session.add_all([row for row in rows if isinstance(row, EpisodeRow)])
        await session.flush()
        session.add_all([row for row in rows if isinstance(row, TrajectoryRow)])
    service.leaderboards.forget(suite.id)
    return evaluation.id


def straight_on(trial: Trial) -> dict[str, list[float]]:
    """Return the columns of a drive along the approach's axis, from 30 m before the stop line to 20 m past it."""
    approach = load_town(trial.town).approach(trial.approach)
    way = [step / 2 - 30 for step in range(101)]
    x, y = approach.stop_line
    return {
        "x": [x + metres * math.cos(approach.heading) for metres in way],
        "y": [y + metres * math.sin(approach.heading) for metres in way],
    }
