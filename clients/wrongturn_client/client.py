"""The calls of a Wrongturn service, each a method."""

import uuid
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import httpx
import numpy as np
from numpy.typing import NDArray

from wrongturn_client import settings
from wrongturn_client.drive import DriveSocket
from wrongturn_client.episode_calls import DriveConnection, validated
from wrongturn_client.errors import NotOfferedError, ProtocolError
from wrongturn_client.evaluating import evaluate
from wrongturn_client.evaluation import Episode, EpisodePage, Evaluation, at, plotted, run_lines
from wrongturn_client.http_drive import HttpCalls, HttpDrive
from wrongturn_client.policy import Policy, PolicyMaker
from wrongturn_client.rest import TypedCalls
from wrongturn_client.transport import JSON, MSGPACK, Progress, Transport, is_proxied, path_of
from wrongturn_protocol import (
    EpisodeRecord,
    EpisodeState,
    ResultsRequest,
    RunFile,
    SubmissionDetail,
    SubmissionList,
    SubmissionLog,
    SubmissionLogLine,
)
from wrongturn_protocol.json_output import write_whole
from wrongturn_protocol.pixmap import PIXMAP, from_pixmap
from wrongturn_protocol.submissions import NAME, SUITE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Client(HttpCalls, TypedCalls):
    """Client of one service. Its methods may be called from several threads.

    Every method raises :class:`~wrongturn_client.ServiceUnreachableError` if nobody answers, and an
    :class:`~wrongturn_client.ApiError` if the service refuses.

    Example:
        >>> with Client("http://127.0.0.1:8000") as client:  # doctest: +SKIP
        ...     agent = client.register("my agent", Track.PRIVILEGED)
        >>> with Client("http://127.0.0.1:8000", agent.token) as client:  # doctest: +SKIP
        ...     evaluation = client.evaluate(my_policy, "wrong-command@3")
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        transport: httpx.BaseTransport | None = None,
        timeout: float = 30.0,
        patience: float = 60.0,
        binary: bool = True,
    ) -> None:
        """Create a client; the first call connects.

        Args:
            url: The service's URL; by default ``WRONGTURN_URL``, or else the default address of ``wrongturn serve``.
            token: An agent's, an owner's or the operator's token; ``WRONGTURN_TOKEN`` by default. Public calls need
                none; an empty one sends none.
            transport: An httpx transport, for tests.
            timeout: Seconds for each attempt at a call.
            patience: Seconds for which a call is repeated while the service is busy or does not answer; 0 for never.
                A URL at which nobody has answered yet is given up after 5 s.
            binary: Send and receive episodes as msgpack; False for JSON.
        """
        self._token = settings.token() if token is None else token or None
        self._transport = Transport(
            url or settings.service_url(), self._token, transport=transport, timeout=timeout, patience=patience
        )
        self._media_type = MSGPACK if binary else JSON

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()

    # Evaluations

    def create_evaluation(self, suite: str) -> Evaluation:
        """Begin an evaluation of the agent that has this client's token. From its first step on it counts.

        Raises:
            EvaluationOpenError: The agent has an open one on the suite.
        """
        return at(self._create(Evaluation, {"suite": suite}, "evaluations"), self.url)

    def evaluation(self, evaluation: str) -> Evaluation:
        """Return an evaluation: its state and progress, and its secret and metrics once it is finished."""
        return at(self._get(Evaluation, "evaluations", evaluation), self.url)

    def cancel_evaluation(self, evaluation: str) -> Evaluation:
        """Close an evaluation for good and return it. Safe to call again.

        Before its first step it disappears, and the agent's next one on the suite has the same trials. After that it
        counts: it is finished, and every trial without a verdict is ``aborted``, which is unsafe.
        """
        return at(self._call(Evaluation, "DELETE", "evaluations", evaluation), self.url)

    def open_episodes(self, evaluation: str) -> tuple[Episode, ...]:
        """Return the evaluation's open episodes, for example to continue after a crash."""
        return self._episodes(evaluation, EpisodeState.OPEN)

    def finished_episodes(self, evaluation: str) -> tuple[Episode, ...]:
        """Return the evaluation's finished episodes; they show trial and outcome once the evaluation is finished."""
        return self._episodes(evaluation, EpisodeState.FINISHED)

    def _episodes(self, evaluation: str, state: EpisodeState) -> tuple[Episode, ...]:
        pages = self._pages(EpisodePage, "evaluations", evaluation, "episodes", state=state)
        return tuple(at(episode, self.url) for page in pages for episode in page.episodes)

    def put_results(
        self, evaluation: str, episodes: Sequence[EpisodeRecord], versions: dict[str, str] | None = None
    ) -> None:
        """Post the worker's own record of its episodes.

        Raises:
            ResultsMismatchError: The record differs from what the service saw.
        """
        request = ResultsRequest(episodes=tuple(episodes), versions=versions or {})
        path = path_of("v1", "evaluations", evaluation, "results")
        self._transport.call("PUT", path, body=request.model_dump(mode="json"))

    def evaluate(
        self,
        policy: Policy | PolicyMaker,
        suite: str,
        *,
        evaluation: str | None = None,
        progress: Progress | bool | None = None,
        versions: dict[str, str] | None = None,
        parallel: int = 1,
    ) -> Evaluation:
        """Drive a policy through all trials of a suite; return the evaluation with its metrics, secret and episodes.

        If the agent has an open evaluation on the suite, it is resumed: open episodes continue from their last reply.

        Args:
            policy: See :class:`~wrongturn_client.Policy`. Or a class or function that makes one for each episode.
            suite: The suite's id.
            evaluation: The id of an evaluation to resume.
            progress: True to show a bar on stderr. Or a function, called with the numbers of finished and of all
                episodes at the beginning and after each episode.
            versions: Versions of the agent's software by name, for the record.
            parallel: Episodes driven at a time, at most 32, each in a thread with a connection of its own. A policy
                that all episodes share must not keep a memory between steps. The threads call ``progress`` in turns.

        Raises:
            CommitmentError: The secret is not the one that the service promised at the beginning.
            PolicyError: The policy returned something that is not an action.
            Exception: Whatever the policy raises. The episode then counts as aborted; you can resume the evaluation.
        """
        return evaluate(
            self, policy, suite, evaluation=evaluation, progress=progress, versions=versions, parallel=parallel
        )

    def run_file(self, evaluation: str) -> RunFile:
        """Return a finished evaluation with its agent, outcomes and trajectories. It needs no token.

        Raises:
            NotFinishedError: The evaluation is not finished, or was cancelled.
        """
        return RunFile.from_json(b"".join(run_lines(self, evaluation)))

    def save_run(self, evaluation: str, file: str | PathLike[str]) -> None:
        """Write what :meth:`run_file` returns to a file, compressed if its name ends in ``.gz``.

        An existing file is replaced; an error leaves it as it was.

        Raises:
            NotFinishedError: The evaluation is not finished, or was cancelled.
            OSError: The file cannot be written.
        """
        write_whole(run_lines(self, evaluation), Path(file))

    # Episodes

    def trajectory(self, episode: str) -> bytes:
        """Return the bytes of a trajectory's canonical JSON, once it may be shown."""
        return self._transport.call("GET", path_of("v1", "episodes", episode, "trajectory")).content

    def plot(self, episode: str) -> "Figure":
        """Return a matplotlib figure of a finished episode; one of practice needs its agent's token.

        Raises:
            PluginError: Nothing is installed that draws, such as ``wrongturn-service[plot]``.
        """
        return plotted(self.trajectory(episode), self.episode(episode).outcome)

    def view(self, episode: str) -> NDArray[np.uint8]:
        """Return a picture of a practice episode's moment, RGB uint8 (480, 864, 3): from above, and by its camera.

        Raises:
            AuthenticationError: The episode is not this agent's practice.
            EpisodeLostError: The service was restarted meanwhile.
        """
        answer = self._transport.call("GET", path_of("v1", "episodes", episode, "view"), media_type=PIXMAP)
        try:
            return from_pixmap(answer.content)
        except ValueError as error:
            raise ProtocolError(f"the view of episode {episode} is {error}; is the service of this version?") from error

    def drive(self) -> DriveSocket:
        """Open a WebSocket connection for driving: many episodes at a time, many steps in a message.

        Raises:
            NotOfferedError: The service, or a proxy before it, has no such WebSocket. HTTP does the same.
        """
        transport = self._transport
        if self._media_type == JSON:
            raise NotOfferedError("the WebSocket is binary; this client was asked for JSON")
        if transport.injected is not None or is_proxied(transport.parts):
            raise NotOfferedError("no WebSocket through a proxy or another transport; HTTP does the same")
        return DriveSocket(
            transport.parts,
            self._token,
            timeout=transport.timeout,
            patience=transport.patience,
            contact=transport.contact,
        )

    def connection(self, parallel: int) -> DriveConnection:
        """Open a connection for driving: the WebSocket if there is one, else HTTP with so many calls at a time."""
        try:
            return self.drive()
        except NotOfferedError:
            return HttpDrive(self, self._transport.patience, parallel)

    # Submissions

    def submit(
        self, file: str | PathLike[str], suite: str, name: str | None = None, *, progress: Progress | None = None
    ) -> SubmissionDetail:
        """Hand in a model as an ONNX file (``docs/models.md``), which the service checks and then drives itself.

        An owner's token needs the agent's name on the leaderboard; an agent's token has one already. ``progress`` is
        called with the numbers of sent and of all bytes.

        Raises:
            ModelFileError: The file cannot be read.
            AgentNameTakenError: Another agent, or an open submission, has the name.
            ServiceBusyError: The owner has as many open submissions as it may.
            SubmissionsUnavailableError: The service takes no submissions.
        """
        fields = {SUITE: suite} if name is None else {SUITE: suite, NAME: name}
        answer = self._transport.send_model("/v1/submissions", fields, Path(file), progress, str(uuid.uuid4()))
        return validated(SubmissionDetail, answer.message())

    def submissions(self) -> tuple[SubmissionDetail, ...]:
        """Return the submissions of this client's token, the newest first."""
        return tuple(found for page in self._pages(SubmissionList, "submissions") for found in page.submissions)

    def submission(self, submission: str) -> SubmissionDetail:
        """Return a submission: its state, its progress, and why it failed if it did."""
        return self._get(SubmissionDetail, "submissions", submission)

    def submission_log(self, submission: str) -> tuple[SubmissionLogLine, ...]:
        """Return what happened to a submission so far, oldest first."""
        return self._get(SubmissionLog, "submissions", submission, "log").lines

    def cancel_submission(self, submission: str) -> SubmissionDetail:
        """Cancel a submission and return it. Safe to call again.

        Before its drive begins, nothing of it counts and its name is free again. After that its evaluation is closed as
        by :meth:`cancel_evaluation`. One that is over stays as it is.
        """
        return self._call(SubmissionDetail, "DELETE", "submissions", submission)
