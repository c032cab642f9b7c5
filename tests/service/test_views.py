"""Views of practice, which the service's simulators draw for Gymnasium's environments."""

import gymnasium
import httpx
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from service_harness import Agent, RunningService, expect, problem

from wrongturn_client import RemoteEnv
from wrongturn_protocol.pixmap import from_pixmap, to_pixmap
from wrongturn_sim import WrongturnSimEnv

GAS = np.float32([0.1, 0.8, 0.0])


def test_the_environment_over_the_wire_draws_what_the_one_in_process_draws(service: RunningService) -> None:
    options = {"town": "junctions", "fault": "infeasible", "render_mode": "rgb_array"}
    with RemoteEnv(service.url, **options) as remote:
        with pytest.raises(ResetNeeded):
            remote.render()
        _, told = remote.reset(seed=3)
        near = WrongturnSimEnv(**options)
        near.reset(options={"trial": near._source.draw(np.random.default_rng(3))})
        assert near.episode.trial.id == told["trial"]
        ended = False
        while not ended:
            if near.episode.steps % 10 == 0:
                assert np.array_equal(remote.render(), near.render())
            *_, terminated, truncated, _ = remote.step(GAS)
            near.step(GAS)
            ended = terminated or truncated
        # The service draws the moment after the end from the stored trajectory.
        assert np.array_equal(remote.render()[:, :480], near.render()[:, :480])
        assert remote.metadata["render_modes"] == ["human", "rgb_array"]


def test_human_mode_over_the_wire_shows_the_services_pictures(service, monkeypatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame = pytest.importorskip("pygame")
    env = gymnasium.make("wrongturn_client:Wrongturn-v0", url=service.url, town="junctions", render_mode="human")
    env.reset(seed=1)
    env.step(GAS)
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    assert np.array_equal(shown, env.unwrapped._practice.client.view(env.unwrapped._episode.id))
    env.close()
    assert pygame.display.get_surface() is None


def test_only_the_agents_own_practice_has_a_view(service: RunningService, agent: Agent) -> None:
    practice = agent.practise()["id"]
    view = agent.http.get(f"/v1/episodes/{practice}/view")
    assert view.headers["content-type"] == "image/x-portable-pixmap"
    assert from_pixmap(view.content).shape == (480, 864, 3)
    with httpx.Client(base_url=service.url, timeout=60) as stranger, service.agent() as other:
        problem(stranger.get(f"/v1/episodes/{practice}/view"), 401, "unauthenticated")
        problem(other.http.get(f"/v1/episodes/{practice}/view"), 403, "forbidden")
    evaluation = agent.evaluate()["id"]
    scored = expect(agent.reset(evaluation), 201)["id"]
    problem(agent.http.get(f"/v1/episodes/{scored}/view"), 403, "forbidden")
    agent.http.delete(f"/v1/episodes/{scored}")
    problem(agent.http.get(f"/v1/episodes/{scored}/view"), 403, "forbidden")
    agent.http.delete(f"/v1/episodes/{practice}")
    assert from_pixmap(agent.http.get(f"/v1/episodes/{practice}/view").content).any()


def test_a_pixmap_is_what_it_was_made_of() -> None:
    image = np.random.default_rng(0).integers(0, 256, (3, 5, 3)).astype(np.uint8)
    assert np.array_equal(from_pixmap(to_pixmap(image)), image)
    for broken in (b"", b"P5\n1 1\n255\n\0", to_pixmap(image)[:-1], to_pixmap(image) + b"\0", b"P6\n0 1\n255\n"):
        with pytest.raises(ValueError, match="not a binary portable pixmap"):
            from_pixmap(broken)
