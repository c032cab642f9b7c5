"""Conditions that leave out what the operator hides. Whoever is hidden hides what belongs to it."""

from sqlalchemy import ColumnElement, and_, select

from wrongturn_protocol import EvaluationState
from wrongturn_protocol.vocabulary import Collection
from wrongturn_service.storage.models import AgentRow, EvaluationRow, HeldRow, OwnerRow


def seen_owners() -> ColumnElement[bool]:
    """Return the condition of owners that everybody sees."""
    return OwnerRow.hidden.is_(False)


def seen_agents() -> ColumnElement[bool]:
    """Return the condition of agents that everybody sees."""
    hidden = select(OwnerRow.id).where(OwnerRow.id == AgentRow.owner_id, OwnerRow.hidden.is_(True))
    return and_(AgentRow.hidden.is_(False), ~hidden.correlate(AgentRow).exists())


def has_evaluation() -> ColumnElement[bool]:
    """Return the condition of agents that have begun an evaluation. The others have practised at most."""
    begun = select(EvaluationRow.id).where(EvaluationRow.agent_id == AgentRow.id)
    return begun.correlate(AgentRow).exists()


def seen_evaluations() -> ColumnElement[bool]:
    """Return the condition of evaluations that everybody may see once they are finished."""
    seen = select(AgentRow.id).where(AgentRow.id == EvaluationRow.agent_id, seen_agents())
    return and_(EvaluationRow.hidden.is_(False), seen.correlate(EvaluationRow).exists())


def public_evaluations() -> tuple[ColumnElement[bool], ...]:
    """Return the conditions of evaluations that everybody sees: finished, and not hidden."""
    return EvaluationRow.state == EvaluationState.FINISHED, seen_evaluations()


def counting_suites() -> ColumnElement[bool]:
    """Return the condition of evaluations on suites whose first evaluation of the agent was not deleted.

    What is driven after such a deletion does not count, unless the operator has freed the place.
    """
    place = EvaluationRow.agent_id.concat(" ").concat(EvaluationRow.suite)
    kept = select(HeldRow.key).where(HeldRow.kind == Collection.EVALUATIONS.one, HeldRow.key == place)
    return ~kept.correlate(EvaluationRow).exists()
