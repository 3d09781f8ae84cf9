"""Recording everything that is said on the buses that this process uses, as `--trace FILE` does.

    with recording(log_writer(Path("trace.log"))) as trace:
        ...                                         every transport that `open_transport` opens in here is recorded

Each frame stands in the trace once: of several members of one bus in this process (the simulated drives of `-b demo`, and the
master) only the first one records. Times are when this process saw or sent a frame, on one clock, trio's, for all buses; the
kernel's time stamps, where there are such, come from another. A frame is recorded as sent once the bus has taken it, with the
time at which it was given to the bus; what overtakes that waits, so that it stands behind it.

A trace that cannot be written (no room on the disk) ends, and says so at the end: the drives must not stop for it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import Final, Protocol, TypeVar

import trio

from canopen_proto.frame import Frame, RoutingKey
from canopen_transports.errors import ReceiveOverrun, Report
from canopen_transports.locator import parse_locator
from canopen_transports.log_files import LogWriter
from canopen_transports.record import Record
from canopen_transports.transport import BatchTransport, CyclicTransport, EagerTransport, Received, Transport

_trace: Final[ContextVar[Trace | None]] = ContextVar("trace", default=None)
_for_devices: Final[ContextVar[bool]] = ContextVar("for devices", default=False)


class Named(Transport, Protocol):
    """A transport that says which bus it is on."""

    @property
    def locator(self) -> str:
        """As `open_transport` takes it."""


T = TypeVar("T", bound=Named)


class Trace:
    """One recording. devices_are_ours: simulated devices are who records, so that what they send counts as sent.

    failure: why it ended before its time, if it did. recorded: how many frames it holds. lost: how many it lacks at least, as
    they were lost on their way to us. left_out: how many its kind of file cannot hold.
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
        """ns since 1970, as trio's clock has gone on since the first call."""
        now = round(trio.current_time() * 1e9)
        if self._zero is None:
            self._zero = time.time_ns() - now
        return now + self._zero

    def record(self, record: Record) -> None:
        """Add a frame, as long as it is open; raises nothing."""
        if self.failure is None and not self._closed:
            try:
                self._writer.write(record)
            except OSError as error:
                self.failure = error
            else:
                self.recorded += 1

    def close(self) -> None:
        """End the file, once; raises nothing."""
        if self._closed:
            return
        self._closed = True
        self.left_out = self._writer.left_out
        try:
            self._writer.close()
        except OSError as error:
            self.failure = self.failure or error

    def wrap(self, transport: Named) -> TracingTransport:
        """The transport, recorded."""
        made = TracingTransport(transport, self)
        self._taps.setdefault(made.locator, []).append(made)
        return made

    def channel_of(self, locator: str) -> str:
        """What a bus is called in the file: can0 is can0, of the others it is the interface with a number, such as virtual0."""
        if locator not in self._names:
            parsed = parse_locator(locator)
            number = sum(name.startswith(parsed.interface) for name in self._names.values())
            self._names[locator] = parsed.channel if parsed.interface == "socketcan" else f"{parsed.interface}{number}"
        return self._names[locator]

    def records(self, tap: TracingTransport) -> bool:
        """Whether this member of its bus is the one that records; the last one does so for what it sends while it leaves, too."""
        taps = self._taps[tap.locator]
        return not taps or taps[0] is tap

    def leave(self, tap: TracingTransport) -> None:
        """A member has left its bus."""
        with suppress(ValueError):  # closed twice
            self._taps[tap.locator].remove(tap)


class TracingTransport(trio.abc.AsyncResource):
    """A transport that tells a trace what goes through it: as eager as the one below, and its SYNC is that one's if it sends it.

    It hides that the one below could filter: all is to be recorded.
    """

    def __init__(self, transport: Named, trace: Trace) -> None:
        self.locator = transport.locator
        self.transport = transport
        self._eager = transport if isinstance(transport, EagerTransport) else None
        self._batch = transport if isinstance(transport, BatchTransport) else None
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
        """How many error frames came, as far as the transport below counts them."""
        errors: int = getattr(self.transport, "errors", 0)
        return errors

    async def send(self, frame: Frame) -> None:
        """As the transport below."""
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
        """As the transport below; False where that one cannot."""
        if self._eager is None or not self._eager.send_nowait(frame):
            return False
        self._record_in_turn(self._record_of(frame, self._ours))
        return True

    async def receive(self) -> Received | Report:
        """As the transport below."""
        received = await self.transport.receive()
        self._note(received)
        return received

    async def receive_many(self, limit: int) -> list[Received | Report]:
        """As the transport below; one by one if that one hands out no more at once."""
        if self._batch is None:
            return [await self.receive()]
        taken = await self._batch.receive_many(limit)
        for item in taken:
            self._note(item)
        return taken

    def start_cyclic(self, frames: Sequence[Frame], period: int) -> None:
        """As the transport below, whose frames come back by `receive`."""
        assert self._cyclic is not None, "sends_sync says that it cannot"
        self._cyclic.start_cyclic(frames, period)
        self._cyclic_keys = {frame.key for frame in frames}

    def stop_cyclic(self) -> None:
        """As the transport below."""
        assert self._cyclic is not None, "sends_sync says that it cannot"
        self._cyclic.stop_cyclic()
        self._cyclic_keys.clear()

    async def aclose(self) -> None:
        """As the transport below."""
        try:
            await self.transport.aclose()
        finally:
            self._trace.leave(self)

    def _record_of(self, frame: Frame, sent: bool) -> Record:
        return Record(self._trace.now(), self._channel, frame, sent)

    def _note(self, received: Received | Report) -> None:
        if isinstance(received, tuple):
            frame = received[0]
            self._record_in_turn(self._record_of(frame, self._ours == (frame.key in self._cyclic_keys)))
        elif isinstance(received, ReceiveOverrun) and self._trace.records(self):
            self._trace.lost += received.lost

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
    """Record what is opened while the block runs, and close the file at its end, however it ends. See `Trace`."""
    trace = Trace(writer, devices_are_ours=devices_are_ours)
    token = _trace.set(trace)
    try:
        yield trace
    finally:
        _trace.reset(token)
        trace.close()


@contextmanager
def for_devices() -> Iterator[None]:
    """What is opened while the block runs is for simulated devices: the others, as far as a master's trace is concerned."""
    token = _for_devices.set(True)
    try:
        yield
    finally:
        _for_devices.reset(token)


def current_trace() -> Trace | None:
    """The trace that is being recorded."""
    return _trace.get()


def traced(transport: T) -> T | TracingTransport:
    """The transport, recorded if a trace is."""
    trace = _trace.get()
    return transport if trace is None else trace.wrap(transport)
