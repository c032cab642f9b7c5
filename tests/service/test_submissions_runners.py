"""Runners are spoken with strictly, get no secrets, and end with all their processes."""

import asyncio
import os
import sys
import textwrap
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import structlog
from guest_processes import gone, wait_until

from wrongturn_protocol import Track
from wrongturn_runner.messages import CheckJob, Described, Passed, PracticeJob, Progressed, Refused
from wrongturn_service.submissions.local_runners import LocalRunners
from wrongturn_service.submissions.runners import Runner, RunnerLostError

JOB = CheckJob(model=Path("/models/su_1.onnx"), sha256="0" * 64, memory=1 << 30, tracks=(Track.CAMERA,), url="http://x")


@asynccontextmanager
async def program(
    text: str, environment: dict[str, str] | None = None, halt: asyncio.Event | None = None
) -> AsyncIterator[Runner]:
    """A runner that is this Python program; ``job`` is the first line that it reads."""
    head = "import json, os, signal, sys, time\njob = json.loads(sys.stdin.readline())\n"
    head += "say = lambda **message: print(json.dumps(message), flush=True)\n"
    command = (sys.executable, "-c", head + textwrap.dedent(text))
    runners = LocalRunners(command, os.environ if environment is None else environment)
    async with runners.start(JOB, "su_1", halt or asyncio.Event()) as started:
        yield started


async def heard(text: str) -> list[object]:
    async with program(text) as started:
        return [event async for event in started.events()]


async def test_a_runner_hears_its_job_as_it_is_and_its_practice() -> None:
    told = []
    async with program("""
        say(event="described", track="camera", description=json.dumps(job))
        practice = json.loads(sys.stdin.readline())
        say(event="passed", step_ms=[1.5, 2.5])
        """) as started:
        async for event in started.events():
            told.append(event)
            if isinstance(event, Described):
                await started.send(PracticeJob(token="t", suite="smoke@3", trial="a"))
    first, last = told
    assert CheckJob.model_validate_json(first.description) == JOB
    assert last == Passed(step_ms=(1.5, 2.5))


async def test_nothing_is_heard_after_the_last_word() -> None:
    said = 'say(event="progressed", finished=1, episodes=2); say(event="refused", reason="NaN"); say(event="driven")'
    assert await heard(said) == [Progressed(finished=1, episodes=2), Refused(reason="NaN")]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("sys.exit(3)", "ended with status 3"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "was ended by signal 9"),
        ("print('hello', flush=True)", "no message"),
        ("say(event='passed')", "no message"),
        ("say(event='passed', step_ms=[], verdict='safe')", "no message"),
        ("say(event='won')", "no message"),
        ("sys.stdout.write(json.dumps({'event': 'driven'})); sys.stdout.flush()", "ended with status 0"),
        ("print('x' * (1 << 20), flush=True); time.sleep(600)", "more than 65536 bytes"),
        ("sys.stdout.buffer.write(bytes(range(256)) + b'\\n'); sys.stdout.flush(); time.sleep(600)", "no message"),
        ("os.close(1); time.sleep(600)", "closed its stdout"),
    ],
)
async def test_any_other_end_is_the_infrastructures_fault(text: str, why: str) -> None:
    with pytest.raises(RunnerLostError, match=why):
        await heard(text)


async def test_a_program_that_is_not_there_is_the_infrastructures_fault() -> None:
    with pytest.raises(RunnerLostError, match="could be started"):
        async with LocalRunners(("/nowhere/wrongturn-runner",)).start(JOB, "su_1", asyncio.Event()):
            raise AssertionError("it was started")


async def test_a_runner_ends_with_its_whole_group_even_if_it_ignores_signals() -> None:
    async with program("""
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        child = os.fork()
        if child:
            say(event="described", track="camera", description=f"{os.getpid()} {child}")
        time.sleep(600)
        """) as started:
        described = await anext(started.events())
        assert isinstance(described, Described)
        pids = [int(pid) for pid in described.description.split()]
        assert not any(map(gone, pids))
    await asyncio.to_thread(wait_until, lambda: all(map(gone, pids)))


async def test_a_job_that_is_cancelled_ends_its_runner() -> None:
    pids: list[int] = []

    async def job() -> None:
        text = 'say(event="described", track="camera", description=str(os.getpid())); time.sleep(600)'
        async with program(text) as started:
            async for event in started.events():
                assert isinstance(event, Described)
                pids.append(int(event.description))

    task = asyncio.create_task(job())
    while not pids:  # noqa: ASYNC110
        await asyncio.sleep(0.01)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert gone(pids[0])


async def test_a_runner_gets_none_of_the_services_secrets() -> None:
    environment = {
        **os.environ,
        "WRONGTURN_OPERATOR_TOKEN": "secret",
        "WRONGTURN_DATABASE": "postgresql://u:secret@h/d",
        "PGPASSWORD": "secret",
        "HTTP_PROXY": "http://u:secret@proxy",
    }
    text = 'say(event="refused", reason=json.dumps([dict(os.environ), os.nice(0), os.getcwd()]))'
    async with program(text, environment) as started:
        async for event in started.events():
            assert isinstance(event, Refused)
            assert "secret" not in event.reason
            assert '"PATH"' in event.reason
            assert event.reason.endswith(', "/"]')


async def test_stderr_is_kept_for_the_operator_and_bounded() -> None:
    text = 'sys.stderr.write("x" * 1_000_000 + "the end"); sys.stderr.flush(); say(event="driven")'
    with structlog.testing.capture_logs() as lines:
        async with program(text) as started:
            assert [event.event async for event in started.events()] == ["driven"]
    (line,) = [line for line in lines if "stderr" in line]
    said = str(line["stderr"])
    assert said.endswith("the end")
    assert len(said) < 10_000
    assert line["submission"] == "su_1"
