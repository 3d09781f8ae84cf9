"""Record all frames on the buses that this process uses, as `--trace FILE` does.

    with recording(log_writer(Path("trace.log"))) as trace:
        ...                                         every transport that `open_transport` opens in here is recorded

Each frame is recorded once: if one bus has several members in this process (the master and the simulated drives of `-b demo`),
only the first one records. A record's time is when this process saw or sent the frame, on the loop's clock for all buses; what
it took at once has one time. The kernel's time stamps are on another clock. A sent frame is recorded once the bus has taken it,
with the time at which it was given to the bus. Frames that overtake it are held back, so that the records stay in order.

If a trace cannot be written (no room on the disk), it ends, and says so at the end: the drives must not stop for it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import Final, Protocol, TypeVar

from canopen_proto.frame import Frame, RoutingKey
from canopen_transports.errors import ReceiveOverrun, Report
from canopen_transports.locator import parse_locator
from canopen_transports.loop import AsyncResource, current_loop
from canopen_transports.record import LogWriter, Record
from canopen_transports.transport import BatchTransport, CyclicTransport, EagerTransport, PromptTransport, Received, Transport

_trace: Final[ContextVar[Trace | None]] = ContextVar("trace", default=None)
_for_devices: Final[ContextVar[bool]] = ContextVar("for devices", default=False)


class Named(Transport, Protocol):
    """A transport that says which bus it is on."""

    @property
    def locator(self) -> str:
        """The bus, as `open_transport` takes it."""


T = TypeVar("T", bound=Named)


class Trace:
    """One recording. devices_are_ours: the simulated devices record, so their frames count as sent.

    failure: why it ended early, or None. recorded: how many frames it holds. lost: how many it lacks at least, because they were
    lost on their way to us. left_out: how many this kind of file cannot hold.
    """

    def __init__(self, writer: LogWriter, *, devices_are_ours: bool = False) -> None:
        self.failure: OSError | None = None
        self.recorded = 0
        self.lost = 0
        self.devices_are_ours = devices_are_ours
        self.left_out = 0
        self._closed = False
        self._writer = writer
        self._zero: int | None = None
        self._taps: dict[str, list[TracingTransport]] = {}
        self._names: dict[str, str] = {}

    def now(self) -> int:
        """Return the time in ns since 1970: the system's at the first call, continued on the loop's clock."""
        now = round(current_loop().current_time() * 1e9)
        if self._zero is None:
            self._zero = time.time_ns() - now
        return now + self._zero

    def record(self, record: Record) -> None:
        """Add a frame, unless the recording has ended. Raises nothing."""
        if self.failure is None and not self._closed:
            try:
                self._writer.write(record)
            except OSError as error:
                self.failure = error
            else:
                self.recorded += 1

    def lose(self, count: int, channel: str, now: int) -> None:
        """Take note that frames were lost on their way to us, and say so in the file: who reads it would take what is missing for
        a fault of a node. Raises nothing."""
        self.lost += count
        if self.failure is None and not self._closed:
            try:
                self._writer.lost(now, channel)
            except OSError as error:
                self.failure = error

    def close(self) -> None:
        """End the file. May be called twice; raises nothing."""
        if self._closed:
            return
        self._closed = True
        self.left_out = self._writer.left_out
        try:
            self._writer.close()
        except OSError as error:
            self.failure = self.failure or error

    def wrap(self, transport: Named) -> TracingTransport:
        """Return the transport, recorded."""
        made = TracingTransport(transport, self)
        self._taps.setdefault(made.locator, []).append(made)
        return made

    def channel_of(self, locator: str) -> str:
        """Return a bus's name in the file: can0 for SocketCAN's can0, else the interface with a number, such as virtual0.
        locator: of the bus."""
        if locator not in self._names:
            parsed = parse_locator(locator)
            number = sum(name.startswith(parsed.interface) for name in self._names.values())
            self._names[locator] = parsed.channel if parsed.interface == "socketcan" else f"{parsed.interface}{number}"
        return self._names[locator]

    def records(self, tap: TracingTransport) -> bool:
        """Return whether this member of its bus is the one that records. The last one also records while it leaves."""
        taps = self._taps[tap.locator]
        return not taps or taps[0] is tap

    def leave(self, tap: TracingTransport) -> None:
        """Take a member that has left its bus out of the trace."""
        with suppress(ValueError):  # closed twice
            self._taps[tap.locator].remove(tap)


class TracingTransport(AsyncResource):
    """A transport that records in a trace what passes through it. Its methods are those of the transport below, except filters: a
    trace must see all frames."""

    def __init__(self, transport: Named, trace: Trace) -> None:
        self.locator = transport.locator
        self.transport = transport
        self._eager = transport if isinstance(transport, EagerTransport) else None
        self._batch = transport if isinstance(transport, BatchTransport) else None
        self._prompt = transport if isinstance(transport, PromptTransport) else None
        self._cyclic = transport if isinstance(transport, CyclicTransport) and transport.sends_sync else None
        self.sends_sync = self._cyclic is not None
        self._trace = trace
        self._channel = trace.channel_of(self.locator)
        self._ours = trace.devices_are_ours or not _for_devices.get()
        self._cyclic_keys: set[RoutingKey] = set()
        self._sending = 0
        self._held: list[Record] = []

    @property
    def errors(self) -> int:
        """How many error frames came, if the transport below counts them."""
        errors: int = getattr(self.transport, "errors", 0)
        return errors

    @property
    def bitrate(self) -> int | None:
        """The bit rate, if the transport below knows it."""
        bitrate: int | None = getattr(self.transport, "bitrate", None)
        return bitrate

    @property
    def unheard(self) -> str | None:
        """As the transport itself says."""
        unheard: str | None = getattr(self.transport, "unheard", None)
        return unheard

    async def send(self, frame: Frame) -> None:
        record = self._record_of(frame, self._ours)
        self._sending += 1
        try:
            await self.transport.send(frame)
            self._record(record)
        finally:
            self._sending -= 1
            if not self._sending:
                for each in self._held:
                    self._record(each)
                self._held.clear()

    def send_nowait(self, frame: Frame) -> bool:
        """False if the transport below has no `send_nowait`."""
        if self._eager is None or not self._eager.send_nowait(frame):
            return False
        self._record_in_turn(self._record_of(frame, self._ours))
        return True

    async def receive(self) -> Received | Report:
        received = await self.transport.receive()
        self._note(received, self._trace.now())
        return received

    async def receive_many(self, limit: int) -> list[Received | Report]:
        """One by one if the transport below has no `receive_many`."""
        if self._batch is None:
            return [await self.receive()]
        taken = await self._batch.receive_many(limit)
        now = self._trace.now()
        for item in taken:
            self._note(item, now)
        return taken

    def receive_nowait(self, limit: int) -> list[Received | Report] | None:
        """Receive as the transport below does; None if that one cannot."""
        taken = None if self._prompt is None else self._prompt.receive_nowait(limit)
        now = self._trace.now()
        for item in taken or ():
            self._note(item, now)
        return taken

    def start_cyclic(self, frames: Sequence[Frame], period: int) -> None:
        assert self._cyclic is not None, "sends_sync says that it cannot"
        self._cyclic.start_cyclic(frames, period)
        self._cyclic_keys = {frame.key for frame in frames}

    def stop_cyclic(self) -> None:
        assert self._cyclic is not None, "sends_sync says that it cannot"
        self._cyclic.stop_cyclic()
        self._cyclic_keys.clear()

    async def aclose(self) -> None:
        try:
            await self.transport.aclose()
        finally:
            self._trace.leave(self)

    def _record_of(self, frame: Frame, sent: bool) -> Record:
        return Record(self._trace.now(), self._channel, frame, sent)

    def _note(self, received: Received | Report, now: int) -> None:
        if isinstance(received, tuple):
            frame = received[0]
            self._record_in_turn(Record(now, self._channel, frame, self._ours == (frame.key in self._cyclic_keys)))
        elif isinstance(received, ReceiveOverrun) and self._trace.records(self):
            self._trace.lose(received.lost, self._channel, now)

    def _record_in_turn(self, record: Record) -> None:
        if self._sending:
            self._held.append(record)
        else:
            self._record(record)

    def _record(self, record: Record) -> None:
        if self._trace.records(self):
            self._trace.record(record)


@contextmanager
def recording(writer: LogWriter, *, devices_are_ours: bool = False) -> Iterator[Trace]:
    """Record the transports that are opened while the block runs; close the file at its end, however it ends. writer,
    devices_are_ours: see `Trace`."""
    trace = Trace(writer, devices_are_ours=devices_are_ours)
    token = _trace.set(trace)
    try:
        yield trace
    finally:
        _trace.reset(token)
        trace.close()


@contextmanager
def for_devices() -> Iterator[None]:
    """Mark the transports that are opened while the block runs as those of simulated devices: for a master's trace, their frames
    are received."""
    token = _for_devices.set(True)
    try:
        yield
    finally:
        _for_devices.reset(token)


def current_trace() -> Trace | None:
    """Return the trace that is being recorded, or None."""
    return _trace.get()


def traced(transport: T) -> T | TracingTransport:
    """Return the transport, recorded if a recording runs."""
    trace = _trace.get()
    return transport if trace is None else trace.wrap(transport)
