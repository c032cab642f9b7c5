"""What a doubt is worth, by hand values, and the pages' tables of what is kept."""

import numpy as np
import pytest

pytest.importorskip("onnxruntime")

from lab import doubting
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS


def test_auroc_and_risk_by_hand():
    scores, wrong = np.array([0.1, 0.4, 0.35, 0.8]), np.array([False, False, True, True])
    assert doubting.auroc(scores, wrong) == 0.75
    assert doubting.risk(scores, np.array([False, True, False, True]), (0.0, 0.25, 0.5)) == [0.5, 1 / 3, 0.0]


def test_what_is_kept_is_of_the_files_that_are_shipped():
    for (study, name, _), found in doubting.read().items():
        files = [doubting.sha256(file) for file in DOUBTING_AGENTS[name].files]
        assert found["files"] == files, f"python -m lab.doubting {study} {name}"
