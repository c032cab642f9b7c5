"""Messages about owners and agents."""

from typing import Annotated, Final, LiteralString, Self

from pydantic import (
    Field,
    StringConstraints,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from wrongturn_protocol.episodes import Message, is_none
from wrongturn_protocol.rigs import Rig, sight_of
from wrongturn_protocol.vocabulary import AgentKind, Track

NAME_RULE: Final = (
    "has to be 1 to 64 letters (A to Z, a to z), digits, dots, dashes, underscores and spaces, beginning with a letter "
    "or digit"
)
"""What a name of an agent or an owner has to be, in words."""


def _in_words(kind: LiteralString, rule: LiteralString) -> WrapValidator:
    """Return a validator whose error for a text of another pattern says the rule, not the pattern."""

    def valid(text: object, check: ValidatorFunctionWrapHandler) -> str:
        try:
            found: str = check(text)
        except ValidationError as error:
            if error.errors()[0]["type"] != "string_pattern_mismatch":
                raise
            raise PydanticCustomError(kind, rule) from None
        return found

    return WrapValidator(valid)


AgentName = Annotated[
    str,
    StringConstraints(pattern=r"^[A-Za-z0-9](?:[A-Za-z0-9._ -]{0,62}[A-Za-z0-9._-])?$", strip_whitespace=True),
    _in_words("name", NAME_RULE),
]
Homepage = Annotated[
    str,
    StringConstraints(max_length=300, pattern=r"^https?://[^\x00/?#@\\]+([/?#][^\x00\\]*)?$"),
    _in_words(
        "homepage",
        "has to be http:// or https:// and a host, without a user (user@host), a backslash and the character NUL",
    ),
]
Text = Annotated[str, StringConstraints(pattern=r"^[^\x00]*$")]
"""Text without the character NUL, which PostgreSQL does not take."""


class OwnerRegistration(Message):
    """``POST /v1/owners``."""

    name: AgentName
    contact: Annotated[Text, Field(max_length=300)] | None = None
    """How the operator reaches the owner; nobody else sees it."""


class OwnerDetail(Message):
    """An owner as everybody sees it: who answers for agents."""

    id: str
    name: str


class OwnerList(Message):
    """``GET /v1/owners``."""

    owners: tuple[OwnerDetail, ...]
    next: str | None = None
    """Cursor of the next page; None at the end."""


class RegisteredOwner(OwnerDetail):
    """Reply 201 to an owner's registration or a token's rotation."""

    token: str
    """The token, with which the owner registers agents. It is shown only this once."""


class AgentRegistration(Message):
    """``POST /v1/agents``."""

    name: AgentName
    track: Track
    description: Annotated[Text, Field(max_length=2000)] | None = None
    homepage: Homepage | None = None
    kind: AgentKind = AgentKind.SUBMITTED
    """Kinds other than ``submitted`` need the operator's token."""
    trained_on_faults: bool = False
    """True for an agent that met wrong commands in its training. The leaderboard marks it."""
    rig: Rig | None = Field(default=None, exclude_if=is_none)
    """Cameras, navigation inputs, rate and kind of action. None: what the track shows."""

    @model_validator(mode="after")
    def _rig_is_the_tracks(self) -> Self:
        sight_of(self.track, self.rig)
        return self


class AgentDetail(Message):
    """An agent as everybody sees it."""

    id: str
    name: str
    track: Track
    kind: AgentKind
    owner: str = ""
    """Name of the owner."""
    description: str | None = None
    homepage: str | None = None
    trained_on_faults: bool = False
    """Whether it met wrong commands in its training, as its owner says."""
    rig: Rig | None = Field(default=None, exclude_if=is_none)
    """Its rig. None: what the track shows."""


class AgentList(Message):
    """``GET /v1/agents``."""

    agents: tuple[AgentDetail, ...]
    next: str | None = None
    """Cursor of the next page; None at the end."""


class RegisteredAgent(AgentDetail):
    """Reply 201 to a registration or a token's rotation."""

    token: str
    """The token. It is shown only this once."""
