"""Drive a suite by a client that openapi-python-client makes of the service's own description.

Start a service (`wrongturn serve`), then:

    openapi-python-client generate --url http://127.0.0.1:8000/openapi.json
    pip install ./wrongturn-api-client
    python docs/examples/generated_client.py http://127.0.0.1:8000 my-generated-agent
"""

import math
import sys

from wrongturn_api_client import AuthenticatedClient, Client
from wrongturn_api_client.api.agents import register_agent
from wrongturn_api_client.api.episodes import step_episode
from wrongturn_api_client.api.evaluations import begin_episode, begin_evaluation, get_evaluation
from wrongturn_api_client.api.leaderboards import get_leaderboard
from wrongturn_api_client.models import (
    Action,
    AgentRegistration,
    EvaluationRequest,
    PrivilegedObservation,
    Problem,
    StepRequest,
    Track,
)


class Driver:
    """Follow the lane and the commanded exit at 5 m/s; where there is no such exit, take another."""

    def __init__(self) -> None:
        self.path: list[list[float]] = []
        self.chosen = False

    def act(self, seen: PrivilegedObservation) -> Action:
        """Steer for a point of the path 4 m ahead of the rear axle (pure pursuit)."""
        if not self.chosen:
            open_exits = [way for way, there in zip(seen.exits, seen.exits_mask, strict=True) if there]
            if seen.command in (1, 2, 3) and seen.exits_mask[seen.command - 1]:
                open_exits.insert(0, seen.exits[seen.command - 1])
            self.path = seen.lane + (open_exits[0] if open_exits else [])
            self.chosen = 0 <= seen.stop_line < 1
        x, y, yaw = seen.pose
        x, y = x - 1.45 * math.cos(yaw), y - 1.45 * math.sin(yaw)
        away = [math.dist((x, y), point) for point in self.path]
        nearest = away.index(min(away))
        goal = next((i for i in range(nearest, len(away)) if away[i] > 4), len(away) - 1)
        dx, dy = self.path[goal][0] - x, self.path[goal][1] - y
        aside = math.cos(yaw) * dy - math.sin(yaw) * dx
        wheel = math.atan(5.8 * aside / max(away[goal], 1) ** 2)
        push = 5 - seen.speed
        steer = max(-1.0, min(1.0, -wheel / math.radians(35)))
        return Action(steer=steer, throttle=max(0.0, min(1.0, push)), brake=max(0.0, min(1.0, -push)))


def main(url: str, name: str, suite: str = "smoke@3") -> None:
    """Register an agent, drive its evaluation to the end and print its place."""
    registration = AgentRegistration(name=name, track=Track.PRIVILEGED)
    agent = register_agent.sync(client=Client(url, timeout=60), body=registration)
    if isinstance(agent, Problem):
        raise SystemExit(agent.detail)
    client = AuthenticatedClient(url, agent.token, timeout=60)
    evaluation = begin_evaluation.sync(client=client, body=EvaluationRequest(suite=suite)).id
    while True:
        episode = begin_episode.sync(evaluation, client=client)
        if isinstance(episode, Problem):
            if episode.type_ == "/problems/evaluation-finished":
                break
            raise SystemExit(episode.detail)
        driver, reply, seq, over = Driver(), episode, 0, False
        while not over:
            seq += 1
            step = StepRequest(seq=seq, action=driver.act(reply.observation))
            reply = step_episode.sync(episode.id, client=client, body=step)
            over = reply.terminated or reply.truncated
    print(get_evaluation.sync(evaluation, client=client).state)
    entries = get_leaderboard.sync(suite, client=client).entries
    print(f"rank {next(entry.rank for entry in entries if entry.agent.name == name)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
