"""The agents' pages: who they are, what they did, and where they fail."""

import asyncio
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, Final

from fastapi import APIRouter, Query, Request, Response

from wrongturn_networks import suite_ids
from wrongturn_protocol import FaultKind, JunctionType, Metrics, ProblemType, Safety, TableCell, Verdict
from wrongturn_protocol.standing_rows import breakdown_rows
from wrongturn_protocol.vocabulary import Collection
from wrongturn_service import catalogue
from wrongturn_service.accounts import detail
from wrongturn_service.api.dependencies import ServiceDep
from wrongturn_service.errors import InvalidRequestError, NotFoundError
from wrongturn_service.storage.finished import FinishedEpisode
from wrongturn_service.storage.models import AgentRow, EvaluationRow
from wrongturn_service.web import junction_map, words
from wrongturn_service.web.driven import Pair, driven_evaluation
from wrongturn_service.web.front import FIRST
from wrongturn_service.web.page import numbered_page, page, rendered, sent

router = APIRouter(include_in_schema=False)
_ROWS: Final = 100
_OTHERS: Final = 100
"""Agents that are offered for a comparison."""
_UNSAFE: Final = "unsafe"
"""Value of the filter by verdict that stands for all unsafe verdicts."""
Filter = Annotated[str, Query(max_length=80)]


@router.api_route("/agents", methods=["GET", "HEAD"])
async def agents(
    request: Request,
    service: ServiceDep,
    wanted: Annotated[str, Query(alias="page", max_length=40)] = "1",
    everybody: Annotated[bool, Query(alias="all")] = False,
) -> Response:
    """List the agents by name, some on each page: those that have begun an evaluation, or all of them."""

    async def render() -> bytes:
        evaluated, registered = await service.finished.agent_counts()
        total = registered if everybody else evaluated
        pages = max(-(-total // _ROWS), 1)
        number = numbered_page(wanted, pages)
        rows = await service.finished.agents(everybody=everybody, offset=(number - 1) * _ROWS, limit=_ROWS)
        return await asyncio.to_thread(
            rendered,
            "agents.html",
            request.url.path,
            agents=[(detail(row), suites) for row, suites in rows],
            total=total,
            everybody=everybody,
            unevaluated=registered - evaluated,
            number=number,
            pages=pages,
            words=words,
        )

    return sent(request, await service.lists.get(("page", request.url.path, wanted, everybody), render))


@router.api_route("/agents/{agent}", methods=["GET", "HEAD"])
async def agent(
    request: Request,
    service: ServiceDep,
    agent: str,
    suite: Filter = "",
    evaluation: Filter = "",
    verdict: Filter = "",
    fault: Filter = "",
    junction: Filter = "",
) -> Response:
    """Show an agent, and what it did on one suite.

    Without a suite it is the paper's, or the one that was driven last; without an evaluation, the one that counts. Only
    trials with the verdict (or all ``unsafe`` ones), the fault and the junction type are listed.
    """
    found = await service.accounts.shown(Collection.AGENTS, agent, None)
    assert isinstance(found, AgentRow)
    # A suite's package may have been uninstalled since.
    rows = [row for row in await service.finished.of_agent(agent) if row.suite in suite_ids()]
    counting = await service.finished.counting(agent)
    row = _shown(rows, suite, evaluation)
    values: dict[str, Any] = {
        "agent": detail(found),
        "suites": _suites(rows),
        "evaluations": rows[::-1],
        "words": words,
    }
    values |= {"counting": counting, "finished": finished, "running": await service.finished.running(agent)}
    if row is None:
        wanted = catalogue.suite(suite) if suite else None
        return page(request, "agent.html", row=None, suite=wanted, **values)
    entries = (await service.leaderboards.board(row.suite)).entries
    driven = await driven_evaluation(service, row.id)
    assert row.metrics is not None
    metrics = Metrics.model_validate_json(row.metrics)
    faults = _worst_first(metrics)
    choices = _choices(driven.pairs)
    filters = {
        "verdict": _choice("verdict", verdict, [_UNSAFE, *Verdict], [_UNSAFE, *choices["verdict"]]),
        "fault": _choice("fault", fault, FaultKind, choices["fault"]),
        "junction": _choice("junction", junction, JunctionType, choices["junction"]),
    }
    pairs = [pair for pair in driven.pairs if _passes(pair, filters)]
    return await asyncio.to_thread(
        page,
        request,
        "agent.html",
        row=row,
        suite=catalogue.suite(row.suite),
        metrics=metrics,
        faults=faults,
        table=_table(metrics, faults),
        breakdown=breakdown_rows(metrics),
        entry=next((entry for entry in entries if entry.evaluation == row.id), None),
        others=[entry.agent for entry in entries if entry.evaluation not in {None, row.id}][:_OTHERS],
        driven=driven,
        verdicts=[verdict for verdict in Verdict if any(counts.get(verdict) for counts in metrics.verdicts.values())],
        filters=filters,
        choices=choices,
        pairs=pairs,
        unsafe=[pair for pair in pairs if words.side(pair.trial.outcome) is Safety.UNSAFE],
        map=junction_map,
        **values,
    )


def _shown(rows: Sequence[EvaluationRow], suite: str, evaluation: str) -> EvaluationRow | None:
    """Return the evaluation that is shown; None if there is none on the suite. Raises NotFoundError."""
    if evaluation:
        for row in rows:
            if row.id == evaluation:
                return row
        message = f"evaluation: this agent has no finished evaluation {evaluation!r}"
        raise NotFoundError(ProblemType.UNKNOWN_EVALUATION, message)
    first = {row.suite: row for row in reversed(rows)}
    if suite:
        return first.get(suite)
    return first.get(FIRST) or (first[rows[-1].suite] if rows else None)


def _suites(rows: Iterable[EvaluationRow]) -> list[str]:
    return sorted({row.suite for row in rows}, key=lambda suite: (suite != FIRST, suite))


def finished(row: EvaluationRow) -> str:
    """Return when an evaluation was finished."""
    return datetime.fromtimestamp(row.finished or row.created, UTC).strftime("%d %B %Y, %H:%M UTC")


def _worst_first(metrics: Metrics) -> list[str]:
    """Return the table's faults, those with most unsafe trials first."""
    rows = (metrics.table_strict or metrics.table).values()
    faults = list(next(iter(metrics.table.values()), {}))
    return sorted(faults, key=lambda fault: -sum(row[fault].unsafe for row in rows if fault in row))


def _table(metrics: Metrics, faults: Sequence[str]) -> list[tuple[str, list[TableCell]]]:
    """Return the rows of the table, most unsafe ones first, and their sum: for each fault strict cell and paper's.

    A cell without trials is one that old results do not have.
    """
    none = TableCell(unsafe=0, trials=0)
    rows: list[tuple[str, list[TableCell]]] = []
    for kind, cells in metrics.table.items():
        strict = metrics.table_strict[kind] if metrics.table_strict else {}
        rows.append((kind, [cell for fault in faults for cell in (strict.get(fault, none), cells[fault])]))
    rows.sort(key=lambda row: -sum(cell.unsafe for cell in row[1][::2]))
    columns = zip(*(cells for _, cells in rows), strict=True)
    total = [
        TableCell(unsafe=sum(cell.unsafe for cell in column), trials=sum(cell.trials for cell in column))
        for column in columns
    ]
    return [*rows, ("all", total)]


def _choice(field: str, value: str, allowed: Iterable[str], there: Iterable[str]) -> str:
    """Return a filter's value, which need not fit any trial. Raises InvalidRequestError, with those that do."""
    if value and value not in set(allowed):
        raise InvalidRequestError(field, f"is not one of {', '.join(there)}")
    return value


def _choices(pairs: Iterable[Pair]) -> dict[str, list[str]]:
    """Return what the trials can be filtered by."""
    trials = [pair.trial for pair in pairs]
    present = {word for one in trials for word in _words_of(one).values()}
    vocabulary: dict[str, Iterable[str]] = {"verdict": Verdict, "fault": FaultKind, "junction": JunctionType}
    return {field: [word for word in known if word in present] for field, known in vocabulary.items()}


def _words_of(episode: FinishedEpisode) -> dict[str, str]:
    trial = episode.trial
    return {"verdict": episode.outcome.verdict, "fault": trial.fault.kind, "junction": trial.junction_type}


def _passes(pair: Pair, filters: Mapping[str, str]) -> bool:
    unsafe = words.side(pair.trial.outcome) is Safety.UNSAFE
    found = _words_of(pair.trial)
    return all(
        not wanted or wanted == found[field] or (wanted == _UNSAFE and unsafe) for field, wanted in filters.items()
    )
