"""The documentation tells the rules that a model is checked by."""

import re
from pathlib import Path

import onnx
import pytest

from wrongturn_protocol.model_contract import MAX_STATE_BYTES, OPSETS
from wrongturn_sandbox import rules
from wrongturn_sandbox.operators import CONTROL_FLOW, GROUPS, OPERATORS, RANDOM

PAGE = (Path(__file__).parents[2] / "docs" / "sandbox.md").read_text(encoding="utf-8")
MOSTS = sorted(name for name in vars(rules) if name.endswith("_MOST"))


@pytest.mark.parametrize("kind", sorted(GROUPS))
def test_every_operator_is_listed_under_its_kind(kind: str) -> None:
    (row,) = re.findall(rf"^\| {kind} \| (.*) \|$", PAGE, re.MULTILINE)
    assert set(re.findall(r"`(\w+)`", row)) == GROUPS[kind]


@pytest.mark.parametrize("name", MOSTS)
def test_every_limit_is_told(name: str) -> None:
    assert f"| {getattr(rules, name):,} |" in PAGE


def test_versions_are_told_and_are_the_contracts() -> None:
    assert f"| IR version | {rules.IR_VERSIONS[0]} to {rules.IR_VERSIONS[-1]} |" in PAGE
    assert f"| opset | {rules.OPSETS[0]} to {rules.OPSETS[-1]} of" in PAGE
    assert (rules.OPSETS[0], rules.OPSETS[-1]) == OPSETS
    assert rules.OUTPUT_MOST * 4 >= MAX_STATE_BYTES


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
