"""A host tells a sandbox that was ended from outside from a model that is at fault."""

import os
import signal
import threading

import numpy as np
import pytest
from corpus import CORPUS
from guest_processes import bubblewrap_and_guest, children, gone, wait_until
from upload_models import model

from wrongturn_sandbox import Limits, ModelRefusedError, Sandbox, SandboxLostError, open_sandbox

LIMITS = Limits(memory=1 << 30, load_s=60, step_s=60)
SPEED = {"speed": np.zeros((1, 1), np.float32)}
SLOW = next(case for case in CORPUS if case.name == "time-at-a-step")


def run_for_ever(sandbox: Sandbox) -> None:
    while True:
        sandbox.run(SPEED)


@pytest.mark.usefixtures("bubblewrap")
@pytest.mark.parametrize("which", [0, 1], ids=["bubblewrap", "guest"])
def test_killed_from_outside(which: int) -> None:
    with open_sandbox(None, LIMITS) as sandbox:
        sandbox.load(model())
        os.kill(bubblewrap_and_guest()[which], signal.SIGKILL)
        with pytest.raises(SandboxLostError, match="outside"):
            run_for_ever(sandbox)  # the kernel may take a moment


@pytest.mark.usefixtures("bubblewrap")
@pytest.mark.parametrize("which", [0, 1], ids=["bubblewrap", "guest"])
def test_killed_in_the_midst_of_a_step(which: int) -> None:
    with open_sandbox(None, LIMITS) as sandbox:
        sandbox.load(SLOW.make())
        timer = threading.Timer(0.5, os.kill, (bubblewrap_and_guest()[which], signal.SIGKILL))
        timer.start()
        with pytest.raises(SandboxLostError, match="outside"):
            sandbox.run(SPEED)
        timer.join()


@pytest.mark.usefixtures("bubblewrap")
def test_a_crash_is_the_models_fault() -> None:
    with open_sandbox(None, LIMITS) as sandbox:
        sandbox.load(model())
        os.kill(bubblewrap_and_guest()[1], signal.SIGSEGV)
        with pytest.raises(ModelRefusedError, match=r"crashes onnxruntime \(SIGSEGV\)"):
            sandbox.run(SPEED)


@pytest.mark.usefixtures("bubblewrap")
def test_processor_time_is_limited_where_no_host_watches() -> None:
    with open_sandbox(None, Limits(memory=1 << 30, load_s=60, step_s=0.5)) as sandbox:
        sandbox.load(SLOW.make())
        sandbox._limits = LIMITS  # the host would wait; the guest still goes by half a second
        with pytest.raises(ModelRefusedError, match="processor time"):
            sandbox.run(SPEED)


@pytest.mark.usefixtures("bubblewrap")
@pytest.mark.parametrize("how", ["close", "deadline", "thread"])
def test_nothing_is_left_behind(how: str) -> None:
    pids: list[int] = []

    def use() -> None:
        sandbox = open_sandbox(None, Limits(memory=1 << 30, load_s=60, step_s=60 if how != "deadline" else 0.2))
        bubblewrap, _ = bubblewrap_and_guest()
        pids.extend([bubblewrap, *children(bubblewrap)])
        sandbox.load(SLOW.make())
        if how == "close":
            sandbox.close()
        if how == "deadline":
            with pytest.raises(ModelRefusedError, match=r"longer than 0\.2 s"):
                sandbox.run(SPEED)
        if how == "thread":
            kept.append(sandbox)

    kept: list[Sandbox] = []
    thread = threading.Thread(target=use)
    thread.start()
    thread.join()
    assert len(pids) == 3
    wait_until(lambda: all(map(gone, pids)))
    for sandbox in kept:
        with pytest.raises(SandboxLostError):
            sandbox.run(SPEED)
        sandbox.close()
