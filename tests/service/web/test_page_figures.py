"""A figure from another package: what the docs show works."""

import re
from pathlib import Path

import pytest
from app_harness import application, play
from fake_pool import FakePool
from service_harness import expect
from stored_evaluation import outcome, store_evaluation

from wrongturn_networks import load_suite
from wrongturn_protocol import Verdict

DOCS = Path(__file__).parents[3] / "docs"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The page's example, installed, beside one that fails."""
    section = (DOCS / "extending.md").read_text("utf-8").split("## A figure of")[1].split("\n## ")[0]
    (source,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    (points,) = re.findall(r"```toml\n\[project\.entry-points\.\"(.*?)\"\]\n(.*?)```", section, re.DOTALL)
    (tmp_path / "aborted_share.py").write_text(source)
    told = tmp_path / "aborted_share-1.0.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: aborted-share\nVersion: 1.0\n")
    (told / "entry_points.txt").write_text(f"[{points[0]}]\n{points[1].replace(chr(34), '')}broken = gone:figure\n")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_a_figure_of_another_package_is_shown_beside_the_shipped_one(package: Path):
    async def story() -> None:
        async with application(package, FakePool()) as http:
            del http.headers["Authorization"]
            agent = expect(await http.post("/v1/agents", json={"name": "leaver", "track": "privileged"}), 201)["id"]
            board = "/leaderboards/smoke@2"
            assert "Aborted trials" not in (await http.get(board)).text
            service = http.app.state.service
            await store_evaluation(service, agent, load_suite("smoke@2"), lambda _: outcome(Verdict.ABORTED))
            page = (await http.get(board)).text
            assert '<h2 id="aborted-trials">Aborted trials</h2>' in page
            assert "<title>leaver</title>" in page
            assert '<h2 id="obedience-and-safety">Obedience and safety</h2>' in page
            assert "roken" not in page

    play(story)
