"""An evaluation and its episodes, to look at: as a table, a pandas frame and figures."""

import json
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import PrivateAttr

from wrongturn_client.errors import NotFinishedError, PluginError, WrongturnError
from wrongturn_protocol import EpisodeDetail, EpisodeList, EvaluationDetail, EvaluationState, Outcome
from wrongturn_protocol.installing import install
from wrongturn_protocol.suggestions import did_you_mean

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from wrongturn_client.client import Client

M = TypeVar("M", "Evaluation", "Episode")


class Episode(EpisodeDetail):
    """An episode of a finished evaluation."""

    _url: str = PrivateAttr("")

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        """Yield what a notebook shows of it."""
        yield "id", self.id
        yield "trial", self.trial
        yield "verdict", None if self.outcome is None else self.outcome.verdict.value

    @cached_property
    def trajectory(self) -> bytes:
        """The canonical JSON of its trajectory, which the service sends on first use.

        Raises:
            WrongturnError: It ended without a trajectory, or the service does not answer.
        """
        from wrongturn_client.client import Client  # noqa: PLC0415 - it imports this module

        if self.trajectory_sha256 is None:
            raise WrongturnError(f"trajectory: episode {self.id} has none: it ended before its first step")
        with Client(self._url, "") as client:  # episodes of finished evaluations are public
            return client.trajectory(self.id)

    def plot(self) -> "Figure":
        """Return a matplotlib figure: the way from above, coloured by speed, beside speed and commands over time.

        ``wrongturn-service[plot]`` draws it.

        Raises:
            PluginError: Nothing is installed that draws.
            WrongturnError: As :attr:`trajectory`.
        """
        return plotted(self.trajectory, self.outcome)


class Evaluation(EvaluationDetail):
    """An evaluation of one agent on one suite. A notebook shows it as a table.

    Example:
        >>> evaluation = client.evaluate(MyAgent(), "wrong-command@3")  # doctest: +SKIP
        >>> frame = evaluation.to_frame()  # doctest: +SKIP
        >>> evaluation.episode(frame.trial[0]).plot()  # doctest: +SKIP
    """

    _url: str = PrivateAttr("")

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        """Yield what a traceback or a list shows of it."""
        yield "id", self.id
        yield "suite", self.suite
        yield "state", self.state.value
        yield "finished", self.finished
        yield "trials", self.trials

    @cached_property
    def episodes(self) -> tuple[Episode, ...]:
        """Its episodes in the order in which they were begun. The service sends them on first use.

        Raises:
            NotFinishedError: The evaluation is not finished, or was cancelled.
            WrongturnError: The service does not answer, or hides the evaluation.
        """
        from wrongturn_client.client import Client  # noqa: PLC0415 - it imports this module

        check_finished(self, "client.evaluate(agent, suite) goes on with it")
        with Client(self._url, "") as client:  # a finished evaluation is public
            return client.finished_episodes(self.id)

    def episode(self, name: str) -> Episode:
        """Return the episode with this id, or of the trial with this id.

        Raises:
            WrongturnError: There is none, or as :attr:`episodes`.
        """
        found = {one.trial: one for one in self.episodes} | {one.id: one for one in self.episodes}
        if name not in found:
            meant = did_you_mean(name, [trial for trial in found if trial is not None])
            raise WrongturnError(
                f"episode: {name!r} is no episode or trial of evaluation {self.id}; to_frame() lists them{meant}"
            )
        return found[name]

    def to_frame(self) -> "DataFrame":
        """Return a pandas frame with a row for each episode, twins included; ``docs/figures.md`` has the columns.

        Raises:
            WrongturnError: pandas is missing, or as :attr:`episodes`.
        """
        from wrongturn_client.rows import COLUMNS, episode_rows  # noqa: PLC0415 - only frames need it

        try:
            import pandas  # noqa: PLC0415 - an extra
        except ImportError as error:
            raise WrongturnError(f"to_frame: needs pandas, which is missing: {install('pandas')}") from error
        return pandas.DataFrame(episode_rows(self.episodes), columns=list(COLUMNS))

    def _repr_mimebundle_(self, **chosen: Any) -> dict[str, str]:
        """Return the table of its results for IPython; a line of text before it is finished."""
        from wrongturn_client.tables import evaluation_table  # noqa: PLC0415 - only notebooks need it

        if self.metrics is None:
            return {"text/plain": repr(self)}
        return dict(evaluation_table(self.suite, self.metrics)._repr_mimebundle_(**chosen))


class EpisodePage(EpisodeList):
    """A page of an evaluation's episodes."""

    episodes: tuple[Episode, ...]


def check_finished(evaluation: EvaluationDetail, remedy: str) -> None:
    """Raise NotFinishedError unless an evaluation is finished, so that its episodes can be had."""
    if evaluation.state is EvaluationState.CANCELLED:
        raise NotFinishedError(f"evaluation: {evaluation.id} was cancelled, so it has no episodes")
    if evaluation.state is not EvaluationState.FINISHED:
        done = f"{evaluation.finished} of {evaluation.trials} episodes"
        raise NotFinishedError(f"evaluation: {evaluation.id} is not finished ({done}); finish it first: {remedy}")


def plotted(trajectory: bytes, outcome: Outcome | None) -> "Figure":
    """Return a matplotlib figure of an episode. Another part draws it, or PluginError says what to install."""
    from wrongturn_client.plugins import entry_points, load  # noqa: PLC0415 - only figures need it

    point = next(iter(entry_points("wrongturn.plots").values()), None)
    if point is None:
        raise PluginError(f"plot: nothing here draws; wrongturn-service does: {install('wrongturn-service[plot]')}")
    figure: Figure = load(point)(trajectory, outcome)
    return figure


def at(found: M, url: str) -> M:
    """Tell a message which service has the rest of it, and return the message."""
    found._url = url
    return found


def keep(evaluation: Evaluation, episodes: tuple[Episode, ...]) -> None:
    """Keep an evaluation's episodes, so that they are there when the service is gone."""
    vars(evaluation)["episodes"] = episodes  # where cached_property looks first


def run_lines(client: "Client", evaluation: str) -> Iterator[bytes]:
    """Yield the lines of an evaluation's run file. Each trajectory is fetched when its line is next."""
    detail = client.evaluation(evaluation)
    check_finished(detail, f"wrongturn run --resume {evaluation}")
    head = {
        **detail.model_dump(mode="json"),
        "suite_sha256": client.suite(detail.suite).sha256,
        "driver": client.agent(detail.agent).model_dump(mode="json"),
    }
    yield json.dumps(head).encode()[:-1] + b', "episodes": [\n'
    between = b""
    for episode in client.finished_episodes(evaluation):
        yield between + _line(client, episode)
        between = b",\n"
    yield b"\n]}\n"


def _line(client: "Client", episode: EpisodeDetail) -> bytes:
    """Return an episode as JSON. The trajectory keeps its bytes, so that its checksum stays right."""
    known = episode.model_dump(mode="json", include={"id", "trial", "outcome"})
    trajectory = client.trajectory(episode.id) if episode.trajectory_sha256 is not None else b""
    return json.dumps(known).encode()[:-1] + b', "trajectory": ' + (trajectory or b"null") + b"}"
