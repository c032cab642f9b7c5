"""The lists of agents, suites and towns, of a service or of the packages installed here."""

from typing import Any, Literal

from rich.table import Table

from wrongturn_client.client import Client
from wrongturn_client.errors import WrongturnError
from wrongturn_client.plugins import LISTINGS, LOADERS, entry_points, load
from wrongturn_client.tables import head
from wrongturn_protocol import Command, JunctionType
from wrongturn_protocol.words import COMMANDS, name

Listed = Literal["agents", "suites", "towns"]
_PART = {"agents": "wrongturn-agents", "suites": "wrongturn-networks", "towns": "wrongturn-networks"}


def listing(what: Listed, url: str | None) -> list[dict[str, Any]]:
    """Return the items of a list as plain values: a service's, or without a URL those installed here."""
    if url is not None:
        with Client(url, patience=0) as client:
            return [item.model_dump(mode="json", exclude_none=True) for item in getattr(client, what)()]
    point = entry_points(LISTINGS).get(what)
    if point is None:
        raise _not_installed(what)
    return [item.model_dump(mode="json", exclude_none=True) for item in load(point)()]


def approaches(town: str, url: str | None) -> dict[str, Any]:
    """Return a town's name, checksum and approaches by type, as plain values, from where :func:`listing` looks."""
    if url is not None:
        with Client(url, patience=0) as client:
            found = client.town(town)
    else:
        point = entry_points(LOADERS).get("town")
        if point is None:
            raise _not_installed("towns")
        found = load(point)(town).detail({})
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
    table = _table("type", "approach", "exits", "lane m")
    table.columns[-1].justify = "right"
    for one in town["approaches"]:
        exits = ", ".join(COMMANDS[Command(direction)] for direction in one["exits"])
        table.add_row(name(one["type"]), one["id"], exits, f"{one['lane_length']:.0f}")
    return table


def listing_table(what: Listed, items: list[dict[str, Any]]) -> Table:
    """Return the items as a table."""
    return {"agents": _agents, "suites": _suites, "towns": _towns}[what](items)


def _agents(items: list[dict[str, Any]]) -> Table:
    table = _table("agent", "track", "kind", "what it does")
    for item in items:
        table.add_row(item["name"], item["track"], item["kind"], item.get("description", ""))
    return table


def _suites(items: list[dict[str, Any]]) -> Table:
    table = _table("suite", "title", "trials", "twins", "tracks", "sha256")
    for item in items:
        counts = (str(item["trials"]), str(item["twins"]))
        tail = (", ".join(item["tracks"]), item["sha256"][:12])
        table.add_row(item["id"], item["title"], *counts, *tail)
    return table


def _towns(items: list[dict[str, Any]]) -> Table:
    table = _table("town", "junctions")
    for kind in JunctionType:
        table.add_column(head(kind), justify="right")
    table.add_column("sha256")
    for item in items:
        counts = (str(item["approaches"].get(kind.value, 0)) for kind in JunctionType)
        table.add_row(item["name"], str(item["junctions"]), *counts, item["sha256"][:12])
    return table


def _not_installed(what: Listed) -> WrongturnError:
    return WrongturnError(
        f"no {what} are installed here; install {_PART[what]}, or name a service by --url or WRONGTURN_URL"
    )


def _table(*heads: str) -> Table:
    return Table(*heads, box=None, header_style="bold", pad_edge=False)
