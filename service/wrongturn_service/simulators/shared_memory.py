"""Memory that the service shares with one simulator process, so that an observation is written once and never sent.

It holds two observations, which are written in turn: the last can be told again while the next is being made, even
after the process has died of it. Whoever still has the one before when its place is needed gets a copy of its own.
Behind them lies the action log of what the process does on a connection that is lent to it.
"""

import contextlib
import mmap
import os
from collections.abc import Iterator
from typing import Final
from weakref import ReferenceType, ref

from typing_extensions import override

from wrongturn_protocol import Track
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.wire import Block, layout
from wrongturn_service.simulators import action_log

PLACES: Final = 2
_ROOM: Final = -(-max(layout(track).size for track in Track) // mmap.PAGESIZE) * mmap.PAGESIZE
"""Bytes for one observation."""
_BOOK: Final = PLACES * _ROOM
"""Where the action log begins."""
_SIZE: Final = _BOOK + action_log.SIZE


class ObservationView:
    """An observation on a screen; equal to bytes of the same content."""

    __slots__ = ("__weakref__", "data")

    def __init__(self, data: memoryview) -> None:
        self.data: bytes | memoryview = data

    def keep(self) -> None:
        """Its place is written to again: have a copy."""
        self.data = bytes(self.data)

    def __bytes__(self) -> bytes:
        return bytes(self.data)

    def __len__(self) -> int:
        return len(self.data)

    @override
    def __eq__(self, other: object) -> bool:
        return bytes(self.data) == bytes(other) if isinstance(other, bytes | ObservationView) else NotImplemented

    __hash__ = None  # type: ignore[assignment]


class SharedMemory:
    """The service's side."""

    def __init__(self) -> None:
        self._handle = os.memfd_create("observations")
        os.ftruncate(self._handle, _SIZE)
        self._memory = memoryview(mmap.mmap(self._handle, _SIZE, prot=mmap.PROT_READ))
        self._shown: list[ReferenceType[ObservationView] | None] = [None] * PLACES
        self._place = 0

    @contextlib.contextmanager
    def lent(self) -> Iterator[int]:
        """The descriptor, for a process to inherit; closed at the end."""
        try:
            yield self._handle
        finally:
            os.close(self._handle)

    def next_place(self) -> int:
        """The place for the next observation, free to be written to."""
        self._place = place = (self._place + 1) % PLACES
        before = self._shown[place]
        if before is not None:
            shown = before()
            if shown is not None:
                shown.keep()
            self._shown[place] = None
        return place

    def view(self, size: int) -> ObservationView:
        """What was written to that place."""
        begin = self._place * _ROOM
        found = ObservationView(self._memory[begin : begin + size])
        self._shown[self._place] = ref(found)
        return found

    def clear(self) -> int:
        """Free all places, to be written to in turn; the first of them."""
        for _ in range(PLACES):
            self.next_place()
        return (self._place + 1) % PLACES

    def last_view(self, first: int, count: int, size: int) -> ObservationView:
        """The last of so many observations that were written in turn."""
        self._place = (first + count - 1) % PLACES
        return self.view(size)

    def book(self, loan: int) -> action_log.LogEntries:
        """What is noted of a loan."""
        return action_log.read(self._memory[_BOOK:], loan)


class SharedMemoryWriter:
    """The process's side."""

    def __init__(self, handle: int) -> None:
        """Take over a screen's handle."""
        memory = memoryview(mmap.mmap(handle, _SIZE))
        os.close(handle)
        self._places = [memory[at * _ROOM : (at + 1) * _ROOM] for at in range(PLACES)]
        self._blocks: list[Block | None] = [None] * PLACES
        self.action_log = action_log.ActionLog(memory[_BOOK:])

    def write(self, observation: Observation, track: Track, place: int) -> memoryview:
        """Write an observation to a place; what stands there then."""
        block = self._blocks[place]
        if block is None or block.layout.track is not track:
            self._blocks[place] = block = Block(self._places[place], track)
        block.write(observation)
        return self._places[place][: block.layout.size]
