"""Memory that the service shares with one simulator process, so that an observation is written once and never sent.

It has two places for observations, which are written by turns. So the last observation can be sent again while the
next one is written, even after the process has died. Whoever still uses an older observation when its place is needed
gets a copy.
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

PLACES: Final = 2
_PLACE_SIZE: Final = -(-max(layout(track).size for track in Track) // mmap.PAGESIZE) * mmap.PAGESIZE
_SIZE: Final = PLACES * _PLACE_SIZE


class ObservationView:
    """An observation in shared memory; equal to bytes of the same content."""

    __slots__ = ("__weakref__", "data")

    def __init__(self, data: memoryview) -> None:
        self.data: bytes | memoryview = data

    def copy(self) -> None:
        """Move to a copy, since the place is needed."""
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
    """The service's side: it reads."""

    def __init__(self) -> None:
        self._handle = os.memfd_create("observations")
        os.ftruncate(self._handle, _SIZE)
        self._memory = memoryview(mmap.mmap(self._handle, _SIZE, prot=mmap.PROT_READ))
        self._views: list[ReferenceType[ObservationView] | None] = [None] * PLACES
        self._place = 0

    @contextlib.contextmanager
    def inherited(self) -> Iterator[int]:
        """Give the file descriptor to a process that is started within the block; then close it here."""
        try:
            yield self._handle
        finally:
            os.close(self._handle)

    def next_place(self) -> int:
        """Free the place for the next observation, and return its number."""
        self._place = place = (self._place + 1) % PLACES
        before = self._views[place]
        view = before() if before is not None else None
        if view is not None:
            view.copy()
        self._views[place] = None
        return place

    def view(self, size: int) -> ObservationView:
        """Return the observation of so many bytes at the last place that was freed."""
        begin = self._place * _PLACE_SIZE
        view = ObservationView(self._memory[begin : begin + size])
        self._views[self._place] = ref(view)
        return view


class SharedMemoryWriter:
    """The process's side: it writes."""

    def __init__(self, handle: int) -> None:
        """Map the memory.

        Args:
            handle: its file descriptor, which is closed.
        """
        memory = memoryview(mmap.mmap(handle, _SIZE))
        os.close(handle)
        self._places = [memory[at * _PLACE_SIZE : (at + 1) * _PLACE_SIZE] for at in range(PLACES)]
        self._blocks: list[Block | None] = [None] * PLACES

    def write(self, observation: Observation, track: Track, place: int) -> memoryview:
        """Write an observation to a place, and return its bytes there."""
        block = self._blocks[place]
        if block is None or block.layout.track is not track:
            self._blocks[place] = block = Block(self._places[place], track)
        block.write(observation)
        return self._places[place][: block.layout.size]
