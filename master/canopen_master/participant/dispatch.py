"""Hands the reports of the machines to those who wait: outcomes to requests, events to subscriptions and chains.

This happens inside the pump's turn, and nothing here blocks. If a callback raises, the others still get the event.
"""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Any, TypeAlias, TypeVar

from canopen_master.participant.bus import Bus
from canopen_proto.machine import Event, LocalProtocolError, Outcome, RequestId, Time
from canopen_proto.procedures.runner import Runner
from canopen_proto.remote_node import RemoteNode
from canopen_proto.sdo.events import SdoProgress
from canopen_transports.loop import CancelScope, ParkingLot, current_loop

E = TypeVar("E", bound=Event)


def event_kinds(kinds: type[E] | tuple[type[E], ...]) -> tuple[type[E], ...]:
    """Return the kinds of events that somebody asks for. Raises LocalProtocolError if there are none, or one is no class of
    events: the dispatcher would meet it at the next event, and end the master."""
    if kinds == ():
        raise LocalProtocolError("events of which kinds? Event means all")
    found = kinds if isinstance(kinds, tuple) else (kinds,)
    for kind in found:
        if not isinstance(kind, type) or not issubclass(kind, Event):
            raise LocalProtocolError(f"{kind!r} is no kind of event; give classes derived from Event, such as NodeBooted")
    return found


def check_callback(callback: object) -> None:
    """Raise LocalProtocolError for a callback that cannot be called with an event, or whose coroutine nobody would await."""
    if not callable(callback):
        raise LocalProtocolError(f"callback {callback!r} cannot be called; give a function that takes an event")
    if inspect.iscoroutinefunction(callback) or inspect.iscoroutinefunction(type(callback).__call__):
        raise LocalProtocolError(f"callback {callback!r} is a coroutine function, which nobody awaits; give a plain one")


class ProcedureTakenBackError(Exception):
    """A procedure that a task waits for was cancelled elsewhere: its chain was stopped, or the master ended."""


class Waiter:
    """A place to wait for the outcome of one request. is_done: whether there is a `result`. ends: a scope to cancel then."""

    __slots__ = ("_error", "_news", "_outcome", "_parked", "canceller", "ends", "is_done")

    def __init__(self, canceller: RemoteNode | Runner) -> None:
        self.canceller = canceller
        self.is_done = False
        self.ends: CancelScope | None = None
        self._news: deque[SdoProgress] = deque()  # a stream tells little before it is answered
        self._parked: ParkingLot | None = None  # made for the first that waits: an answer may be there before
        self._outcome: Outcome | None = None
        self._error: Exception | None = None

    def resolve(self, outcome: Outcome) -> None:
        """Take the outcome, and wake the waiting task."""
        self._outcome = outcome
        self._end()

    def fail(self, error: Exception) -> None:
        """End the wait: there will be no outcome, for this reason."""
        self._error = error
        self._end()

    def _end(self) -> None:
        self.is_done = True
        if self._parked is not None:
            self._parked.unpark_all()
        if self.ends is not None:
            self.ends.cancel()

    def tell(self, report: SdoProgress) -> None:
        """Take a report of a stream."""
        self._news.append(report)
        if self._parked is not None:
            self._parked.unpark_all()

    async def wait(self) -> None:
        """Wait until the request is done. Always a checkpoint."""
        if self.is_done:
            await current_loop().checkpoint()
        while not self.is_done:
            await self._park()

    async def next_news(self) -> SdoProgress | None:
        """Wait for the next report of a stream; None once all were returned and the stream has ended."""
        await current_loop().checkpoint_if_cancelled()
        while not self._news and not self.is_done:
            await self._park()
        return self._news.popleft() if self._news else None

    async def _park(self) -> None:
        if self._parked is None:
            self._parked = current_loop().parking_lot()
        await self._parked.park()

    def result(self) -> Outcome:
        """Return the outcome. Raises the reason if there is none."""
        if self._error is not None:
            raise self._error
        assert self._outcome is not None
        return self._outcome


class Watcher:
    """A callback for events. kinds: of these classes. bus, node_id: of this bus and node; None, 0: of all. callback: is called
    with each event. queue: if given, takes events in its place, several at once that came in a row; it must call nobody. is_on:
    False after `unwatch`."""

    __slots__ = ("bus", "callback", "is_on", "kinds", "node_id", "queue")

    def __init__(
        self,
        kinds: tuple[type[Event], ...],
        bus: Bus | None,
        node_id: int,
        callback: Callable[[Any], None],
        queue: Callable[[Sequence[Any]], None] | None = None,
    ) -> None:
        self.is_on = True
        self.queue = queue
        self.kinds = kinds
        self.bus = bus
        self.node_id = node_id
        self.callback = callback


_Told: TypeAlias = tuple[Callable[[Bus, Any], None] | None, tuple[Watcher, ...], bool]


class Dispatcher:
    """Hands each event to the tasks and callbacks that wait for it."""

    def __init__(self) -> None:
        self._waiters: dict[tuple[object, RequestId], Waiter] = {}
        self._watchers: list[Watcher] = []
        # By kind: how to tell the one whose request it is about, if it is about one; those who watch; whether these only queue it
        self._by_kind: dict[type[Event], _Told] = {}

    def expect(self, root: object, request_id: RequestId, canceller: RemoteNode | Runner) -> Waiter:
        """Wait for the outcome of a request of the network whose `out.root` is given."""
        waiter = self._waiters[root, request_id] = Waiter(canceller)
        return waiter

    def forget(self, root: object, request_id: RequestId) -> bool:
        """Stop waiting. Returns False if the outcome has come already."""
        return self._waiters.pop((root, request_id), None) is not None

    def give_up(self, error: Exception, now: Time) -> None:
        """End all waiting with an error, and take the requests back."""
        for (_, request_id), waiter in tuple(self._waiters.items()):
            waiter.fail(error)
            waiter.canceller.cancel(request_id, now)
        self._waiters.clear()

    def watch(
        self,
        kinds: tuple[type[Event], ...],
        callback: Callable[[Any], None],
        bus: Bus | None = None,
        node_id: int = 0,
        queue: Callable[[Sequence[Any]], None] | None = None,
    ) -> Watcher:
        """Call `callback` with each event of these kinds, and of kinds derived from them, until `unwatch`. queue: see Watcher."""
        watcher = Watcher(kinds, bus, node_id, callback, queue)
        self._watchers.append(watcher)
        self._by_kind.clear()
        return watcher

    def unwatch(self, watcher: Watcher) -> None:
        """Stop calling a callback, also with the event that is told at present; does nothing if it was stopped before."""
        watcher.is_on = False
        if watcher in self._watchers:
            self._watchers.remove(watcher)
            self._by_kind.clear()

    def is_asked_for(self, *kinds: type[Event]) -> bool:
        """Return whether a callback watches one of these kinds, of any bus and node."""
        return any(issubclass(kind, watcher.kinds) for watcher in self._watchers for kind in kinds)

    def dispatch(self, bus: Bus, events: Sequence[Event]) -> None:
        """Hand out events of a bus's network, in order. Calls all callbacks, then raises the first error of one."""
        failure: Exception | None = None
        by_kind = self._by_kind
        for kind, run in groupby(events, type):
            tell, watchers, only_queue = by_kind.get(kind) or self._told(kind)
            if only_queue:  # a burst of them is handed over at once
                self._queue(bus, watchers, list(run))
                continue
            for event in run:
                if not by_kind:  # what the event before has caused changed who watches
                    watchers = self._told(kind)[1]
                if tell is not None:
                    try:
                        tell(bus, event)
                    except Exception as error:  # noqa: BLE001 - raised below, when all have been told
                        failure = failure or error
                for watcher in watchers:
                    number = watcher.node_id
                    if (watcher.bus is None or watcher.bus is bus) and watcher.is_on and (not number or number == event.node_id):
                        try:
                            watcher.callback(event)
                        except Exception as error:  # noqa: BLE001 - raised below, when all have been told
                            failure = failure or error
        if failure is not None:
            raise failure

    def _queue(self, bus: Bus, watchers: tuple[Watcher, ...], events: Sequence[Event]) -> None:
        for watcher in watchers:
            if watcher.queue is not None and (watcher.bus is None or watcher.bus is bus):
                number = watcher.node_id
                wanted = [each for each in events if each.node_id == number] if number else events
                if wanted:
                    watcher.queue(wanted)

    def _told(self, kind: type[Event]) -> _Told:
        watching = tuple(each for each in self._watchers if issubclass(kind, each.kinds))
        tell = self._teller_of(kind)
        told = self._by_kind[kind] = tell, watching, tell is None and all(each.queue is not None for each in watching)
        return told

    def _teller_of(self, kind: type[Event]) -> Callable[[Bus, Any], None] | None:
        if issubclass(kind, Outcome):
            return self._resolve
        return self._progress if issubclass(kind, SdoProgress) else None

    def _resolve(self, bus: Bus, outcome: Outcome) -> None:
        waiter = self._waiters.pop((bus.network.out.root, outcome.request_id), None)
        if waiter is not None:
            waiter.resolve(outcome)

    def _progress(self, bus: Bus, report: SdoProgress) -> None:
        waiter = self._waiters.get((bus.network.out.root, report.request_id))
        if waiter is not None:
            waiter.tell(report)
