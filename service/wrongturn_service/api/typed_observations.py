"""Schemas of observations in the OpenAPI document, from the table that the service encodes them by."""

from typing import Any, Final

from wrongturn_protocol import Track
from wrongturn_protocol.observations import json_schema

COMPONENTS: Final = {track: f"{track.capitalize()}Observation" for track in Track}
"""Name of each track's schema."""


def add_observations(schemas: dict[str, Any]) -> None:
    """Add a schema for each track to an OpenAPI document's schemas, and name them where an observation is sent."""
    for track, name in COMPONENTS.items():
        schemas[name] = json_schema(track)
    observation = {
        "description": "What the agent is shown, by its track.",
        "oneOf": [_reference(name) for name in COMPONENTS.values()],
    }
    for reply in ("EpisodeReply", "StepReply"):
        schemas[reply]["properties"]["observation"] = observation
    last = schemas["EpisodeDetail"]["properties"]["last_reply"]
    last["anyOf"] = [_reference("EpisodeReply"), _reference("StepReply"), {"type": "null"}]


def _reference(name: str) -> dict[str, str]:
    return {"$ref": f"#/components/schemas/{name}"}
