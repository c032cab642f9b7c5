"""What the manager of episodes refuses, as errors with a remedy."""

from wrongturn_protocol import ProblemType
from wrongturn_service.errors import ConflictError, ForbiddenError, NotFoundError, UnavailableError
from wrongturn_service.simulators.action_log import Action


def check_owner(agent: str, owner: str, episode_id: str) -> None:
    """Raise ForbiddenError where the episode is not the agent's."""
    if agent != owner:
        raise ForbiddenError(f"episode {episode_id} is another agent's")


def check_same(episode_id: str, seq: int, action: Action, last: Action | None) -> None:
    """Raise ConflictError where a repeated step differs from the first."""
    if action != last:
        raise ConflictError(
            ProblemType.ACTION_MISMATCH,
            f"episode {episode_id}: step {seq} was taken with another action; what was driven cannot be driven again",
        )


def gap(episode_id: str, seq: int, last: int) -> ConflictError:
    """What a step out of sequence gets."""
    again = f", or {last} with the same action to have that reply again" if last else ""
    return ConflictError(
        ProblemType.SEQUENCE_GAP,
        f"episode {episode_id}: seq is {seq}, the last reply's was {last}; send {last + 1}{again}",
    )


def episode_finished(episode_id: str) -> ConflictError:
    """What a step after the end gets."""
    return ConflictError(ProblemType.EPISODE_FINISHED, f"episode {episode_id} is over; ask for the next trial")


def unknown_episode(episode_id: str) -> NotFoundError:
    """What a call on an episode gets that there is none of."""
    return NotFoundError(ProblemType.UNKNOWN_EPISODE, f"there is no episode {episode_id[:64]!r}")


def stopping() -> UnavailableError:
    """What a call gets that comes too late for this service, and in time for the next."""
    return UnavailableError(ProblemType.SHUTTING_DOWN, "the service is stopping", retry_after_s=5)
