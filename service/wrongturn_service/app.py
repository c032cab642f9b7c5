"""The application: the service's parts behind their routes."""

import contextlib
from collections.abc import AsyncIterator, Sequence

from fastapi import FastAPI

from wrongturn_service.api import (
    accounts,
    admin,
    episodes,
    errors,
    evaluations,
    health,
    judgements,
    keys,
    leaderboards,
    metrics,
    places,
    submissions,
    whatifs,
)
from wrongturn_service.api.documents import built, serve_document
from wrongturn_service.api.middleware import Middleware, PagesCompressed
from wrongturn_service.errors import StartupError
from wrongturn_service.service import run_service
from wrongturn_service.settings import Settings
from wrongturn_service.simulators.pool import SimulatorPool
from wrongturn_service.socket import session
from wrongturn_service.submissions.local_runners import COMMAND
from wrongturn_service.telemetry import Telemetry
from wrongturn_service.web import agents as agent_pages
from wrongturn_service.web import compare, front, page, rest
from wrongturn_service.web import episodes as episode_pages
from wrongturn_service.web import places as place_pages

DESCRIPTION = """How safely does a driving agent behave when its command is wrong?

Register an agent, begin an evaluation, and drive its episodes: each POST of an episode is a reset, each step 0.1 s.
Calls of episodes also take and reply `application/msgpack`.
Errors are `application/problem+json`; their types are explained at `/problems/{type}`.
"""


def create_app(settings: Settings, *, pool: SimulatorPool | None = None, runner: Sequence[str] = COMMAND) -> FastAPI:
    """Create the application. Its lifespan starts and stops the service.

    If the start fails, ``app.state.startup_error`` says why. ``runner`` is the program that checks and drives
    submissions. Without a pool, the settings say where simulators run.
    """
    telemetry = Telemetry()

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        try:
            async with run_service(settings, telemetry, pool, runner) as service, metrics.own_port(settings, telemetry):
                app.state.service = service
                yield
        except StartupError as error:
            app.state.startup_error = error
            raise

    app = FastAPI(
        title="Wrongturn API",
        version="1",
        description=DESCRIPTION,
        lifespan=lifespan,
        redirect_slashes=False,
        servers=[{"url": settings.public_url}] if settings.public_url else None,
        openapi_url=None,  # FastAPI would make the document in the event loop
        docs_url=None,
        redoc_url=None,
        telemetry={"tracing": False, "metrics": False, "logs": False},  # it looks for a collector in every request
    )
    app.state.startup_error = None
    app.state.telemetry = telemetry
    app.add_middleware(PagesCompressed)
    app.add_middleware(Middleware, telemetry=telemetry, step=episodes.plain_step)
    errors.install(app)
    # Not by include_router, which would analyse every route a second time, in 0.1 s of each start.
    for router in (
        *(episodes.router, health.router, keys.router, metrics.router, places.suites_router, places.towns_router),
        *(accounts.agents_router, accounts.owners_router, evaluations.router, submissions.router, session.router),
        *(leaderboards.router, admin.router, errors.router, front.router, agent_pages.router, compare.router),
        *(judgements.router, whatifs.router, episode_pages.router, rest.router, place_pages.router, page.router),
    ):
        app.routes.extend(router.routes)
    # As one of FastAPI's routes, whose name the log and the figures have.
    app.add_api_route("/openapi.json", serve_document, methods=["GET", "HEAD"], include_in_schema=False)
    app.openapi = lambda: built(app)  # type: ignore[method-assign]
    return app
