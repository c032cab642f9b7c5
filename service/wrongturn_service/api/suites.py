"""Suites and their trials."""

from fastapi import APIRouter, Response

from wrongturn_networks.catalogue import list_suites
from wrongturn_protocol import SuiteDetail, SuiteList, TrialList
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import ServiceDep, made_once
from wrongturn_service.api.documents import Route, described

router = APIRouter(prefix="/v1/suites", tags=["suites"], route_class=Route)


@router.get("", **described(SuiteList))
async def suites(service: ServiceDep) -> Response:
    """List all suites."""
    return await made_once(service, "suites", lambda: SuiteList(suites=tuple(list_suites())))


@router.get("/{suite}", **described(SuiteDetail, 404))
async def suite(service: ServiceDep, suite: str) -> Response:
    """Show one suite, such as ``wrong-command@2``, and the cells from which each evaluation draws its trials."""
    return await made_once(service, f"suite {suite}", lambda: catalogue.suite(suite).detail())


@router.get("/{suite}/trials", **described(TrialList, 404))
async def trials(service: ServiceDep, suite: str) -> Response:
    """List the suite's trials for practice. Each names its twin, which can be practised too.

    If every evaluation draws its own trials, these are those of the open draw, and ``draw`` says so.
    """
    return await made_once(service, f"trials {suite}", lambda: catalogue.suite(suite).trial_list())
