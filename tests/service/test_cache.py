"""The cache of finished evaluations."""

import asyncio
from types import SimpleNamespace

import pytest

from wrongturn_service.cache import Cache


async def test_the_work_is_done_once_for_all_who_wait():
    cache, made, go = Cache(), [], asyncio.Event()

    async def make() -> str:
        await go.wait()
        made.append(1)
        return "result"

    waiting = [asyncio.ensure_future(cache.get("key", make)) for _ in range(5)]
    await asyncio.sleep(0)
    waiting[0].cancel()
    go.set()
    assert await asyncio.gather(*waiting[1:]) == ["result"] * 4
    assert await cache.get("key", make) == "result"
    assert made == [1]


async def test_what_may_be_a_second_old_is_made_again_after_it_or_when_it_is_cleared(monkeypatch: pytest.MonkeyPatch):
    cache, made, now = Cache(keep_s=1.0), [], [5.0]
    monkeypatch.setattr("wrongturn_service.cache.time", SimpleNamespace(monotonic=lambda: now[0]))

    async def make() -> int:
        made.append(1)
        return len(made)

    assert [await cache.get("key", make) for _ in range(3)] == [1, 1, 1]
    now[0] += 1
    assert await cache.get("key", make) == 2
    cache.clear()
    assert await cache.get("key", make) == 3


async def test_no_more_than_two_are_made_at_once():
    cache, running, most = Cache(), 0, 0

    async def make() -> None:
        nonlocal running, most
        running += 1
        most = max(most, running)
        await asyncio.sleep(0.001)
        running -= 1

    await asyncio.gather(*(cache.get(key, make) for key in range(10)))
    assert most == 2


async def test_a_failure_is_not_kept():
    cache, made = Cache(), []

    async def note() -> int:
        made.append(1)
        if len(made) == 1:
            raise RuntimeError("not the first time")
        return 7

    with pytest.raises(RuntimeError):
        await cache.get("key", note)
    assert [await cache.get("key", note) for _ in range(2)] == [7, 7]
    assert len(made) == 2


async def test_what_is_kept_has_a_size() -> None:
    made: list[str] = []
    kept = Cache(10, size=len)

    async def get(name: str) -> None:
        async def make() -> str:
            made.append(name)
            return name

        assert await kept.get(name[0], make) == name

    await get("aaaa")
    await get("bbbb")
    await get("aaaa")
    await get("cccc")  # b was not used for longest
    await get("dddddddddddd")  # too large to be kept
    assert made == ["aaaa", "bbbb", "cccc", "dddddddddddd"]
    for name in ("aaaa", "cccc", "bbbb", "dddddddddddd"):
        await get(name)
    assert made[4:] == ["bbbb", "dddddddddddd"]
