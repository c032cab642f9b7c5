"""Whose token hands a model in: one from the environment, one kept earlier, or that of a new owner."""

import getpass
import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Final

from pydantic import TypeAdapter, ValidationError

from wrongturn_client import settings
from wrongturn_client.client import Client
from wrongturn_client.errors import AuthenticationError, NotFoundError, OwnerNameTakenError, WrongturnError
from wrongturn_client.owner_tokens import KeptOwner, OwnerTokens
from wrongturn_client.settings import OWNER_TOKEN
from wrongturn_protocol import ProblemType
from wrongturn_protocol.accounts import AgentName

_TOKEN: Final = "WRONGTURN_TOKEN"  # noqa: S105 - the variable's name
_NAMES_TRIED: Final = 100
_NAME: Final = TypeAdapter(AgentName)
NAME_RULE: Final = "give at most 64 letters, digits, spaces, dots, dashes and underscores, a letter or digit first"


@dataclass(frozen=True)
class Submitter:
    """A token, and where it is from."""

    token: str
    source: str
    """The environment's variable, or the file that keeps it."""
    named: bool
    """Whether the token may be an agent's, which has its name already."""


def is_name(name: str) -> bool:
    """Tell whether an agent or an owner can have this name."""
    try:
        _NAME.validate_python(name)
    except ValidationError:
        return False
    return True


def known_submitter(url: str, owner_name: str | None = None) -> Submitter | None:
    """Return who hands in at a service; None if no token is known yet.

    Args:
        url: The service's URL.
        owner_name: Name of an owner among those that this program has registered.
    """
    if owner_name is None and (found := _from_environment()) is not None:
        return found
    tokens = OwnerTokens()
    kept = tokens.find(url, owner_name)
    return None if kept is None else Submitter(kept.token, str(tokens.path), named=False)


def submitter(url: str, owner_name: str | None, say: Callable[[str], None]) -> Submitter:
    """Return who hands in at a service; register an owner if no token is known, and keep its token.

    Args:
        url: The service's URL.
        owner_name: Name of the owner. None: the environment's or the one used last, else a new one with the login name.
        say: Called with what the user has to know.

    Raises:
        WrongturnError: The owner cannot be registered, or its token cannot be kept.
    """
    if owner_name is not None and not is_name(owner_name):
        raise WrongturnError(f"--owner-name: {owner_name!r} cannot be a name; {NAME_RULE}")
    if owner_name is None and (found := _from_environment()) is not None:
        return found
    tokens = OwnerTokens()
    with tokens.locked(), Client(url, "") as client:
        kept = tokens.find(url, owner_name)
        if kept is not None and _is_known(client, kept):
            tokens.keep(url, kept)
        else:
            kept = _register(client, owner_name if kept is None else kept.name, given=owner_name is not None)
            tokens.keep(url, kept)
            say(
                f"Registered you as the owner {kept.name!r} at {url}. The agents that you hand in there are this "
                f"owner's. Its token is in {tokens.path}; keep that file."
            )
    return Submitter(kept.token, str(tokens.path), named=False)


def _from_environment() -> Submitter | None:
    for variable in (OWNER_TOKEN, _TOKEN):
        token = settings.secret(variable)
        if token:
            return Submitter(token, variable, named=variable == _TOKEN)
    return None


def _is_known(client: Client, owner: KeptOwner) -> bool:
    """Tell whether the service knows an owner; one with a new database at the same URL does not."""
    try:
        return client.owner(owner.id).name == owner.name
    except NotFoundError:
        return False


def _register(client: Client, name: str | None, *, given: bool) -> KeptOwner:
    """Register an owner under the given name, or under the login name with the first number that is free."""
    login = name or _login_name()
    for number in count(1):
        wanted = login if number == 1 else f"{login}-{number}"
        try:
            owner = client.register_owner(wanted)
        except OwnerNameTakenError as error:
            if given or number >= _NAMES_TRIED:
                raise WrongturnError(
                    f"--owner-name: {wanted!r} is taken at {client.url}; choose another. If it is yours, set "
                    f"{OWNER_TOKEN} to its token"
                ) from error
        except AuthenticationError as error:
            if error.type != ProblemType.REGISTRATION_CLOSED:
                raise
            raise WrongturnError(
                f"{OWNER_TOKEN}: {client.url} takes submissions only from owners that its operator registered; ask "
                "the operator for a token"
            ) from error
        else:
            return KeptOwner(id=owner.id, name=owner.name, token=owner.token)
    raise AssertionError("count() has no end")


def _login_name() -> str:
    try:
        login = getpass.getuser()
    except (OSError, KeyError):  # a container's user may have no name
        login = ""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", login).strip("-._")[:50] or "owner"


def unknown(url: str, owner_name: str | None) -> WrongturnError:
    """Return the error for a user of whom no token is known here."""
    if owner_name is None:
        return WrongturnError(
            f"{OWNER_TOKEN}: no token for {url} is known here; set the one that the model was handed in with"
        )
    names = ", ".join(map(repr, OwnerTokens().names(url)))
    remedy = f"give one of {names}" if names else f"leave it out and set {OWNER_TOKEN} to the owner's token"
    return WrongturnError(f"--owner-name: no token of an owner {owner_name!r} at {url} is known here; {remedy}")


def not_taken(error: AuthenticationError, url: str, source: str) -> WrongturnError:
    """Return the error for a token that the service does not take, with where the token is from."""
    if error.type == ProblemType.FORBIDDEN:  # the token is good, but another's would be needed
        return WrongturnError(f"{error}; choose its owner by --owner-name, or set {OWNER_TOKEN} to that owner's token")
    remedy = (
        f"if you changed the token, set {OWNER_TOKEN} to the new one; for another owner give --owner-name"
        if source not in {OWNER_TOKEN, _TOKEN}
        else "correct or unset it"
    )
    return WrongturnError(f"{source}: {url} does not take its token: {error}; {remedy}")
