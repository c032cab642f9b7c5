"""Whether a trial is one: what pydantic checks when it is made, ``model_copy`` lets through."""

from pydantic import ValidationError

from wrongturn_protocol import Trial
from wrongturn_sim.errors import InvalidTrialError


def check(trial: Trial) -> None:
    """Check a trial again.

    Raises:
        InvalidTrialError: a field cannot be; the message names it.
    """
    try:
        Trial.model_validate(trial.model_dump(warnings=False))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        path = ".".join(("trial", *map(str, first["loc"])))
        raise InvalidTrialError(
            f"{path}: {first['msg']}; make trials by draw_trial, or check yours by Trial.model_validate"
        ) from error
