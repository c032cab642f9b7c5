"""The cache of finished evaluations."""

import asyncio

import pytest

from wrongturn_service.cache import Cache


def test_the_work_is_done_once_for_all_who_wait():
    async def story() -> None:
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

    asyncio.run(story())


def test_no_more_than_two_are_made_at_once():
    async def story() -> None:
        cache, running, most = Cache(), 0, 0

        async def make() -> None:
            nonlocal running, most
            running += 1
            most = max(most, running)
            await asyncio.sleep(0.001)
            running -= 1

        await asyncio.gather(*(cache.get(key, make) for key in range(10)))
        assert most == 2

    asyncio.run(story())


def test_the_oldest_is_dropped_and_a_failure_is_not_kept():
    async def story() -> None:
        cache, made = Cache(capacity=2), []

        async def note(key: int) -> int:
            if key not in made:
                made.append(key)
                raise RuntimeError("not the first time")
            made.append(key)
            return key

        for key in (1, 2, 3):
            with pytest.raises(RuntimeError):
                await cache.get(key, lambda key=key: note(key))
            assert await cache.get(key, lambda key=key: note(key)) == key
        made.clear()
        made.extend((1, 2, 3))
        for key in (3, 2, 1):
            assert await cache.get(key, lambda key=key: note(key)) == key
        assert made == [1, 2, 3, 1]

    asyncio.run(story())
