"""Runners are spoken with strictly, get no secrets, and end with all their processes."""

import asyncio
import os
import sys
import textwrap
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
import structlog

from wrongturn_protocol import Track
from wrongturn_runner.messages import CheckJob, Described, Passed, PracticeJob, Progressed, Refused
from wrongturn_service.submissions.runners import Runner, RunnerLostError, runner

JOB = CheckJob(model=Path("/models/su_1.onnx"), sha256="0" * 64, memory=1 << 30, tracks=(Track.CAMERA,), url="http://x")


@asynccontextmanager
async def program(
    text: str, environment: dict[str, str] | None = None, halt: asyncio.Event | None = None
) -> AsyncIterator[Runner]:
    """A runner that is this Python program; ``job`` is the first line that it reads."""
    head = "import json, os, signal, sys, time\njob = json.loads(sys.stdin.readline())\n"
    head += "say = lambda **message: print(json.dumps(message), flush=True)\n"
    command = (sys.executable, "-c", head + textwrap.dedent(text))
    async with runner(JOB, "su_1", command, halt, os.environ if environment is None else environment) as started:
        yield started


async def heard(text: str) -> list[object]:
    async with program(text) as started:
        return [event async for event in started.events()]


def gone(pid: int) -> bool:
    """Whether a process has ended. It may still stand in the table until somebody asks for its status."""
    try:
        return "\nState:\tZ" in Path(f"/proc/{pid}/status").read_text()
    except FileNotFoundError:
        return True


def eventually_gone(pid: int) -> bool:
    deadline = time.monotonic() + 120
    while not gone(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    return gone(pid)


def test_a_runner_hears_its_job_as_it_is_and_its_practice() -> None:
    async def story() -> None:
        told = []
        async with program("""
            say(event="described", track="camera", description=json.dumps(job))
            practice = json.loads(sys.stdin.readline())
            say(event="passed", step_ms=[1.5, 2.5])
            """) as started:
            async for event in started.events():
                told.append(event)
                if isinstance(event, Described):
                    await started.send(PracticeJob(token="t", suite="smoke@2", trial="a"))
        first, last = told
        assert CheckJob.model_validate_json(first.description) == JOB
        assert last == Passed(step_ms=(1.5, 2.5))

    asyncio.run(story())


def test_nothing_is_heard_after_the_last_word() -> None:
    said = 'say(event="progressed", finished=1, episodes=2); say(event="refused", reason="NaN"); say(event="driven")'
    assert asyncio.run(heard(said)) == [Progressed(finished=1, episodes=2), Refused(reason="NaN")]


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
def test_any_other_end_is_the_infrastructures_fault(text: str, why: str) -> None:
    with pytest.raises(RunnerLostError, match=why):
        asyncio.run(heard(text))


def test_a_program_that_is_not_there_is_the_infrastructures_fault() -> None:
    async def story() -> None:
        async with runner(JOB, "su_1", ("/nowhere/wrongturn-runner",)):
            raise AssertionError("it was started")

    with pytest.raises(RunnerLostError, match="could be started"):
        asyncio.run(story())


def test_a_runner_ends_with_its_whole_group_even_if_it_ignores_signals() -> None:
    async def story() -> list[int]:
        async with program("""
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            child = os.fork()
            if child:
                say(event="described", track="camera", description=f"{os.getpid()} {child}")
            time.sleep(600)
            """) as started:
            async for event in started.events():
                assert isinstance(event, Described)
                pids = [int(pid) for pid in event.description.split()]
                assert not any(gone(pid) for pid in pids)
                return pids
        raise AssertionError("it said nothing")

    assert all(eventually_gone(pid) for pid in asyncio.run(story()))


def test_a_job_that_is_cancelled_ends_its_runner() -> None:
    async def story() -> int:
        pids: list[int] = []

        async def job() -> None:
            async with program(
                'say(event="described", track="camera", description=str(os.getpid())); time.sleep(600)'
            ) as started:
                async for event in started.events():
                    assert isinstance(event, Described)
                    pids.append(int(event.description))

        task = asyncio.create_task(job())
        while not pids:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        return pids[0]

    assert gone(asyncio.run(story()))


def test_a_runner_gets_none_of_the_services_secrets() -> None:
    async def story() -> None:
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

    asyncio.run(story())


def test_stderr_is_kept_for_the_operator_and_bounded() -> None:
    async def story() -> list[dict[str, object]]:
        with structlog.testing.capture_logs() as lines:
            async with program(
                'sys.stderr.write("x" * 1_000_000 + "the end"); sys.stderr.flush(); say(event="driven")'
            ) as started:
                assert [event.event async for event in started.events()] == ["driven"]
        return list(lines)

    (line,) = [line for line in asyncio.run(story()) if "stderr" in line]
    said = str(line["stderr"])
    assert said.endswith("the end")
    assert len(said) < 10_000
    assert line["submission"] == "su_1"
