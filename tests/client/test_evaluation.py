"""A finished evaluation is looked at as a table, a frame and figures."""

import pickle
import re
import sys
from typing import Any

import pytest
from client_fake_service import FakeService

from wrongturn_client import (
    Action,
    Client,
    Episode,
    Evaluation,
    LocalService,
    NotFinishedError,
    PluginError,
    WrongturnError,
)
from wrongturn_client.rows import COLUMNS
from wrongturn_protocol import EpisodeState, EvaluationState, PracticeRequest, Track
from wrongturn_protocol.observations import Observation


class Off:
    """Drives off the road at once."""

    def reset(self, observation_space: Any) -> None:
        pass

    def act(self, observation: Observation) -> Action:
        return Action(steer=1, throttle=1, brake=0)


@pytest.fixture(scope="module")
def evaluation(service: LocalService) -> Evaluation:
    with Client(service.url, "") as client:
        token = client.register("off the road", "privileged").token
    with Client(service.url, token) as client:
        return client.evaluate(Off(), "smoke@3")


def test_a_frame_has_a_row_for_each_episode(evaluation: Evaluation, service: LocalService) -> None:
    frame = evaluation.to_frame()
    assert list(frame.columns) == list(COLUMNS)
    assert len(frame) == 12
    assert list(frame.episode) == [episode.id for episode in evaluation.episodes]
    trials, twins = frame[frame.fault != "none"], frame[frame.fault == "none"]
    assert evaluation.metrics is not None
    assert int(trials.unsafe_strict.sum()) == evaluation.metrics.unsafe_strict.count
    assert int(trials.unsafe.sum()) == evaluation.metrics.unsafe.count == 6
    assert set(trials.twin) == set(twins.trial)
    assert twins.twin.isna().all()
    assert list(trials.twin_verdict) == ["off_road"] * 6
    assert set(frame.town) == {"Town01"}
    assert set(trials.fault) == {"infeasible", "omission"}
    assert (frame.time > 0).all()
    assert (frame.start_speed > 0).all()
    with Client(service.url, "") as anybody:  # a finished evaluation is public
        found = anybody.evaluation(evaluation.id)
    assert found.to_frame().equals(frame)
    assert found == evaluation


def test_an_evaluation_needs_no_service_once_it_was_driven(evaluation: Evaluation) -> None:
    copy = pickle.loads(pickle.dumps(evaluation.model_copy()))
    copy._url = "http://127.0.0.1:9"
    assert copy.to_frame().equals(evaluation.to_frame())


def test_an_episode_draws_itself(evaluation: Evaluation, service: LocalService) -> None:
    frame = evaluation.to_frame()
    episode = evaluation.episode(frame.trial[0])
    assert episode is evaluation.episode(frame.episode[0])
    with Client(service.url, "") as anybody:
        figures = [episode.plot(), anybody.plot(episode.id)]
    for figure in figures:
        assert figure.axes[0].get_title() == frame.trial[0]
        assert "off" in figure.axes[1].get_title()
    assert repr(episode) == f"Episode(id='{episode.id}', trial='{episode.trial}', verdict='off_road')"
    with pytest.raises(WrongturnError, match=rf"Did you mean {re.escape(frame.trial[0])}\?"):
        evaluation.episode(frame.trial[0] + "x")
    with pytest.raises(WrongturnError, match=r"to_frame\(\) lists"):
        evaluation.episode("nothing like it")
    with pytest.raises(WrongturnError, match="has none"):
        Episode(id="ep", state=EpisodeState.FINISHED, seq=0).plot()


def test_a_notebook_shows_the_table(evaluation: Evaluation) -> None:
    shown = evaluation._repr_mimebundle_(include=None, exclude=None)
    assert "straight" in shown["text/html"]
    assert "6/6" in shown["text/plain"]
    assert repr(evaluation).startswith(f"Evaluation(id='{evaluation.id}', suite='smoke@3', state='finished'")


def test_a_practice_episode_tells_its_trial(service: LocalService) -> None:
    with Client(service.url, "") as client:
        token = client.register("practising", Track.PRIVILEGED).token
    with Client(service.url, token) as client:
        begun = client.practise(PracticeRequest(town="Town01", approach="J3-S", seed=3))
        detail = client.episode(begun.id)
        client.abort_episode(begun.id)
    assert detail.trial_detail is not None
    assert (detail.trial_detail.id, detail.trial_detail.approach) == (begun.trial, "J3-S")


def test_one_that_is_not_finished_says_so() -> None:
    with Client("http://fake", "secret", transport=FakeService().transport) as client:
        running = client.create_evaluation("smoke@3")
        for look in (running.to_frame, lambda: running.episodes, lambda: running.episode("x")):
            with pytest.raises(NotFinishedError, match=r"0 of 4 episodes.*client\.evaluate"):
                look()
        cancelled = running.model_copy(update={"state": EvaluationState.CANCELLED})
        with pytest.raises(NotFinishedError, match="was cancelled"):
            cancelled.to_frame()
        assert running._repr_mimebundle_() == {"text/plain": repr(running)}


def test_what_is_missing_is_named(evaluation: Evaluation, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(WrongturnError, match=r"to_frame: .*pip install pandas"):
        evaluation.to_frame()
    monkeypatch.setattr("wrongturn_client.plugins.entry_points", lambda group: {})
    with pytest.raises(PluginError, match=r"plot: .*pip install .*service\[plot\]"):
        evaluation.episodes[0].plot()


def test_progress_is_a_line_or_a_function(capsys: pytest.CaptureFixture[str]) -> None:
    fake = FakeService()
    with Client("http://fake", "secret", transport=fake.transport) as client:
        with pytest.raises(TypeError, match="progress: is 5; give True"):
            client.evaluate(Off(), "smoke@3", progress=5)  # type: ignore[arg-type]
        assert not fake.begun
        client.evaluate(Off(), "smoke@3", progress=True)
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.split("\r")[-1] == f"smoke@3: [{'#' * 30}] 4 of 4 episodes\n"
    assert told.err.count("\n") == 1
