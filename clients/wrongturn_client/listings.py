"""The lists of agents, suites and towns, of a service or of the packages installed here."""

from typing import Any, Literal

from rich.table import Table

from wrongturn_client.client import Client
from wrongturn_client.errors import WrongturnError
from wrongturn_client.plugins import LISTINGS, LOADERS, entry_points, load
from wrongturn_client.tables import head, list_table
from wrongturn_protocol import Command, JunctionType
from wrongturn_protocol.installing import install
from wrongturn_protocol.words import COMMANDS, name

Listed = Literal["agents", "suites", "towns"]
_PART = {"agents": "wrongturn-agents", "suites": "wrongturn-networks", "towns": "wrongturn-networks"}


def listing(what: Listed, url: str | None) -> list[dict[str, Any]]:
    """Return the items of a list as plain values: a service's, or without a URL those installed here."""
    if url is not None:
        with Client(url, patience=0) as client:
            return [item.model_dump(mode="json", exclude_none=True) for item in getattr(client, what)()]
    return [item.model_dump(mode="json", exclude_none=True) for item in _provided(LISTINGS, what, what)()]


def approaches(town: str, url: str | None) -> dict[str, Any]:
    """Return a town's name, checksum and approaches by type, as plain values, from where :func:`listing` looks."""
    if url is not None:
        with Client(url, patience=0) as client:
            found = client.town(town)
    else:
        found = _provided(LOADERS, "town", "towns")(town).detail({})
    kinds = list(JunctionType)
    ordered = sorted(found.approaches, key=lambda one: kinds.index(one.type))
    # Which faults suit an approach is known to a service alone, and the same list is given without one.
    return {
        "name": found.name,
        "sha256": found.sha256,
        "approaches": [one.model_dump(mode="json", exclude={"faults"}) for one in ordered],
    }


def approaches_table(town: dict[str, Any]) -> Table:
    """Return a town's approaches, as :func:`approaches` gives them, as a table: a row for each."""
    rows = []
    for one in town["approaches"]:
        exits = ", ".join(COMMANDS[Command(direction)] for direction in one["exits"])
        rows.append((name(one["type"]), one["id"], exits, f"{one['lane_length']:.0f}"))
    return list_table(("type", "approach", "exits", "lane m"), rows, right={"lane m"})


def listing_table(what: Listed, items: list[dict[str, Any]]) -> Table:
    """Return the items as a table."""
    rows: list[tuple[str, ...]] = []
    if what == "agents":
        rows = [(item["name"], item["track"], item["kind"], item.get("description", "")) for item in items]
        return list_table(("agent", "track", "kind", "what it does"), rows)
    if what == "suites":
        for item in items:
            counts = (str(item["trials"]), str(item["twins"]))
            rows.append((item["id"], item["title"], *counts, ", ".join(item["tracks"]), item["sha256"][:12]))
        return list_table(("suite", "title", "trials", "twins", "tracks", "sha256"), rows)
    kinds = list(map(head, JunctionType))
    for item in items:
        numbers = (str(item["approaches"].get(kind.value, 0)) for kind in JunctionType)
        rows.append((item["name"], str(item["junctions"]), *numbers, item["sha256"][:12]))
    return list_table(("town", "junctions", *kinds, "sha256"), rows, right=kinds)


def _provided(group: str, name: str, what: Listed) -> Any:
    """Return what another part provides for lists without a service."""
    point = entry_points(group).get(name)
    if point is None:
        raise WrongturnError(
            f"no {what} are installed here; name a service by --url or WRONGTURN_URL, or run: {install(_PART[what])}"
        )
    return load(point)
