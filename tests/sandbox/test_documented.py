"""The page on models tells the contract, and the rules and limits that a model is checked by."""

import re
from pathlib import Path

import onnx
import pytest

from wrongturn_protocol.model_contract import CONTROLS, MAX_STATE_BYTES, OPSETS
from wrongturn_runner.pace import CHECK_DEADLINE_S, CHECK_STEP_S, DRIVE_DEADLINE_S, DRIVE_STEP_S, LOAD_S
from wrongturn_sandbox import rules
from wrongturn_sandbox.rules import CONTROL_FLOW, GROUPS, OPERATORS, RANDOM
from wrongturn_service.settings import Settings

PAGE = (Path(__file__).parents[2] / "docs" / "models.md").read_text(encoding="utf-8")
MOSTS = sorted(name for name in vars(rules) if name.endswith("_MOST"))


def row(name: str) -> str:
    """Return the second column of a table's row."""
    (found,) = re.findall(rf"^\| {re.escape(name)} \| (.*?) \|$", PAGE, re.MULTILINE)
    return str(found)


@pytest.mark.parametrize("kind", sorted(GROUPS))
def test_every_operator_is_listed_under_its_kind(kind: str) -> None:
    assert set(re.findall(r"`(\w+)`", row(kind))) == GROUPS[kind]


@pytest.mark.parametrize("name", MOSTS)
def test_every_limit_is_told(name: str) -> None:
    assert f"| {getattr(rules, name):,} |" in PAGE


def test_the_versions_and_the_contracts_table() -> None:
    assert row("IR version") == f"{rules.IR_VERSIONS[0]} to {rules.IR_VERSIONS[-1]}"
    assert row("opset") == f"{OPSETS[0]} to {OPSETS[1]}, of ONNX's default domain"
    assert (rules.OPSETS[0], rules.OPSETS[-1]) == OPSETS
    sets = "; or ".join(" and ".join(f"`{name}`" for name in names) for names in CONTROLS)
    assert row("outputs").startswith(
        "one of three sets: " + sets.replace("`steer` and `throttle`", "`steer`, `throttle`")
    )
    assert row("state").endswith("at most 1 MiB")
    assert rules.OUTPUT_MOST * 4 >= MAX_STATE_BYTES == 1 << 20


def test_the_limits_of_service_and_runner() -> None:
    settings = Settings.model_fields
    assert f"{settings['model_limit'].default:,} bytes (128 MiB)" in row("file")
    assert f"{settings['model_memory'].default:,} bytes (2 GiB)" in row("memory")
    assert row("time to load") == f"{LOAD_S:g} s"
    check = f"{CHECK_DEADLINE_S:g} s, and {CHECK_STEP_S:g} s on average"
    drive = f"{DRIVE_DEADLINE_S:g} s, and {DRIVE_STEP_S:g} s on average"
    assert row("a step") == f"in the check {check}; in the drive {drive}"


def test_the_allowed_operators_exist_and_hold_no_graph() -> None:
    known = {schema.name: schema for schema in onnx.defs.get_all_schemas() if schema.domain == ""}
    assert set(known) >= OPERATORS | CONTROL_FLOW | RANDOM
    graphs = {
        name
        for name, schema in known.items()
        if any(attribute.type in {onnx.defs.OpSchema.AttrType.GRAPH} for attribute in schema.attributes.values())
    }
    assert graphs == CONTROL_FLOW
    assert not OPERATORS & (CONTROL_FLOW | RANDOM)
    assert not {name for name in OPERATORS if name.startswith(("Random", "String", "Sequence", "Optional", "Image"))}
