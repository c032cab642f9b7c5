"""Whose token hands a model in: one from the environment, one kept in ``WRONGTURN_HOME``, or that of a new owner.

Kept tokens let all submissions of a user belong to one owner, although the user keeps no token.
"""

import fcntl
import getpass
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final
from urllib.parse import urlsplit

from pydantic import BaseModel, RootModel, TypeAdapter, ValidationError

from wrongturn_client import settings
from wrongturn_client.client import Client
from wrongturn_client.errors import AuthenticationError, NotFoundError, OwnerNameTakenError, WrongturnError
from wrongturn_client.settings import OWNER_TOKEN
from wrongturn_protocol import ProblemType
from wrongturn_protocol.accounts import AgentName
from wrongturn_protocol.home import home
from wrongturn_protocol.json_output import write_whole

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
    named: bool = False
    """Whether the token may be an agent's, which has its name already."""


class KeptOwner(BaseModel):
    """An owner with its token."""

    id: str
    name: str
    token: str


class _Kept(RootModel[dict[str, list[KeptOwner]]]):
    """Owners by the URL of their service, the one used last at the end."""


class OwnerTokens:
    """The tokens of owners that this program registered: a file that only its user may read."""

    def __init__(self) -> None:
        self.path = home() / "owners.json"

    def owners(self, url: str) -> list[KeptOwner]:
        """Return the owners that are kept for a service, the one used last at the end."""
        return self._read().root.get(_origin(url), [])

    def find(self, url: str, name: str | None = None) -> KeptOwner | None:
        """Return the owner used last at a service, or the one of this name; None if there is none."""
        return next((owner for owner in reversed(self.owners(url)) if name in {None, owner.name}), None)

    def keep(self, url: str, owner: KeptOwner) -> None:
        """Keep an owner as the one used last at a service; it replaces one of the same name."""
        kept = self._read()
        others = [other for other in self.owners(url) if other.name != owner.name]
        kept.root[_origin(url)] = [*others, owner]
        with self._writing():
            write_whole([kept.model_dump_json(indent=2).encode(), b"\n"], self.path, private=True)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other programs of this user from registering an owner meanwhile."""
        with self._writing():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self.path.with_suffix(".lock"), os.O_WRONLY | os.O_CREAT, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield
        finally:
            os.close(descriptor)

    def _read(self) -> _Kept:
        try:
            return _Kept.model_validate_json(self.path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return _Kept({})
        except (OSError, ValidationError, UnicodeDecodeError) as error:
            why = error.strerror if isinstance(error, OSError) else "it does not hold what this program writes"
            raise WrongturnError(
                f"{self.path} cannot be read ({why}); move it away, or set WRONGTURN_OWNER_TOKEN to your token"
            ) from error

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise WrongturnError(
                f"{self.path} cannot be written ({error.strerror}), so a new owner's token would be lost; set "
                "WRONGTURN_HOME to a folder that you can write, or WRONGTURN_OWNER_TOKEN to your token"
            ) from error


def is_name(name: str) -> bool:
    """Tell whether an agent or an owner can have this name."""
    try:
        _NAME.validate_python(name)
    except ValidationError:
        return False
    return True


def known_submitter(url: str, owner_name: str | None) -> Submitter:
    """Return who handed in: the owner of this name, or by default the environment's or the one used last there."""
    if owner_name is None and (found := _from_environment()) is not None:
        return found
    tokens = OwnerTokens()
    if (kept := tokens.find(url, owner_name)) is not None:
        return Submitter(kept.token, str(tokens.path))
    if owner_name is None:
        raise WrongturnError(
            f"{OWNER_TOKEN}: no token for {url} is known here; set the one that the model was handed in with"
        )
    names = ", ".join(repr(owner.name) for owner in tokens.owners(url))
    remedy = f"give one of {names}" if names else f"leave it out and set {OWNER_TOKEN} to the owner's token"
    raise WrongturnError(f"--owner-name: no token of an owner {owner_name!r} at {url} is known here; {remedy}")


def submitter(url: str, owner_name: str | None, say: Callable[[str], None]) -> Submitter:
    """Return who hands in at a service; register an owner if no token is known, keep its token, and say so.

    Without a name the owner is the environment's or the one used last, else a new one with the login name.

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
        if kept is None or not _is_known(client, kept):
            kept = _register(client, owner_name if kept is None else kept.name, given=owner_name is not None)
            say(
                f"Registered you as the owner {kept.name!r} at {url}. The agents that you hand in there are this "
                f"owner's. Its token is in {tokens.path}; keep that file."
            )
        tokens.keep(url, kept)
    return Submitter(kept.token, str(tokens.path))


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


def _from_environment() -> Submitter | None:
    for variable in (OWNER_TOKEN, _TOKEN):
        if token := settings.secret(variable):
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
    wanted = login = name or _login_name()
    for number in range(2, _NAMES_TRIED + 2):
        try:
            return KeptOwner.model_validate(client.register_owner(wanted), from_attributes=True)
        except OwnerNameTakenError as error:
            if given or number > _NAMES_TRIED:
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
        wanted = f"{login}-{number}"
    raise AssertionError("the last name returns or raises")


def _login_name() -> str:
    try:
        login = getpass.getuser()
    except (OSError, KeyError):  # a container's user may have no name
        login = ""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", login).strip("-._")[:50] or "owner"


def _origin(url: str) -> str:
    """Return a URL in one spelling, so that its token is found again."""
    parts = urlsplit(url)
    port = parts.port or (443 if parts.scheme == "https" else 80)
    return f"{parts.scheme}://{parts.hostname}:{port}{parts.path.rstrip('/')}"
