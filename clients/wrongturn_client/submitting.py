"""Hand in a model, follow its submission to the end and say what became of it, or cancel it."""

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import NoReturn

import typer
from rich.table import Table

from wrongturn_client import settings
from wrongturn_client.client import Client
from wrongturn_client.errors import (
    AgentNameTakenError,
    ApiError,
    AuthenticationError,
    InvalidRequestError,
    ProtocolError,
    ServiceUnreachableError,
    WrongturnError,
)
from wrongturn_client.following import Display, display_of, follow, whereabouts
from wrongturn_client.invocation import program
from wrongturn_client.model_file import check_contract, check_model_file
from wrongturn_client.settings import OWNER_TOKEN
from wrongturn_client.submitter import NAME_RULE, Submitter, is_name, known_submitter, not_taken, submitter
from wrongturn_client.tables import console, list_table, print_metrics, standing
from wrongturn_protocol import LeaderboardEntry, SubmissionDetail, SubmissionState
from wrongturn_protocol.json_output import give_json
from wrongturn_protocol.submissions import NAME

_INTERRUPTED = 130


class Order:
    """What ``wrongturn submit`` was asked to do, and where."""

    def __init__(self, url: str | None, owner_name: str | None, json_to: Path | None) -> None:
        self.url = (url or settings.DEFAULT_URL).rstrip("/")
        self.owner_name = owner_name
        self.json_to = json_to

    def hand_in(self, file: Path, suite: str, name: str | None, *, wait: bool) -> None:
        """Check a file, hand it in and, if asked to, follow it to its end."""
        check_model_file(file)
        wanted = file.stem if name is None else name
        if not is_name(wanted):
            if name is None:
                raise WrongturnError(
                    f"FILE: {wanted!r} cannot be the agent's name; choose another by --name. Example: --name my-agent"
                )
            raise WrongturnError(f"--name: {wanted!r} cannot be a name; {NAME_RULE}")
        with Client(self.url, "") as client:
            check_contract(file, client.suite(suite).tracks)
        self._check_open()
        who = submitter(self.url, self.owner_name, _say)
        with self._client(who) as client, display_of(wanted) as display:
            try:
                detail = _upload(client, file, suite, wanted, display, who, may_have_name=who.named and name is None)
            except KeyboardInterrupt:
                _say(f"Interrupted. If the model arrived, it is listed: {program()} submissions --url {self.url}")
                raise typer.Exit(_INTERRUPTED) from None
            _say(f"Handed in as {detail.id}: {detail.name} on {detail.suite} at {self.url}, owner {detail.owner}.")
            if wait:
                detail = self._follow(client, detail.id, display)
        if wait:
            self._end(who, detail)
        if self._give(detail):
            _say(f"To follow it: {self._again('--follow', detail.id)}")

    def come_back(self, submission: str) -> None:
        """Follow a submission that was handed in before."""
        who = self._known()
        with self._client(who) as client:
            name = client.submission(submission).name
            with display_of(name) as display:
                detail = self._follow(client, submission, display)
        self._end(who, detail)

    def cancel(self, submission: str) -> None:
        """Cancel a submission and say what it is now."""
        with self._client(self._known()) as client:
            detail = client.cancel_submission(submission)
        if not self._give(detail):
            return
        if detail.state is SubmissionState.CANCELLED:
            typer.echo(f"Cancelled: {detail.name} on {detail.suite}.")
        else:
            typer.echo(f"Nothing is left to cancel: {detail.name} on {detail.suite} is {detail.state}.")

    def list_all(self) -> None:
        """Print the submissions of the owner or agent, the newest first."""
        with self._client(self._known()) as client:
            found = client.submissions()
        if give_json([detail.model_dump(mode="json") for detail in found], self.json_to):
            console().print(_listing(found) if found else "There are no submissions.")

    def _check_open(self) -> None:
        """Check that the service takes submissions, before an owner is registered for one."""
        try:
            with Client(self.url, "", patience=0) as client:
                state = client.submissions_state() or ""
        except (ApiError, ProtocolError, ServiceUnreachableError):  # the upload itself will tell
            return
        word, _, why = state.partition(": ")
        if word == "off":
            turned_off = "WRONGTURN_SUBMISSIONS" in why
            what = f"its operator turned them off ({why})" if turned_off else f"it has no sandbox ({why})"
            raise WrongturnError(f"--url: {self.url} takes no submissions, because {what}; ask its operator")

    def _known(self) -> Submitter:
        Client(self.url, "").close()  # a URL that is none is told as such
        return known_submitter(self.url, self.owner_name)

    @contextmanager
    def _client(self, who: Submitter) -> Iterator[Client]:
        try:
            with Client(self.url, who.token) as client:
                yield client
        except AuthenticationError as error:
            raise not_taken(error, self.url, who.source) from error

    def _follow(self, client: Client, submission: str, display: Display) -> SubmissionDetail:
        try:
            return follow(client, submission, display)
        except BaseException as error:
            _say("The submission goes on without you.")
            _say(f"To follow it again: {self._again('--follow', submission)}")
            _say(f"To cancel it: {self._again('--cancel', submission)}")
            if isinstance(error, KeyboardInterrupt):
                raise typer.Exit(_INTERRUPTED) from None
            raise

    def _again(self, option: str, submission: str) -> str:
        owner = [] if self.owner_name is None else ["--owner-name", self.owner_name]
        return f"{program()} submit {shlex.join([option, submission, '--url', self.url, *owner])}"

    def _end(self, who: Submitter, detail: SubmissionDetail) -> NoReturn:
        """Print what became of a submission that is over, and end with its status."""
        with Client(self.url, who.token) as client:
            board = client.leaderboard(detail.suite)
            metrics = None
            if detail.state is SubmissionState.FINISHED and detail.evaluation is not None:
                metrics = client.evaluation(detail.evaluation).metrics
        entries = (one for one in board.entries if one.evaluation is not None and one.evaluation == detail.evaluation)
        entry = next(entries, None)
        if self._give(detail, entry):
            if metrics is not None:
                print_metrics(console(), detail.name, metrics)
            if detail.state is not SubmissionState.FINISHED:
                typer.echo(f"{detail.name} {detail.state}: {detail.reason or 'the service does not say why'}")
            if detail.evaluation is not None and (metrics is not None or entry is not None):
                typer.echo(standing(board, detail.evaluation))
        raise typer.Exit(0 if detail.state is SubmissionState.FINISHED else 1)

    def _give(self, detail: SubmissionDetail, entry: LeaderboardEntry | None = None) -> bool:
        plain = None if entry is None else entry.model_dump(mode="json")
        return give_json({"submission": detail.model_dump(mode="json"), "entry": plain}, self.json_to)


def _upload(
    client: Client, file: Path, suite: str, name: str, display: Display, who: Submitter, *, may_have_name: bool
) -> SubmissionDetail:
    """Hand the file in; the service knows the name of an agent whose token it may be (``may_have_name``)."""
    try:
        if may_have_name:
            try:
                return client.submit(file, suite, progress=display.uploaded)
            except InvalidRequestError as error:  # an owner's token needs a name
                if not _about_name(error):
                    raise
        return client.submit(file, suite, name, progress=display.uploaded)
    except AgentNameTakenError as error:
        said = str(error).removeprefix("name: ")
        raise WrongturnError(f"--name: {said}. Example: --name {shlex.quote(name + '-2')}") from error
    except InvalidRequestError as error:
        # The name itself is checked already, so an agent's token must have one of its own.
        if who.source != OWNER_TOKEN or not _about_name(error):
            raise
        raise WrongturnError(
            f"{OWNER_TOKEN}: it holds the token of an agent, not of an owner; set WRONGTURN_TOKEN to it and unset "
            f"{OWNER_TOKEN}"
        ) from error


def _about_name(error: InvalidRequestError) -> bool:
    return any(field.path == NAME for field in error.problem.errors)


def _listing(found: Sequence[SubmissionDetail]) -> Table:
    rows = []
    for detail in found:
        handed_in = f"{datetime.fromisoformat(detail.created).astimezone():%Y-%m-%d %H:%M}"
        state = f"{detail.state}: {detail.reason}" if detail.reason else whereabouts(detail)
        rows.append((detail.id, handed_in, detail.name, detail.suite, state))
    return list_table(("id", "handed in", "agent", "suite", "state"), rows)


def _say(text: str) -> None:
    typer.echo(text, err=True)
