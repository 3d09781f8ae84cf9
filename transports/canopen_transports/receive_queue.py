"""A bounded queue of received frames that shows where frames were lost.

The loop's thread or one reader thread fills it, a task empties it. If it is full, the next frames are lost, but not silently:
a mark at that place counts them. So a reader gets all frames from before the loss, then one `ReceiveOverrun`, then the frames
after it. Reports of the bus stand in the same order between the frames.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Final, TypeVar

from canopen_transports.errors import ReceiveOverrun, Report
from canopen_transports.loop import ParkingLot, current_loop
from canopen_transports.transport import Received

RECEIVE_QUEUE_SIZE: Final = 8192
"""Frames: about one second of a fully loaded 1 Mbit/s bus. A longer stall overruns the controller in any case."""
MAX_EXTRA: Final = 64
"""Marks and reports that a full queue holds beside the frames. Beyond that, a new one replaces the last of its kind."""

K = TypeVar("K")


class _Lost:
    __slots__ = ("count",)

    def __init__(self) -> None:
        self.count = 1


class ReceiveQueue:
    """See this module's text. `put` and `report` may be called in any thread; then call `wake` in the loop's thread.

    size: frames, at least 1, else ValueError."""

    def __init__(self, locator: str, size: int) -> None:
        if size < 1:
            raise ValueError(f"a receive queue of {size} frames can hold nothing")
        self._locator = locator
        self._size = size
        self._items: deque[Received | Report | _Lost] = deque()
        self._lock = threading.Lock()
        self._waiting: ParkingLot | None = None  # made for the first that waits
        self._closed = False

    def put(self, received: Received) -> None:
        """Add a frame, or count it as lost."""
        with self._lock:
            items = self._items
            if len(items) < self._size:
                items.append(received)
                return
            last = self._latest(_Lost) if len(items) >= self._size + MAX_EXTRA else items[-1]
            if isinstance(last, _Lost):
                last.count += 1
            else:
                items.append(_Lost())

    def report(self, report: Report) -> None:
        """Add a report, at this place in the order of frames."""
        with self._lock:
            items = self._items
            last = self._latest(type(report)) if len(items) >= self._size + MAX_EXTRA - 1 else None
            if last is not None:
                items.remove(last)
                if isinstance(report, ReceiveOverrun) and isinstance(last, ReceiveOverrun):
                    report = ReceiveOverrun(self._locator, last.lost + report.lost, report.seen)
            items.append(report)

    def _latest(self, kind: type[K]) -> K | None:
        return next((item for item in reversed(self._items) if isinstance(item, kind)), None)

    def wake(self) -> None:
        """Make waiting tasks look again. Only in the loop's thread."""
        if self._waiting:  # somebody waits
            self._waiting.unpark_all()

    def close(self) -> None:
        """Wake waiting tasks with ClosedResourceError. Only in the loop's thread."""
        self._closed = True
        self._items.clear()
        self.wake()

    def is_empty(self) -> bool:
        """Return whether everything was taken."""
        return not self._items

    async def get(self) -> Received | Report:
        """Wait for the next frame or report and return it. If cancelled, it took none."""
        await self._filled()
        while (received := self.take()) is None:  # another task was quicker
            await self.woken()
        return received

    async def get_many(self, limit: int) -> list[Received | Report]:
        """Wait until something is there; return at most `limit` frames and reports. If cancelled, it took nothing."""
        await self._filled()
        while not (taken := self.take_many(limit)):  # another task was quicker
            await self.woken()
        return taken

    async def _filled(self) -> None:
        """Wait until something is there, or `close` was called. Always a checkpoint."""
        if self._items or self._closed:
            await current_loop().checkpoint()
        else:
            await self.woken()

    async def woken(self) -> None:
        """Wait for the next `wake`, or for `close`."""
        if self._waiting is None:
            self._waiting = current_loop().parking_lot()
        await self._waiting.park()

    def take(self) -> Received | Report | None:
        """Return the next frame or report, or None. Only in the loop's thread."""
        if self._closed:
            raise current_loop().ClosedResourceError(f"{self._locator} was closed")
        with self._lock:
            item = self._items.popleft() if self._items else None
        return self._overrun(item) if isinstance(item, _Lost) else item

    def take_many(self, limit: int) -> list[Received | Report]:
        """Return what is there: at most `limit` frames and reports. Only in the loop's thread."""
        if self._closed:
            raise current_loop().ClosedResourceError(f"{self._locator} was closed")
        taken: list[Received | Report] = []
        items = self._items
        with self._lock:
            while items and len(taken) < limit:
                item = items.popleft()
                taken.append(self._overrun(item) if isinstance(item, _Lost) else item)
        return taken

    def _overrun(self, lost: _Lost) -> ReceiveOverrun:
        return ReceiveOverrun(self._locator, lost.count, f"the receive queue of {self._size} frames was full")
