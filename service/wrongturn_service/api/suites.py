"""Suites and their trials."""

from fastapi import APIRouter, Response

from wrongturn_networks import catalog
from wrongturn_protocol import SuiteList, SuiteSummary, TrialList
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import reply
from wrongturn_service.api.documents import described

router = APIRouter(prefix="/v1/suites", tags=["suites"])


@router.get("", **described(SuiteList))
async def suites() -> Response:
    """All suites."""
    return reply(SuiteList(suites=tuple(catalog.list_suites())))


@router.get("/{suite}", **described(SuiteSummary, 404))
async def suite(suite: str) -> Response:
    """One suite, by its id such as ``wrong-command@1``."""
    return reply(catalogue.suite(suite).summary())


@router.get("/{suite}/trials", **described(TrialList, 404))
async def trials(suite: str) -> Response:
    """The trials of the open split, for practice; each names its twin, which can be practised too."""
    return reply(catalogue.suite(suite).trial_list())
