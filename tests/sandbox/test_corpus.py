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
from wrongturn_sandbox.checking import check
from wrongturn_sandbox.reasons import printable
from wrongturn_sandbox.session import Session

TIME = 60.0
"""Seconds, with room for a busy machine."""
LIMITS = Limits(memory=1 << 30)
PATIENT = Limits(memory=1 << 30, load_s=TIME, step_s=TIME)
"""For uploads that something else than time refuses, however busy the machine is."""
STEPS = 2
TO_THE_GUEST = {"pickle", "external-data-absolute", "loop-without-end"}
"""Uploads that the check refuses, some of which a guest gets too."""
OF_A_CONTAINER = {"crash", "memory-expand", "time-at-a-step"}
"""Uploads that end a guest in a way that its listener has to tell."""


def of(*kinds: By) -> list[Case]:
    return [case for case in CORPUS if case.by in kinds]


def put_in(sandbox: Sandbox, file: Path) -> Description:
    with (
        file.open("rb") as opened,
        mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ) as mapped,
        memoryview(mapped) as model,
    ):
        return sandbox.load(model)


def step(model: Sandbox | Session, description: Description) -> dict[str, np.ndarray]:
    shapes = {put.name: [size if isinstance(size, int) else 1 for size in put.shape] for put in description.inputs}
    inputs = {put.name: np.ones(shapes[put.name], put.dtype) for put in description.inputs}
    return [model.run(inputs) for _ in range(STEPS)][-1]


def sandboxed(place: Path | None, case: Case, folder: Path) -> str:
    """Return why a sandbox refuses an upload, once it has done so in time."""
    file = case.write(folder)
    try:
        with open_sandbox(place, LIMITS if "longer" in case.words else PATIENT) as sandbox:
            began = time.monotonic()
            if case.by is By.STEP:
                description = put_in(sandbox, file)
                with pytest.raises(ModelRefusedError) as refused:
                    step(sandbox, description)
            else:
                with pytest.raises(ModelRefusedError) as refused:
                    put_in(sandbox, file)
            assert time.monotonic() - began < TIME
    finally:
        file.unlink()
    assert not list(folder.iterdir())
    return str(refused.value)


def check_reason(case: Case, said: str) -> None:
    assert case.words.lower() in said.lower()
    assert said.isprintable()
    assert len(said) <= 400
    for of_this_machine in (str(Path.home()) + "/", "/tmp/", "/onnxruntime_src", "/usr/", "/packages", "root:"):
        assert of_this_machine not in said
    assert not MARK.exists()


def test_the_corpus_is_large() -> None:
    names = {case.name for case in CORPUS}
    assert len(names) == len(CORPUS) >= 100
    assert all(case.words for case in CORPUS)
    assert names >= TO_THE_GUEST | OF_A_CONTAINER


@pytest.mark.parametrize("case", of(By.CHECK), ids=lambda case: case.name)
def test_the_check_refuses_it(case: Case) -> None:
    with pytest.raises(ModelRefusedError) as refused:
        check(case.make())
    check_reason(case, printable(str(refused.value)))


@pytest.mark.parametrize("case", of(By.CONTRACT), ids=lambda case: case.name)
def test_its_contract_refuses_it(case: Case) -> None:
    session = Session(bytearray(case.make()), PATIENT)
    description = session.description
    inputs, outputs = (
        tuple(TensorSpec(put.name, put.dtype, put.shape) for put in puts)
        for puts in (description.inputs, description.outputs)
    )
    signature = ModelSignature(inputs, outputs, description.opset, description.metadata)
    with pytest.raises(ContractError) as refused:
        contract_of(signature).action(step(session, description))
    check_reason(case, str(refused.value))


@pytest.mark.parametrize(
    "case",
    [*of(By.SIZE, By.LOAD, By.STEP), *(case for case in CORPUS if case.name in TO_THE_GUEST)],
    ids=lambda case: case.name,
)
@pytest.mark.usefixtures("bubblewrap")
def test_under_bubblewrap(case: Case, tmp_path: Path) -> None:
    check_reason(case, sandboxed(None, case, tmp_path))


@pytest.mark.parametrize("case", [case for case in CORPUS if case.name in OF_A_CONTAINER], ids=lambda case: case.name)
def test_in_a_runner_container(case: Case, listener: Path, tmp_path: Path) -> None:
    check_reason(case, sandboxed(listener, case, tmp_path))
