"""`Callbacks`: the thread in which `on` calls the user's functions with events.

The loop only queues an event, so that no function delays a cycle, however slow it is. All functions of one master are called in
one thread: each gets its events in their order, and none runs beside another one. They may call the master.

Nothing is lost without a word. A function that raises is shown as an error of a thread (`threading.excepthook`), and gets the
next event. One that is slow loses the oldest events beyond QUEUE_SIZE; `Handler.dropped` counts them, and the log tells it.
"""

from __future__ import annotations

import logging
import queue
import sys
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from canopen_master.errors import HaltNotConfirmedError, MasterClosedError
from canopen_master.participant.subscription import QUEUE_SIZE
from canopen_proto.machine import Event

LOGGER: Final = logging.getLogger("canopen_master")
LAST_EVENTS_TIME: Final = 2.0
"""Seconds that the functions may take, once the master is closed, for the events that came before."""


class Handler:
    """A function that is called with events; made by `on`. `with` or `close` ends it."""

    def __init__(self, callback: Callable[[Any], object], queue: queue.SimpleQueue[Handler | None]) -> None:
        self._callback = callback
        self._queue = queue
        self._events: deque[Event] = deque(maxlen=QUEUE_SIZE)  # a full one loses its oldest
        self._is_queued = False
        self._put = 0  # events; the loop counts them
        self._taken = 0  # the thread of the callbacks does
        self._told = 0
        self._is_closed = False
        self._end: Callable[[], object] = lambda: None

    def __repr__(self) -> str:
        return f"<Handler {self._callback!r}>"

    @property
    def dropped(self) -> int:
        """The number of events that were lost, because the function was slow."""
        return max(0, self._put - self._taken - len(self._events))

    def begin(self, end: Callable[[], object]) -> None:
        """Say how it is ended. end: in the loop."""
        self._end = end

    def put(self, event: Event) -> None:
        """Queue an event (the loop does)."""
        self._put += 1
        self._events.append(event)
        if not self._is_queued:
            self._is_queued = True
            self._queue.put(self)

    def waiting(self) -> range:
        """Return a number for each event that waits. What comes from now on queues the handler again."""
        self._is_queued = False
        return range(len(self._events))

    def call(self) -> None:
        """Call the function with the oldest event (the thread of the callbacks does)."""
        event = self._events.popleft()
        self._taken += 1
        if self._is_closed:
            return
        if (dropped := self.dropped) > self._told:
            LOGGER.warning("%d events are lost, because %r is slow", dropped - self._told, self._callback)
            self._told = dropped
        self._callback(event)

    def close(self) -> None:
        """Call it no more. May be called twice, and by the function itself."""
        self._is_closed = True
        self._end()

    def __enter__(self) -> Handler:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


class Callbacks:
    """See this module's text. The thread begins with the first function."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._queue: queue.SimpleQueue[Handler | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def handler(self, callback: Callable[[Any], object]) -> Handler:
        """Return a new handler; no event comes to it yet."""
        return Handler(callback, self._queue)

    def start(self) -> None:
        """Begin the thread, unless it has begun. To be called in the loop: there no interrupt comes, which `Thread.start` may
        not survive."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()

    def end(self) -> None:
        """End the thread, after the events that came."""
        self._queue.put(None)

    def join(self) -> None:
        """Wait for the end of the thread; a function that does not return is left behind."""
        thread = self._thread
        if thread is not None and threading.current_thread() is not thread:
            thread.join(LAST_EVENTS_TIME)
            if thread.is_alive():
                LOGGER.warning("a function that was called with an event does not return: it is left behind")

    def _run(self) -> None:
        while (handler := self._queue.get()) is not None:
            for _ in handler.waiting():
                self._call(handler)

    def _call(self, handler: Handler) -> None:
        try:
            handler.call()
        except (MasterClosedError, HaltNotConfirmedError):  # it has called the master, which was closed meanwhile
            LOGGER.debug("%r was called while the master was closed", handler)
        except Exception:  # noqa: BLE001 - the user's code; it may do better with the next event
            threading.excepthook(threading.ExceptHookArgs((*sys.exc_info(), threading.current_thread())))
