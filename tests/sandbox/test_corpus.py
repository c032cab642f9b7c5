"""Each upload of the corpus is refused or stopped, and the reason says why."""

import mmap
import time
from pathlib import Path

import numpy as np
import pytest
from corpus import CORPUS, By, Case
from corpus_files import MARK

from wrongturn_protocol.model_contract import ContractError, ModelSignature, TensorSpec, contract_of
from wrongturn_sandbox import Description, Limits, ModelRefusedError, Sandbox, open_sandbox

pytestmark = pytest.mark.slow

TIME = 60.0
"""Seconds, with room for a busy machine."""
LIMITS = Limits(memory=1 << 30)
PATIENT = Limits(memory=1 << 30, load_s=TIME, step_s=TIME)
"""For uploads that something else than time refuses, however busy the machine is."""
STEPS = 2


def put_in(sandbox: Sandbox, file: Path) -> Description:
    with file.open("rb") as opened:
        if file.stat().st_size == 0:
            return sandbox.load(b"")
        with mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as mapped, memoryview(mapped) as model:
            return sandbox.load(model)


def step(sandbox: Sandbox, description: Description) -> dict[str, np.ndarray]:
    shapes = {put.name: [size if isinstance(size, int) else 1 for size in put.shape] for put in description.inputs}
    inputs = {put.name: np.ones(shapes[put.name], put.dtype) for put in description.inputs}
    return [sandbox.run(inputs) for _ in range(STEPS)][-1]


def check_contract(sandbox: Sandbox, description: Description) -> None:
    inputs = tuple(TensorSpec(put.name, put.dtype, put.shape) for put in description.inputs)
    outputs = tuple(TensorSpec(put.name, put.dtype, put.shape) for put in description.outputs)
    contract = contract_of(ModelSignature(inputs, outputs, description.opset, description.metadata))
    contract.action(step(sandbox, description))


def reason(place: Path | None, case: Case, file: Path) -> str:
    """Return why an upload is refused, once the right one has refused it in time."""
    with open_sandbox(place, LIMITS if "longer" in case.words else PATIENT) as sandbox:
        began = time.monotonic()
        if case.by in {By.LOAD, By.SIZE}:
            with pytest.raises(ModelRefusedError) as refused:
                put_in(sandbox, file)
        elif case.by is By.STEP:
            description = put_in(sandbox, file)
            with pytest.raises(ModelRefusedError) as refused:
                step(sandbox, description)
        else:
            with pytest.raises(ContractError) as refused:
                check_contract(sandbox, put_in(sandbox, file))
        assert time.monotonic() - began < TIME
    return str(refused.value)


def check(place: Path | None, case: Case, folder: Path) -> None:
    file = case.write(folder)
    try:
        said = reason(place, case, file)
    finally:
        file.unlink()
    assert case.words.lower() in said.lower()
    assert said.isprintable()
    assert len(said) <= 400
    for place_of_this_machine in (
        str(folder),
        str(Path.home()) + "/",
        "/onnxruntime_src",
        "/usr/",
        "/packages",
        "root:",
    ):
        assert place_of_this_machine not in said
    assert not list(folder.iterdir())
    assert not MARK.exists()


def test_the_corpus_is_large() -> None:
    names = [case.name for case in CORPUS]
    assert len(set(names)) == len(names) >= 100
    assert all(case.words for case in CORPUS)


@pytest.mark.parametrize("case", CORPUS, ids=lambda case: case.name)
@pytest.mark.usefixtures("bubblewrap")
def test_under_bubblewrap(case: Case, tmp_path: Path) -> None:
    check(None, case, tmp_path)


@pytest.mark.parametrize("case", [case for case in CORPUS if case.by is By.STEP], ids=lambda case: case.name)
def test_in_a_runner_container(case: Case, listener: Path, tmp_path: Path) -> None:
    check(listener, case, tmp_path)
