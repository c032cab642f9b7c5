"""Processes that start late, never, or end in between: with programs of a few lines in the simulators' place."""

import asyncio
import contextlib
import os
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import psutil
import pytest
from app_harness import until

from wrongturn_protocol import Track
from wrongturn_service.encoding import Encoding
from wrongturn_service.simulators.interface import (
    EpisodeRefusedError,
    SimulatorDiedError,
    SimulatorsBusyError,
    SimulatorStartError,
)
from wrongturn_service.simulators.local_simulator import LocalStarter
from wrongturn_service.simulators.pool import SimulatorPool

PROGRAM = """
import os, socket, sys, time
from msgpack import Unpacker, packb
from wrongturn_service.simulators.interface import FAILED, OK, REFUSED
connection = socket.socket(fileno=int(sys.argv[1]))
connection.sendall(packb([OK]))
for operation, *rest in Unpacker(connection.makefile("rb", 0)):
    if operation == "reset":
        time.sleep(3 if rest[0] == "slow" else 0)
        answer = [REFUSED, "FaultNotApplicableError", "not here"] if rest[0] == "bad" else \
            [OK, rest[0].encode(), 0.0, False, False, None]
    elif rest[0] == 0.25:
        os._exit(3)
    elif rest[0] == 0.5:
        time.sleep(60)
    elif rest[0] == 0.75:
        answer = [FAILED, "ValueError", "broken"]
    else:
        print("noise of a library")
        answer = [OK, b"x" * 200_000, 0.0, False, False, None]
    connection.sendall(packb(answer))
"""


@contextlib.asynccontextmanager
async def pool_of(
    program: str = PROGRAM, slots: int = 1, start: float = 120, call: float = 120, spare: int = 0
) -> AsyncIterator[SimulatorPool]:
    command = (sys.executable, "-c", program)
    starter = LocalStarter(start_timeout_s=start, timeout_s=call, command=command)
    pool = SimulatorPool(slots, starter.start, spare=spare)
    try:
        yield pool
    finally:
        await pool.stop()


async def test_a_process_inherits_no_secrets_and_no_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    secrets = ("WRONGTURN_OPERATOR_TOKEN", "WRONGTURN_METRICS_TOKEN", "WRONGTURN_DATABASE", "PGPASSWORD", "MY_TOKEN")
    for name in secrets:
        monkeypatch.setenv(name, "a-secret")
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path))

    async with pool_of() as pool:
        held = os.open(tmp_path, os.O_RDONLY)
        os.set_inheritable(held, True)
        simulator = await pool.acquire(("Town01", None), "a")
        os.close(held)
        process, own = Path(f"/proc/{simulator.process.pid}"), Path("/proc/self/fd")
        variables = dict(pair.split("=", 1) for pair in (process / "environ").read_text().split("\0") if pair)
        assert variables["WRONGTURN_HOME"] == str(tmp_path)
        assert "a-secret" not in variables.values()
        assert {name for name in variables if name.startswith("WRONGTURN_")} <= {"WRONGTURN_HOME", "WRONGTURN_KERNELS"}
        opened = {file.name: str(file.readlink()) for file in (process / "fd").iterdir()}
        assert opened.pop("0") == "/dev/null"
        # What it says goes where the service's log goes.
        assert opened.pop("1") == opened.pop("2") == str((own / "2").readlink())
        assert [target.partition(":")[0] for target in opened.values()] == ["socket"]


@pytest.mark.parametrize(("program", "start"), [("import sys; sys.exit(7)", 120), ("import time; time.sleep(60)", 0.3)])
async def test_one_that_ends_at_once_or_is_never_ready(program: str, start: float) -> None:
    async with pool_of(program, start=start) as pool:
        with pytest.raises(SimulatorStartError, match="did not get ready"):
            await pool.start()
        assert pool.running == 0


async def test_a_program_that_is_not_there() -> None:
    starter = LocalStarter(start_timeout_s=1, timeout_s=1, command=("/no/such/program",))
    pool = SimulatorPool(1, starter.start)
    with pytest.raises(SimulatorStartError, match="could be started"):
        await pool.acquire(("Town01", None), "a")
    assert pool.running == 0


async def test_who_waits_is_heard_when_the_other_ones_does_not_start() -> None:
    async with pool_of("import sys; sys.exit(7)", slots=3) as pool:

        async def acquire() -> None:
            with pytest.raises(SimulatorStartError, match="did not get ready"):
                await pool.acquire(("Town01", None), "a")

        await asyncio.wait_for(asyncio.gather(acquire(), acquire(), acquire()), 120)


@pytest.mark.parametrize(("steer", "message"), [(0.25, "ended"), (0.5, "within 5 s"), (0.75, "ValueError: broken")])
async def test_one_that_dies_hangs_or_breaks(steer: float, message: str) -> None:
    async with pool_of() as pool:
        first = await pool.acquire(("Town01", None), "a")
        await first.reset("trial", Track.STATE, b"", Encoding.JSON)
        with pytest.raises(SimulatorDiedError, match=message):
            await first.step((steer, 0.0, 0.0), Encoding.JSON)
        assert first.dead
        with pytest.raises(SimulatorDiedError):
            await first.step((0.0, 0.0, 0.0), Encoding.JSON)
        await pool.release(first)
        assert (pool.running, pool.busy) == (0, 0)
        second = await pool.acquire(("Town01", None), "a")
        assert not second.dead
        await pool.release(second)


async def test_a_long_replay_has_longer() -> None:
    async with pool_of(call=2) as pool:
        simulator = await pool.acquire(("Town01", None), "a")
        # Two seconds, and twenty more for a thousand actions.
        assert (await simulator.reset("slow", Track.STATE, bytes(1000 * 12), Encoding.JSON)).observation == b"slow"
        with pytest.raises(SimulatorDiedError, match="within 2 s"):
            await simulator.reset("slow", Track.STATE, b"", Encoding.JSON)


async def test_one_that_refuses_goes_on() -> None:
    async with pool_of() as pool:
        simulator = await pool.acquire(("Town01", None), "a")
        with pytest.raises(EpisodeRefusedError, match="not here"):
            await simulator.reset("bad", Track.STATE, b"", Encoding.JSON)
        frame = await simulator.reset("good", Track.STATE, b"", Encoding.JSON)
        assert frame.observation == b"good"
        assert len((await simulator.step((0.0, 0.0, 0.0), Encoding.JSON)).observation) == 200_000


async def test_a_call_that_is_given_up_does_not_leave_its_reply_to_the_next() -> None:
    async with pool_of() as pool:
        simulator = await pool.acquire(("Town01", None), "a")
        call = simulator.step((0.0, 0.0, 0.0), Encoding.JSON)
        await asyncio.sleep(0)
        call.cancel()
        with pytest.raises(asyncio.CancelledError):
            await call
        assert simulator.dead


async def test_slots_and_what_is_warm() -> None:
    async with pool_of(slots=2) as pool:
        one, two = await asyncio.gather(pool.acquire(("Town01", None), "a"), pool.acquire(("Town02", None), "a"))
        assert (pool.running, pool.busy) == (2, 2)
        with pytest.raises(SimulatorsBusyError, match="all 2"):
            await pool.acquire(("Town01", None), "a")
        await pool.release(two)
        assert await pool.acquire(("Town01", None), "a") is two
        await pool.release(one)
        await pool.release(two)
        two.town = "Town02"
        assert await pool.acquire(("Town01", None), "a") is one
        assert await pool.acquire(("Town02", None), "a") is two
        assert pool.running == 2


async def test_many_that_died_idle_are_found_by_many_at_once() -> None:
    async with pool_of(slots=3) as pool:
        idle = await asyncio.gather(*(pool.acquire(("Town01", None), "a") for _ in range(3)))
        for simulator in idle:
            await pool.release(simulator)
        for simulator in idle:
            simulator.process.kill()
            await asyncio.to_thread(simulator.process.wait)
        await until(lambda: all(simulator.dead for simulator in idle))
        fresh = await asyncio.gather(*(pool.acquire(("Town01", None), "a") for _ in range(3)))
        assert not {*fresh} & {*idle}
        assert (pool.running, pool.busy) == (3, 3)


async def test_a_spare_one_takes_the_place_of_one_that_dies() -> None:
    async with pool_of(slots=2, spare=1) as pool:
        await pool.start()
        assert (pool.running, pool.busy) == (1, 0)
        one, two = await pool.acquire(("Town01", None), "a"), await pool.acquire(("Town01", None), "a")
        await until(lambda: pool.running == 3 and pool.idle == 1)
        with pytest.raises(SimulatorsBusyError, match="all 2"):
            await pool.acquire(("Town01", None), "a")
        with pytest.raises(SimulatorDiedError):
            await two.step((0.25, 0.0, 0.0), Encoding.JSON)
        await pool.release(two)
        three = await pool.acquire(("Town01", None), "a")
        assert not three.dead
        # It was there before: nobody waited for a start.
        assert (pool.idle, pool.busy) == (0, 2)
        await until(lambda: pool.idle == 1)
        assert pool.running == 3
        assert pool.memory() > 3 * 2**20
        for simulator in (one, three):
            await pool.release(simulator)
        assert (pool.running, pool.busy) == (3, 0)
    assert pool.memory() == 0, "no process outlives the pool"
    assert not any(map(psutil.pid_exists, (one.process.pid, three.process.pid)))


async def test_who_waits_for_a_start_gets_one_that_is_free_before(tmp_path: Path) -> None:
    begun = tmp_path / "begun"
    # The first is ready at once, all others never.
    program = f"""
import time
from pathlib import Path
try:
    Path({str(begun)!r}).touch(exist_ok=False)
except FileExistsError:
    time.sleep(60)
{PROGRAM}
"""

    async with pool_of(program, slots=2) as pool:
        first = await pool.acquire(("Town01", None), "a")
        second = asyncio.create_task(pool.acquire(("Town01", None), "a"))
        await asyncio.sleep(0.3)
        assert not second.done()
        assert pool.busy == 2
        await pool.release(first)
        assert await asyncio.wait_for(second, 120) is first
