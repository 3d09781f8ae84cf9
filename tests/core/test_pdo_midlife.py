"""PDOs whose settings, NMT state and values change in mid-life: each sends, and takes, what CiA 301 says, at each moment.

The oracles are the text of the standard as a few lines that know no deadline (CiA 301 v4.2.0, 7.2.2.2, 7.5.2.35, 7.5.2.37): they
look at each millisecond whether something is due.
"""

from __future__ import annotations

from typing import Any

from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.datatypes import DataType, ValueRangeError
from canopen_proto.frame import REMOTE, Frame
from canopen_proto.machine import MILLISECOND, NEVER, Outbox
from canopen_proto.multiplexer import mux
from canopen_proto.pdo.consumer import PdoConsumer, PdoLengthUnexpected, PdoOverdue, PdoReceived, PdoTooLate
from canopen_proto.pdo.mapping import MappedEntry, Mapping
from canopen_proto.pdo.producer import PdoNotSent, PdoProducer
from tests.examples import examples

PLACE = mux(0x6064)
MAPPING = Mapping([MappedEntry(0x6064, 0, 8, DataType.UNSIGNED8, "position")])
KEY = 0x18C
TOO_LARGE = 999

# ---- sending ----

Sent = tuple[int, int | None]
"""When, in milliseconds, and the value; None where there was none that could be sent."""


class Oracle:
    """What the standard has a TPDO do. Times in ms."""

    def __init__(self) -> None:
        self.now, self.value, self.enabled = 0, 0, False
        self.log: list[Sent] = []
        self.kind, self.inhibit, self.event, self.start = 255, 0, 0, 0
        self.begin()

    def configure(self, kind: int, inhibit: int, event: int, start: int) -> None:
        """Another event time concerns the timer, and no event that waits; what stays as it is concerns nothing."""
        stays, is_other_timer = (kind, inhibit, start) == (self.kind, self.inhibit, self.start), event != self.event
        self.kind, self.inhibit, self.event, self.start = kind, inhibit, event, start
        if not (stays and self.enabled):
            self.begin()
        elif is_other_timer:
            self.timer = self.now + event if event else None

    def enable(self, enabled: bool) -> None:
        if enabled != self.enabled:
            self.enabled = enabled
            self.begin()

    def begin(self) -> None:
        self.is_triggered = False
        self.syncs, self.awaits_start = 0, self.start != 0
        self.sample: int | None = None
        self.free_at = self.now
        self.timer = self.now + self.event if self.event else None

    def transmit(self, value: int) -> None:
        if value == TOO_LARGE:
            self.log.append((self.now, None))
            return
        self.log.append((self.now, value))
        if self.kind >= 254:
            self.free_at = self.now + self.inhibit
            self.timer = self.now + self.event if self.event else None

    def look(self) -> None:
        """An event-driven PDO is due if its trigger or its timer waits, and the inhibit time is over."""
        if not self.enabled or self.kind < 254 or self.now < self.free_at:
            return
        is_timed = self.timer is not None and self.timer <= self.now
        if self.is_triggered or is_timed:
            self.is_triggered = False
            if is_timed:
                self.timer = self.now + self.event
            self.transmit(self.value)

    def wait(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now += 1
            self.look()

    def trigger(self) -> None:
        if self.enabled and (self.kind == 0 or self.kind >= 254):
            self.is_triggered = True
            self.look()

    def sync(self, counter: int | None) -> None:
        if not self.enabled:
            return
        if self.kind == 252:
            self.sample = None if self.value == TOO_LARGE else self.value
            if self.sample is None:
                self.log.append((self.now, None))
        elif self.kind == 0 and self.is_triggered:
            self.is_triggered = False
            self.transmit(self.value)
        elif 1 <= self.kind <= 240:
            if self.awaits_start and counter is not None:
                if counter != self.start:
                    return
                self.syncs = self.kind - 1
            self.awaits_start = False
            self.syncs += 1
            if self.syncs == self.kind:
                self.syncs = 0
                self.transmit(self.value)

    def request(self) -> None:
        if not self.enabled:
            return
        if self.kind >= 254:
            self.trigger()
        elif self.kind == 252 and self.sample is not None:
            self.log.append((self.now, self.sample))
        else:
            self.log.append((self.now, None if self.value == TOO_LARGE else self.value))
            if self.kind == 252 and self.value != TOO_LARGE:
                self.sample = self.value

    def send(self) -> None:
        if self.enabled:
            if self.value != TOO_LARGE:
                self.is_triggered = False
            self.transmit(self.value)


class Real:
    """The same calls, for the machine. It is woken at its deadlines, never late."""

    def __init__(self) -> None:
        self.now, self.log = 0, list[Sent]()
        self.pdo = PdoProducer(Outbox(), 12, 1, KEY, MAPPING, {PLACE: 0})
        self.configure(255, 0, 0, 0)

    @property
    def _ns(self) -> int:
        return self.now * MILLISECOND

    def take(self) -> None:
        out = self.pdo.out
        self.log += [(self.now, frame.data[0]) for frame in out.frames]
        self.log += [(self.now, None) for event in out.events if isinstance(event, PdoNotSent)]
        assert all(isinstance(event, PdoNotSent) for event in out.events), "it was never late"
        out.frames.clear()
        out.events.clear()

    def configure(self, kind: int, inhibit: int, event: int, start: int) -> None:
        self.pdo.configure(KEY, MAPPING, self._ns, kind, inhibit * MILLISECOND, event * MILLISECOND, start, answers_requests=True)

    def enable(self, enabled: bool) -> None:
        self.pdo.set_enabled(enabled, self._ns)

    def store(self, value: int) -> None:
        self.pdo.store[PLACE] = value

    def wait(self, milliseconds: int) -> None:
        end = self.now + milliseconds
        while self.pdo.deadline <= end * MILLISECOND:
            self.now = self.pdo.deadline // MILLISECOND
            self.pdo.handle_timeout(self._ns)
            self.take()
        self.now = end

    def trigger(self) -> None:
        self.pdo.trigger(self._ns)

    def sync(self, counter: int | None) -> None:
        self.pdo.on_sync(counter, self._ns)

    def request(self) -> None:
        self.pdo.receive(Frame(KEY, b"", REMOTE), self._ns)

    def send(self) -> None:
        try:
            assert self.pdo.send(self._ns) == self.pdo.enabled
        except ValueRangeError:
            self.log.append((self.now, None))


KINDS = st.sampled_from([0, 1, 2, 3, 240, 252, 253, 254, 255, 255])
TIMES = st.sampled_from([0, 0, 3, 10, 25])
STEPS = st.one_of(
    st.tuples(st.just("wait"), st.integers(1, 40)),
    st.tuples(st.just("trigger")),
    st.tuples(st.just("sync"), st.sampled_from([None, 1, 2, 3])),
    st.tuples(st.just("request")),
    st.tuples(st.just("send")),
    st.tuples(st.just("store"), st.sampled_from([1, 2, 3, TOO_LARGE])),
    st.tuples(st.just("enable"), st.booleans()),
    st.tuples(st.just("configure"), KINDS, TIMES, TIMES, st.sampled_from([0, 0, 2])),
)


@examples(1000)
@given(st.lists(STEPS, max_size=30))
@example([("configure", 255, 25, 10, 0), ("trigger",), ("trigger",), ("wait", 40)])
@example([("configure", 255, 25, 0, 0), ("trigger",), ("configure", 255, 10, 0, 0), ("trigger",)])
@example([("configure", 255, 25, 0, 0), ("trigger",), ("trigger",), ("configure", 255, 25, 3, 0), ("wait", 40)])
@example([("configure", 255, 25, 0, 0), ("trigger",), ("trigger",), ("configure", 255, 25, 0, 0), ("wait", 40)])
@example([("configure", 255, 25, 3, 0), ("trigger",), ("trigger",), ("configure", 255, 25, 0, 0), ("wait", 40)])
@example([("configure", 252, 0, 0, 0), ("sync", None), ("configure", 252, 0, 0, 0), ("store", 3), ("request",)])
@example([("configure", 0, 0, 0, 0), ("trigger",), ("store", TOO_LARGE), ("sync", None), ("store", 1), ("sync", None)])
@example([("configure", 255, 25, 10, 0), ("trigger",), ("store", TOO_LARGE), ("wait", 40), ("store", 1), ("wait", 40)])
def test_whatever_is_changed_it_sends_what_the_standard_says(steps: list[tuple[Any, ...]]) -> None:
    oracle, real = Oracle(), Real()
    for name, *values in [("enable", True), *steps]:
        if name == "store":
            real.store(values[0])
            oracle.value = values[0]
        else:
            getattr(real, name)(*values)
            getattr(oracle, name)(*values)
        real.take()
        assert real.log == oracle.log, (name, *values)
    assert real.pdo.deadline == NEVER or real.pdo.deadline > real.now * MILLISECOND


# ---- receiving ----

Taken = tuple[int, str, int]
"""When, in milliseconds; what was reported; the value, the bytes received, or the milliseconds behind the window."""


class Receiver:
    """What the standard has an RPDO do. Times in ms."""

    def __init__(self) -> None:
        self.now, self.enabled, self.window = 0, False, 0
        self.log: list[Taken] = []
        self.is_valid, self.kind, self.event = True, 255, 0
        self.begin()

    def configure(self, is_valid: bool, kind: int, event: int) -> None:
        """Another event time is watched "within the next reception"; what was received, and waits for SYNC, has come."""
        stays = is_valid and self.is_valid and (kind > 240) == (self.kind > 240)
        if not stays:
            self.begin()
        elif event != self.event:
            self.overdue_at = None
        self.is_valid, self.kind, self.event = is_valid, kind, event

    def begin(self) -> None:
        self.held: int | None = None
        self.overdue_at: int | None = None
        self.window_ends: int | None = None

    def enable(self, enabled: bool) -> None:
        if enabled != self.enabled:
            self.enabled = enabled
            self.begin()

    def set_window(self, window: int) -> None:
        self.window, self.window_ends = window, None

    def wait(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now += 1
            if self.overdue_at == self.now:
                self.overdue_at = None
                self.log.append((self.now, "overdue", 0))

    def receive(self, *data: int) -> None:
        if not (self.enabled and self.is_valid):
            return
        if len(data) != 1:
            self.log.append((self.now, "length", len(data)))
        if not data:
            return
        self.overdue_at = self.now + self.event if self.event else None
        if self.kind > 240:
            self.log.append((self.now, "taken", data[0]))
        elif self.window_ends is not None and self.now > self.window_ends:
            self.log.append((self.now, "late", self.now - self.window_ends))
        else:
            self.held = data[0]

    def sync(self) -> None:
        if self.window:
            self.window_ends = self.now + self.window
        if self.held is not None:
            self.log.append((self.now, "taken", self.held))
            self.held = None


class RealReceiver:
    """The same calls, for the machine. It is woken at its deadlines, never late."""

    def __init__(self) -> None:
        self.now, self.log = 0, list[Taken]()
        self.pdo = PdoConsumer(Outbox(), 12, 1, KEY, MAPPING, {})

    def configure(self, is_valid: bool, kind: int, event: int) -> None:
        self.pdo.configure(KEY if is_valid else None, MAPPING, kind, event * MILLISECOND)

    def enable(self, enabled: bool) -> None:
        self.pdo.set_enabled(enabled, self.now * MILLISECOND)

    def set_window(self, window: int) -> None:
        self.pdo.set_window(window * MILLISECOND)

    def wait(self, milliseconds: int) -> None:
        end = self.now + milliseconds
        while self.pdo.deadline <= end * MILLISECOND:
            self.now = self.pdo.deadline // MILLISECOND
            self.pdo.handle_timeout(self.pdo.deadline)
            self.take()
        self.now = end

    def receive(self, *data: int) -> None:
        self.pdo.receive(Frame(KEY, bytes(data)), self.now * MILLISECOND)

    def sync(self) -> None:
        self.pdo.on_sync(None, self.now * MILLISECOND)

    def take(self) -> None:
        for event in self.pdo.out.events:
            match event:
                case PdoReceived(data=data):
                    assert self.pdo.store[PLACE] == data[0]
                    self.log.append((self.now, "taken", data[0]))
                case PdoLengthUnexpected(received=received):
                    self.log.append((self.now, "length", received))
                case PdoTooLate(late=late):
                    self.log.append((self.now, "late", late // MILLISECOND))
                case _:
                    assert isinstance(event, PdoOverdue)
                    self.log.append((self.now, "overdue", 0))
        self.pdo.out.events.clear()
        assert self.pdo.out.frames == []


RECEIVER_STEPS = st.one_of(
    st.tuples(st.just("wait"), st.integers(1, 40)),
    st.tuples(st.just("sync")),
    st.tuples(st.just("receive"), st.integers(0, 255)),
    st.sampled_from([("receive",), ("receive", 7, 8), ("set_window", 0), ("set_window", 5)]),
    st.tuples(st.just("enable"), st.booleans()),
    st.tuples(st.just("configure"), st.sampled_from([True, True, False]), st.sampled_from([0, 1, 240, 254, 255]), TIMES),
)


@examples(1000)
@given(st.lists(RECEIVER_STEPS, max_size=30))
@example([("configure", True, 1, 0), ("receive", 7), ("configure", True, 1, 10), ("sync",)])
@example([("configure", True, 255, 10), ("receive", 7), ("configure", True, 254, 10), ("wait", 40)])
@example([("configure", True, 255, 10), ("receive", 7), ("configure", True, 255, 25), ("wait", 40)])
def test_whatever_is_changed_it_takes_what_the_standard_says(steps: list[tuple[Any, ...]]) -> None:
    oracle, real = Receiver(), RealReceiver()
    for name, *values in [("enable", True), *steps]:
        getattr(real, name)(*values)
        getattr(oracle, name)(*values)
        real.take()
        assert real.log == oracle.log, (name, *values)
