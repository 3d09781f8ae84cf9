"""Events as an async iterator, which `master.events(HeartbeatLost, EmcyReceived)` returns.

A subscription collects events from the call on, so that no event between a command and the wait for its effect is missed. Its
queue is bounded: a slow reader loses the oldest events, which `dropped` counts, and delays no other task.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Sequence
from operator import length_hint
from typing import Final, Generic, TypeVar

from canopen_proto.machine import Event
from canopen_transports.loop import current_loop

E = TypeVar("E", bound=Event)

QUEUE_SIZE: Final = 4096
"""The most events that wait for a slow reader: more than four seconds of six drives with one PDO each 10 ms."""

HANDED_OVER: Final = 64
"""The most events that a reader takes before other tasks get their turn, and a cancel of its own task is noticed."""


class Subscription(Generic[E]):
    """An async iterator over events: `async for event in subscription`. Made by `Master.events`; `with` or `async with` ends it.

    Events that came together are handed over without a checkpoint between them, up to HANDED_OVER.

    dropped: the number of events that were lost because the reader was too slow.

    close: ends the watch. size: how many events wait at most.
    """

    def __init__(self, close: Callable[[Subscription[E]], None], size: int = QUEUE_SIZE) -> None:
        self.dropped = 0
        self._close = close
        self._size = size
        self._events: deque[E] = deque()
        self._loop = current_loop()
        self._waiting = self._loop.parking_lot()
        self._at_hand: Iterator[E] = iter(())  # a burst, before all other events: it is taken without a checkpoint
        self._end: BaseException | None = None

    def put(self, event: E) -> None:
        """Add an event (the pump does)."""
        self.put_all((event,))

    def put_all(self, new: Sequence[E]) -> None:
        """Add events, as `put` does one after the other. new: 1 or more."""
        events = self._events
        if not events:
            self._waiting.unpark_all()  # a reader waits only while there is no event
        events.extend(new)
        lost = len(events) - self._size
        if lost > 0:
            for _ in range(lost):
                events.popleft()
            self.dropped += lost

    def end(self, reason: BaseException) -> None:
        """End the subscription: after the queued events, `reason` is raised."""
        self._end = reason
        self._waiting.unpark_all()

    async def receive(self) -> E:
        """Wait for the next event and return it. A cancelled wait takes no event.

        After HANDED_OVER events without a wait, other tasks run first. Raises BusError or MasterClosedError at the end.
        """
        await self._loop.checkpoint_if_cancelled()
        for event in self._at_hand:
            return event
        return await self._next()

    async def _next(self) -> E:
        events = self._events
        if events or self._end is not None:
            await self._loop.checkpoint()
        while True:
            for event in self._at_hand:
                return event
            if events:
                burst = self.take() if len(events) <= HANDED_OVER else [events.popleft() for _ in range(HANDED_OVER)]
                self._at_hand = iter(burst)
            elif self._end is not None:
                raise self._end
            else:
                await self._waiting.park()

    def batches(self) -> Batches[E]:
        """Return an async iterator over lists of 1 event or more, each with all that have come since the last one: `async for
        batch in events.batches()`. For many events a second it costs less than one by one. It ends as `receive` does."""
        return Batches(self)

    async def receive_batch(self) -> list[E]:
        """Wait for the next event, and return all that are there. Ends as `receive` does."""
        if self._events or self._end is not None or length_hint(self._at_hand):
            await self._loop.checkpoint()
        while not (taken := self.take()):
            if self._end is not None:
                raise self._end
            await self._waiting.park()
        return taken

    def take(self) -> list[E]:
        """Return all waiting events at once."""
        taken = [*self._at_hand, *self._events]
        self._events.clear()
        return taken

    def close(self) -> None:
        """Stop taking events. May be called twice."""
        self._close(self)

    def __enter__(self) -> Subscription[E]:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    async def __aenter__(self) -> Subscription[E]:
        return self

    async def __aexit__(self, *exc: object) -> None:
        self.close()

    def __aiter__(self) -> Subscription[E]:
        return self

    async def __anext__(self) -> E:
        for event in self._at_hand:  # most of the events of a burst come this way: they are there, and nothing is waited for
            return event
        return await self._next()


class Batches(Generic[E]):
    """An async iterator over lists of events; see `Subscription.batches`."""

    def __init__(self, subscription: Subscription[E]) -> None:
        self._subscription = subscription

    def __aiter__(self) -> Batches[E]:
        return self

    def __anext__(self) -> Awaitable[list[E]]:
        return self._subscription.receive_batch()
