"""Replies to steps, of open episodes and of those that are over."""

import orjson

from wrongturn_protocol import Track, Verdict
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.pool.actions import ACTION
from wrongturn_service.pool.pool import Frame
from wrongturn_service.storage.models import EpisodeRow
from wrongturn_service.wire import Reply, Wire, step_reply


def step_reply_of(episode: OpenEpisode, frame: Frame, wire: Wire) -> Reply:
    """The reply to the last of an open episode's actions."""
    return step_reply(
        len(episode.actions) // ACTION.size,
        frame.observation,
        wire,
        episode.track,
        terminated=frame.terminated,
        truncated=frame.truncated,
        reward=frame.reward if episode.practice else None,
        verdict=frame.final.outcome.verdict if episode.practice and frame.final is not None else None,
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
