"""`Twin`: the blocking form of an async object. The classes themselves are generated: classes.py.

A twin holds its async object and a `Hub`, and hands each call to the loop. The same async object has the same twin each time, as
far as it lives as long as its master: nodes, drives, chains.

These bases have what the async classes lack: `node[key]`, `on`, `close`, `in_loop`.
"""

from __future__ import annotations

import inspect
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable, Iterator
from contextlib import AbstractAsyncContextManager, AbstractContextManager, suppress
from operator import attrgetter
from types import TracebackType
from typing import Any, Generic, NoReturn, Self, TypeVar, overload

import trio

from canopen_master.blocking.background import Background
from canopen_master.blocking.callbacks import Callbacks, Handler
from canopen_master.errors import BusError, MasterClosedError
from canopen_master.master import Master
from canopen_master.motion.moving import together
from canopen_master.node import Node
from canopen_master.participant.dispatch import check_callback, event_kinds
from canopen_master.session import MasterSession
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import Key
from canopen_proto.dictionary.typed import Readable, Writable
from canopen_proto.machine import Event
from canopen_proto.sdo.transfer import Buffer

E = TypeVar("E", bound=Event)
R = TypeVar("R")
T = TypeVar("T")
V = TypeVar("V", bound=Value)
W = TypeVar("W", bound="Twin[Any]")

THREAD_NAME = "canopen master"


class Hub(Background[Any]):
    """What all twins of one master share: the loop in which they run, and the thread of their callbacks."""

    def __init__(
        self,
        make: Callable[[], AbstractAsyncContextManager[Any]],
        failure: Callable[[Any], Exception | None] = lambda _: None,
        hurry: Callable[[], object] = lambda: None,
        *,
        goes_last: bool = False,
    ) -> None:
        owner = threading.current_thread()
        super().__init__(make, failure, THREAD_NAME, shares_loop=True, owner=owner, goes_last=goes_last, hurry=hurry)
        self.callbacks = Callbacks("canopen events")
        self._twins: dict[int, Twin[Any]] = {}

    def at_the_end(self) -> None:
        self.callbacks.end()

    def twin(self, kind: type[W], inner: object) -> W:
        """Return the twin of an object that lives as long as the master. kind: its class."""
        found = self._twins.get(id(inner))
        if found is None:
            found = self._twins.setdefault(id(inner), kind(self, inner))
        assert isinstance(found, kind)
        return found

    def next(self, inner: AsyncIterator[R]) -> R:
        """Return what an async iterator gives next. Raises StopIteration at its end."""
        try:
            return self.run(None, inner.__anext__)
        except StopAsyncIteration:
            raise StopIteration from None

    def end(self, close: Callable[[], Awaitable[None]]) -> None:
        """Close something, unless the end of the master has done it."""
        with suppress(MasterClosedError, BusError):
            self.run(None, close)

    def context(self, kind: type[W], make: Callable[[], AbstractAsyncContextManager[Any]]) -> AbstractContextManager[W]:
        """Return an async context manager as a plain one. kind: the twin of what it gives."""
        return _Context(self, kind, make)

    def close(self) -> None:
        """Leave the context. Raises the error that ended it, unless a call has raised it already."""
        try:
            error = self.stop()
        finally:
            if self.is_of_this_process:
                self.callbacks.join()
        if error is not None:
            raise error

    def leave(self, error: BaseException | None) -> None:
        """Leave the context at the end of a `with` block. error: of the block; what the end has to say becomes a note of it."""
        try:
            self.close()
        except Exception as late:
            if error is None:
                raise
            error.add_note(str(late))


class Twin(Generic[T]):
    """See this module's text. Names that begin with `_` are this package's own."""

    def __init__(self, hub: Hub, inner: T) -> None:
        self._hub = hub
        self._inner = inner

    def __repr__(self) -> str:
        return f"<blocking {repr(self._inner).strip('<>')}>"


def attribute(name: str, of: str) -> Any:
    """Return the property for an attribute of an async object: it is read in the caller's thread, since that is one step. of: the
    object's class."""
    return property(attrgetter(f"_inner.{name}"), doc=f"As of the async {of}; see the text of this class.")


class _Context(Generic[W]):
    def __init__(self, hub: Hub, kind: type[W], make: Callable[[], AbstractAsyncContextManager[Any]]) -> None:
        self._hub = hub
        self._kind = kind
        self._held = hub.held(make)

    def __enter__(self) -> W:
        return self._kind(self._hub, self._held.__enter__())

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> bool:
        return self._held.__exit__(kind, error, traceback)


def on(hub: Hub, inner: Master | Node, kind: type[E] | tuple[type[E], ...], callback: Callable[[E], object]) -> Handler:
    """See `MasterTwin.on`."""
    check_callback(callback)
    kinds: tuple[type[Event], ...] = event_kinds(kind)
    handler = hub.callbacks.handler(callback)

    def begin(context: Any) -> None:
        master: Master = context
        master.check_open()
        hub.callbacks.start()
        watcher = inner.watch(kinds, handler.put)
        handler.begin(lambda: hub.do_at_the_end(lambda: master.unwatch(watcher)))

    hub.do(begin, hub.present)
    return handler


class MasterTwin(Twin[Master]):
    """What a blocking master has beside the async one."""

    def close(self) -> None:
        """Halt what moves, close the buses, and end the thread. May be called twice.

        Raises HaltNotConfirmedError if a drive did not confirm that it stands, and BusError if the bus failed and no call has
        met that error yet. A Ctrl-C meanwhile shortens the waiting, and is raised at the end.
        """
        self._hub.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self._hub.leave(error)

    def on(self, kind: type[E] | tuple[type[E], ...], callback: Callable[[E], object]) -> Handler:
        """Call a function with each event of a kind, or of several, from now on: `master.on(EmcyReceived, print)`.

        callback: is called in a thread of its own, with one event after the other; it may call the master, and take long. If it
        raises, the error is shown, and the next event comes. Events that wait are bounded: `Handler.dropped`. Raises
        LocalProtocolError for a kind that is no class of events, and for a callback that is no plain function; BusError,
        MasterClosedError.
        """
        return on(self._hub, self._inner, kind, callback)

    @overload
    def in_loop(self, function: Callable[..., Coroutine[Any, Any, R]], *arguments: object, timeout: float | None = None) -> R: ...
    @overload
    def in_loop(self, function: Callable[..., R], *arguments: object, timeout: float | None = None) -> R: ...
    def in_loop(self, function: Callable[..., Any], *arguments: object, timeout: float | None = None) -> Any:
        """Call a function with the async master, in the loop's thread, and return its result; a coroutine is awaited there.

        For what has no blocking form: `master.in_loop(lambda master: master.bus().network.attach(tool))`. arguments: further
        ones; blocking objects become async ones. It must not block. timeout: seconds, see CallTimeoutError.
        """
        given = [each._inner if isinstance(each, Twin) else each for each in arguments]

        async def call() -> Any:
            found = function(self._inner, *given)
            return await found if inspect.isawaitable(found) else found

        return self._hub.run(timeout, call)


class NodeTwin(Twin[Node]):
    """What a blocking node has beside the async one."""

    @overload
    def __getitem__(self, key: Readable[V]) -> V: ...
    @overload
    def __getitem__(self, key: Key) -> Value: ...
    def __getitem__(self, key: Any) -> Any:
        """Read the value of an object: `node["statusword"]`. Raises as `read`."""
        return self._hub.run(None, self._inner.read, key)

    @overload
    def __setitem__(self, key: Writable[V], value: V) -> None: ...
    @overload
    def __setitem__(self, key: Key, value: Value) -> None: ...
    def __setitem__(self, key: Any, value: Any) -> None:
        """Write a value, or a constant by its name: `node["producer_heartbeat_time"] = 500`. Raises as `write`."""
        self._hub.run(None, self._inner.write, key, value)

    # Without these two, Python would ask for node[0], node[1] ...: reads on the bus

    def __contains__(self, key: object) -> NoReturn:
        raise TypeError(f"`in` does not look into a node; is it in its dictionary: {key!r} in node.dictionary")

    def __iter__(self) -> NoReturn:
        raise TypeError("a node cannot be iterated over; its objects are those of its dictionary: for each in node.dictionary")

    def on(self, kind: type[E] | tuple[type[E], ...], callback: Callable[[E], object]) -> Handler:
        """Call a function with each event of this node; see the `on` of the master."""
        return on(self._hub, self._inner, kind, callback)


def open_session(kind: type[W], session: MasterSession) -> W:
    """Open a master, and return its twin. kind: the class."""
    hub = Hub(lambda: session, lambda master: master.failure, session.hurry)
    return hub.twin(kind, hub.start())


def open_context(kind: type[W], make: Callable[[], AbstractAsyncContextManager[Any]]) -> AbstractContextManager[W]:
    """Return an async context manager, which needs no master, as a plain one in the shared loop. kind: the twin of what it
    gives."""
    return _Standing(kind, make)


class _Standing(Generic[W]):
    def __init__(self, kind: type[W], make: Callable[[], AbstractAsyncContextManager[Any]]) -> None:
        self._kind = kind
        self._hub = Hub(make, goes_last=True)

    def __enter__(self) -> W:
        return self._kind(self._hub, self._hub.start())

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self._hub.leave(error)


def in_a_thread(pieces: Iterable[Buffer]) -> Any:
    """Return pieces of a stream that are taken in a thread beside the loop: what reads a file would delay it."""
    if isinstance(pieces, bytes | bytearray | memoryview):
        return pieces

    async def taken() -> Any:
        source: Iterator[Buffer] = iter(pieces)
        while (piece := await trio.to_thread.run_sync(next, source, None)) is not None:
            yield piece

    return taken()


def together_of_none() -> NoReturn:
    """Raise what `together` raises for no chain."""
    together()
    raise AssertionError
