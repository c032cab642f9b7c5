"""Suites: what is in them, and that they stay as they are."""

import dataclasses
import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from wrongturn_networks import (
    CorruptFileError,
    NetworkError,
    Suite,
    UnknownSuiteError,
    UnknownTrialError,
    load_suite,
    load_town,
    read_suite,
    suite_ids,
)
from wrongturn_networks.catalogue import list_suites
from wrongturn_networks.suites import SUITES, canonical, check_suite
from wrongturn_protocol import Fault, FaultKind, JunctionType

PINNED = {
    "disturbed@1": "e99ad951e99513ad94d126deed598a8290d8d24c1a1edfc08151f09173e083f8",
    "navigation@1": "9b57c582ae19be91c7bb3ba9b87988bc005107f2009bd72ea038f1b828914383",
    "navigation-unseen@1": "3b0b3456b08c8da6ed6222531c4aca7448ccf7a30599932f4f0d9155e05eb5c7",
    "smoke@3": "41f1d16637204e49fed03d103299631b0a580bf049088a37259653871080435e",
    "wrong-command-extended@1": "7538006e2fd66caf16cca3c334c39b50b2b9aa7f850993c709bc0e51c877aecb",
    "wrong-command-unseen@1": "ffb57b4a6b902d8d59a39d53ebde2ab5f282b21dbf8589cadfe8fa429c47388a",
    "wrong-command@3": "c43d81383f34eefde124ac9dca2b56a5e4abd1b52d7eb173d332b0831860e1db",
}
"""Suites never change: a change to one of them needs a new version."""
TOWN_PINNED = {
    "Town01": "b2d09dfbb02da00ad9de76f7f7d12a5aa1ccc373e9011a8dc5a08529b4b2152c",
    "Town02": "132364253d662fcb919faa0893eb548dbec0d2a5d16a14848ec808813e4da3c6",
}
"""A suite measures its towns too: changed streets or houses need a new version of the suite."""


TOWNS_STAND = [name for name in suite_ids() if not load_suite(name).makes_towns]
"""Suites whose towns are there before a secret is."""


@pytest.fixture(params=TOWNS_STAND)
def suite(request: pytest.FixtureRequest) -> Suite:
    """Each shipped suite in turn, but those that build towns."""
    return load_suite(request.param)


@pytest.fixture(params=("smoke@3", "wrong-command@3"))
def paired(request: pytest.FixtureRequest) -> Suite:
    """Each suite whose trials have twins."""
    return load_suite(request.param)


def test_suites_have_not_changed() -> None:
    assert {name: load_suite(name).sha256 for name in suite_ids()} == PINNED


def test_the_suites_town_has_not_changed() -> None:
    towns = {trial.town for name in TOWNS_STAND for trial in load_suite(name).trials}
    assert {town: load_town(town).sha256 for town in towns} == TOWN_PINNED


def test_a_secret_draws_ten_towns_of_its_own() -> None:
    suite = load_suite("wrong-command-unseen@1")
    towns = suite.drawn_towns("a secret")
    assert len(set(towns)) == 10
    assert set(towns).isdisjoint(suite.drawn_towns("another secret"))


def test_what_the_service_shows(paired: Suite) -> None:
    check_suite(paired)
    summary = paired.summary()
    assert summary in list_suites()
    assert (summary.trials, summary.twins) == (len(paired.trials), len(paired.trials))
    shown = paired.trial_list().trials
    assert [(trial.id, trial.twin) for trial in shown] == [(trial.id, trial.twin().id) for trial in paired.trials]


def test_what_the_service_shows_of_a_journey() -> None:
    suite = load_suite("navigation@1")
    for shown, trial in zip(suite.trial_list().trials, suite.trials, strict=True):
        assert (shown.id, shown.twin, shown.journey) == (trial.id, None, trial.journey)
    assert "journey" in shown.model_dump()
    assert "journey" not in load_suite("smoke@3").trial_list().trials[0].model_dump()


@pytest.mark.parametrize(
    "name", ["", "smoke", "smoke@2", "smoke@3.json", "../suites/smoke@3", "smoke@3\n", "*@*", None, 1, []]
)
def test_an_unknown_suite_names_the_known(name: Any) -> None:
    with pytest.raises(UnknownSuiteError, match=r"^suite: .*smoke@3, .*wrong-command-unseen@1, wrong-command@3"):
        load_suite(name)


def test_an_unknown_trial(suite: Suite) -> None:
    with pytest.raises(UnknownTrialError, match=r"^trial: 'Town01\.J1-E\.stuck\.s1'"):
        suite.trial("Town01.J1-E.stuck.s1")


def test_a_suite_cannot_be_changed(suite: Suite) -> None:
    with pytest.raises(AttributeError):
        suite.trials = ()  # type: ignore[misc]
    with pytest.raises(ValueError, match="frozen"):
        suite.trials[0].seed = 1


def test_a_changed_file_is_found_out(tmp_path: Path) -> None:
    path = tmp_path / "navigation@1.json"
    content = json.loads((SUITES / path.name).read_text("utf-8"))
    path.write_text(json.dumps(content), "utf-8")
    assert read_suite(path).trials == load_suite("navigation@1").trials  # white space is no change
    content["trials"][0]["start"]["speed"] += 0.001
    path.write_text(json.dumps(content), "utf-8")
    with pytest.raises(CorruptFileError, match="was changed"):
        read_suite(path)


def test_a_suite_by_another_name_is_found_out(tmp_path: Path) -> None:
    path = tmp_path / "smoke@1.json"
    shutil.copy(SUITES / "smoke@3.json", path)
    with pytest.raises(CorruptFileError, match="smoke@1"):
        read_suite(path)


@pytest.mark.parametrize("kept", [(), ("trials", "cells")])
def test_a_file_has_either_trials_or_cells(kept: tuple[str, ...], tmp_path: Path) -> None:
    both = [json.loads((SUITES / f"{name}.json").read_text("utf-8")) for name in ("navigation@1", "smoke@3")]
    content = {**both[0], **both[1]}
    del content["sha256"]
    content = {name: value for name, value in content.items() if name not in {"trials", "cells"} or name in kept}
    path = tmp_path / "smoke@3.json"
    path.write_text(json.dumps({"sha256": hashlib.sha256(canonical(content)).hexdigest(), **content}), "utf-8")
    with pytest.raises(CorruptFileError, match=r"^suite smoke@3: .*either trials or cells"):
        read_suite(path)


@pytest.mark.parametrize("text", [b"", b"[]", b"{}", b"null", b"\xff\xfe", b'{"sha256": 3}'])
def test_a_file_that_is_no_suite(text: bytes, tmp_path: Path) -> None:
    path = tmp_path / "smoke@1.json"
    path.write_bytes(text)
    with pytest.raises(CorruptFileError, match="smoke@1"):
        read_suite(path)


def test_a_file_without_a_field_says_which(tmp_path: Path) -> None:
    path = tmp_path / "smoke@1.json"
    path.write_text('{"trials": []}', "utf-8")
    with pytest.raises(CorruptFileError, match=r"^suite smoke@1: 'sha256' is missing; .*write_suite$"):
        read_suite(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"town": "nowhere"}, "'nowhere' is not known"),
        ({"approach": "J1-S"}, "'J1-S' is not known"),
        ({"junction_type": JunctionType.CROSS}, r"s\d+ has the junction type CROSS, and its approach is STRAIGHT_"),
        ({"fault": Fault(kind=FaultKind.CUSTOM)}, "custom is not installed"),
    ],
)
def test_a_suite_of_another_package_is_checked(change: dict[str, Any], message: str) -> None:
    suite = load_suite("smoke@3")
    trial = suite.trials[0].model_copy(update=change)
    with pytest.raises(NetworkError, match=message):
        check_suite(dataclasses.replace(suite, cells=(), listed=(trial,)))
