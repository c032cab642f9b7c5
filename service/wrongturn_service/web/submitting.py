"""The page that says how to hand in an agent, with commands that carry this service's address."""

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from wrongturn_networks.catalogue import list_suites
from wrongturn_service import catalogue
from wrongturn_service.api.dependencies import ServiceDep
from wrongturn_service.settings import Registration
from wrongturn_service.web.front import FIRST
from wrongturn_service.web.page import page, public_url

router = APIRouter(include_in_schema=False)


@router.api_route("/submit", methods=["GET", "HEAD"])
async def submit(
    request: Request, service: ServiceDep, suite: Annotated[str, Query(max_length=80)] = FIRST
) -> Response:
    """Show how to hand in an agent.

    Raises:
        NotFoundError: There is no such suite.
    """
    settings = service.settings
    summary = catalogue.suite(suite).summary()
    return page(
        request,
        "submit.html",
        url=public_url(request),
        submissions=settings.submissions > 0,
        registration=settings.registration is Registration.OPEN,
        limit_mib=settings.model_limit // 2**20,
        suite=summary,
        suites=list_suites(),
    )
