"""The rules for calls on an episode, and the errors that tell an agent which rule it broke and what to do."""

from wrongturn_protocol import ProblemType
from wrongturn_service.episodes.open_episode import OpenEpisode
from wrongturn_service.errors import ConflictError, ForbiddenError, NotFoundError, UnavailableError
from wrongturn_service.simulators.interface import Action


def check_step(episode: OpenEpisode, seq: int) -> bool:
    """Return True for the next step of an open episode, False for a repeat of the last one.

    Raises:
        ConflictError: The episode is over, or ``seq`` is neither the last number nor the next.
    """
    if seq == episode.seq:
        return False
    if episode.end is not None:
        raise episode_finished(episode.id)
    if seq != episode.seq + 1:
        raise _gap(episode.id, seq, episode.seq)
    return True


def check_holder(holder: str, episode: OpenEpisode) -> None:
    """Raise ForbiddenError if another agent drives the episode, or the runner of a submission does."""
    if holder != episode.holder:
        raise ForbiddenError(f"episode {episode.id} belongs to another agent")


def check_view(episode_id: str, evaluation: str | None) -> None:
    """Raise ForbiddenError if an episode is of an evaluation: the view shows more than an agent's track does."""
    if evaluation is not None:
        raise ForbiddenError(f"episode {episode_id} counts, and its view shows what agents may not see; view practice")


def check_same(episode_id: str, seq: int, action: Action, last: Action | None) -> None:
    """Raise ConflictError if a repeated step has another action than the first time."""
    if action != last:
        raise ConflictError(
            ProblemType.ACTION_MISMATCH,
            f"episode {episode_id}: step {seq} was already taken with another action and cannot be changed",
        )


def _gap(episode_id: str, seq: int, last: int) -> ConflictError:
    again = f", or {last} with the same action to get that reply again" if last else ""
    return ConflictError(
        ProblemType.SEQUENCE_GAP,
        f"episode {episode_id}: seq is {seq}, but the last reply has {last}; send {last + 1}{again}",
    )


def episode_finished(episode_id: str) -> ConflictError:
    """Return the error for a step after the episode's end."""
    return ConflictError(ProblemType.EPISODE_FINISHED, f"episode {episode_id} is over; ask for the next trial")


def unknown_episode(episode_id: str) -> NotFoundError:
    """Return the error for a call on an episode that does not exist."""
    return NotFoundError(ProblemType.UNKNOWN_EPISODE, f"there is no episode {episode_id[:64]!r}")


def stopping() -> UnavailableError:
    """Return the error for a call that arrives while the service stops."""
    return UnavailableError(ProblemType.SHUTTING_DOWN, "the service is stopping", retry_after_s=5)
