"""What if: a finished episode as practice, with another command from one moment on."""

import math
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Request, Response

from wrongturn_protocol import EpisodeReply, EpisodeState, Fork, WhatIfRequest
from wrongturn_protocol.vehicle import DECISION_S
from wrongturn_service.api.dependencies import Body, DriverDep, EncodingDep, KeyDep, ServiceDep
from wrongturn_service.api.documents import Route, described
from wrongturn_service.api.episodes import is_shown, not_shown
from wrongturn_service.client_address import address_of
from wrongturn_service.episodes.open_episode import unknown_episode
from wrongturn_service.errors import GoneError, InvalidRequestError
from wrongturn_service.replays import check_town
from wrongturn_service.simulators.interface import ACTION

router = APIRouter(prefix="/v1/whatifs", tags=["episodes"], route_class=Route)
_ROWS: Final = 2
"""Rows of 0.1 s."""
_PER_SECOND: Final = 20
"""Rows of a second."""
_CLOSE: Final = 1e-6
"""Decisions: 3.2 s is the decision 32, whatever the last digit of 3.2 / 0.1 is."""


@router.post("", **described(EpisodeReply, 404, 409, 410, 429, 507, status=201))
async def fork(
    request: Request,
    service: ServiceDep,
    encoding: EncodingDep,
    caller: DriverDep,
    wanted: Annotated[WhatIfRequest, Depends(Body(WhatIfRequest, limit=4096, binary=True))],
    key: KeyDep,
) -> Response:
    """Reset: begin a fork of a finished episode of this agent, as practice.

    Send the episode's own actions up to `at`; another action gets 409 `action-mismatch`. From then on the command is
    the other one, and the agent drives on. A fork of an episode that has a page is shown there when it is finished.
    """
    caller.check_practice()
    async with key.once(caller.holder, wanted) as once:
        row = await service.store.episode(wanted.episode)
        if row is None:
            raise unknown_episode(wanted.episode)
        caller.check_episode(row)
        if row.state == EpisodeState.LOST:
            raise GoneError(f"episode {row.id} is lost; fork a finished one")
        if not await is_shown(service, row):
            raise not_shown(row.id)
        trajectory = await service.replays.trajectory(row.id)
        check_town(trajectory)
        if trajectory.trial.fork is not None:
            raise InvalidRequestError("episode", f"{row.id} is a fork itself; name {row.origin_id or 'another'}")
        decision, count = math.ceil(wanted.at / DECISION_S - _CLOSE), len(trajectory.rows[1::_ROWS])
        if decision >= count:
            last = (count - 1) * DECISION_S
            raise InvalidRequestError("at", f"is {wanted.at:g}, and the last decision is at {last:.1f} s; give less")
        trial = trajectory.trial.model_copy(update={"fork": Fork(decision=decision, command=wanted.command)})
        each = _ROWS if caller.rig is None else _PER_SECOND // caller.rig.rate
        before = trajectory.rows[1 : 1 + decision * _ROWS : each]
        origin = row.id, b"".join(ACTION.pack(one.steer, one.throttle, one.brake) for one in before)
        body = await service.resets.practise(caller, address_of(request), trial, encoding, once, origin)
    return Response(body, 201, media_type=encoding)
