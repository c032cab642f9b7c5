"""Check of a finished trial: ``model_copy`` skips the checks that pydantic makes when a trial is created."""

from pydantic import ValidationError

from wrongturn_protocol import Trial
from wrongturn_sim.errors import InvalidTrialError


def check(trial: Trial) -> None:
    """Check the fields of a trial.

    Raises:
        InvalidTrialError: a field is invalid; the message names it.
    """
    try:
        Trial.model_validate(trial.model_dump(warnings=False))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        path = ".".join(("trial", *map(str, first["loc"])))
        raise InvalidTrialError(
            f"{path}: {first['msg']}; make trials by draw_trial, or check yours by Trial.model_validate"
        ) from error
