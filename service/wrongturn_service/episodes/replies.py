"""Replies to steps, of open episodes and of those that are over."""

import orjson

from wrongturn_protocol import Track, Verdict
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.pool.pool import Frame
from wrongturn_service.pool.screen import Shown
from wrongturn_service.storage.models import EpisodeRow
from wrongturn_service.wire import Reply, Wire, step_reply


def step_reply_of(episode: OpenEpisode, frame: Frame, wire: Wire) -> Reply:
    """The reply to an open episode's next step."""
    return step_reply(
        episode.seq + 1,
        frame.observation,
        wire,
        episode.track,
        terminated=frame.terminated,
        truncated=frame.truncated,
        reward=frame.reward if episode.practice else None,
        verdict=frame.final.outcome.verdict if episode.practice and frame.final is not None else None,
    )


def next_reply(episode: OpenEpisode, observation: Shown, reward: float, seq: int) -> Reply:
    """The reply to a step after which the episode goes on, encoded as the last one.

    Args:
        episode: which.
        observation: what was shown after it.
        reward: of it.
        seq: its sequence number.
    """
    return step_reply(
        seq,
        observation,
        episode.last.wire,
        episode.track,
        terminated=False,
        truncated=False,
        reward=reward if episode.practice else None,
        verdict=None,
    )


def stored_reply(row: EpisodeRow, body: bytes) -> Reply:
    """The reply to a finished episode's last step.

    Args:
        row: the episode's.
        body: JSON, as it is stored.
    """
    message = orjson.loads(body)
    return step_reply(
        message["seq"],
        orjson.dumps(message["observation"]),
        Wire.JSON,
        Track(row.track),
        terminated=message["terminated"],
        truncated=message["truncated"],
        reward=message.get("reward"),
        verdict=Verdict(message["verdict"]) if "verdict" in message else None,
    )
