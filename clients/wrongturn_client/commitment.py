"""The check that a service drew the trials before it saw the agent drive."""

import hashlib

from wrongturn_client.errors import CommitmentError
from wrongturn_protocol import EvaluationDetail, EvaluationState


def check_commitment(begun: EvaluationDetail, done: EvaluationDetail) -> None:
    """Raise CommitmentError if a finished evaluation's secret is not the one that was promised at its beginning."""
    if done.state is not EvaluationState.FINISHED or begun.commitment is None:
        return
    told = None if done.secret is None else hashlib.sha256(done.secret.encode()).hexdigest()
    if told != begun.commitment:
        raise CommitmentError(
            f"evaluation {done.id}: the service promised a secret with the SHA-256 {begun.commitment} and told "
            f"{'none' if told is None else f'one with {told}'}; the trials may have been chosen afterwards, so do not "
            "trust the result, and ask the operator"
        )
