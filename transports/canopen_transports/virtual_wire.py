"""`virtual:NAME?bitrate=1M&...`: the bus inside this process with bit times, arbitration and faults, in the loop's time.

A `Wire` (canopen_transports.wire) decides who sends when, and what goes wrong; this module gives it a clock. In virtual time a
bus runs as fast as it is computed, in real time at its own pace.

    bitrate=500k        default 1M; also virtual:NAME@500k
    loss=0.001          one of a thousand frames is lost at one receiver; repeat=, corrupt=, delay= likewise
    delay_ms=5          how late a late frame is at most
    seed=7              decides which frames are hit
    queue=fifo          or priority: which of a member's waiting frames competes for the bus; queue_size=64: how many can wait
    ack=true            a lone member repeats its frame for ever; false: an unseen node acknowledges
    recover=true        a member returns from bus-off by itself; false: after `PhysicalBus.restart`

The first member of a name chooses the options of the bus. The others give the same options or none; `virtual:NAME` then joins
that bus. queue and queue_size are each member's own.

A frame is pushed to a pump as it ends (`PushingTransport`), and the bus wakes once for each frame, at its end: see
`Wire.next_output`.

Opening waits until the frames that other members had queued before are sent: a new member acknowledges them at once, but hears
only later frames. So devices that were alone have booted when their master has opened the bus, and the master does not take their
boot-ups, which nobody had acknowledged, for a reset.

A test can break the bus while it runs: `transport.bus` is the `PhysicalBus`, with `bus_off`, `babble`, `cut`, `mend` and `rates`.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from typing import Final

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, LocalProtocolError, Time
from canopen_transports.errors import (
    NOT_ACKNOWLEDGED,
    BusState,
    BusStateChanged,
    FrameNotSentError,
    Report,
    TransportError,
    bad_locator,
)
from canopen_transports.locator import Option, parse_bitrate
from canopen_transports.loop import AsyncResource, RunVar, current_loop
from canopen_transports.receive_queue import RECEIVE_QUEUE_SIZE, ReceiveQueue
from canopen_transports.transport import Received, check_frame
from canopen_transports.wire import (
    FaultHappened,
    FaultKind,
    FaultRates,
    QueueOrder,
    StateReported,
    Wire,
    WireMember,
    WireSettings,
)
from canopen_transports.wire.member import TRANSMIT_QUEUE_SIZE

DEFAULT_BITRATE: Final = 1_000_000
_ALONE: Final = ("open a second member of the bus", "the option ack=false: an unseen node acknowledges")
ROOM_TIME: Final = 1.0
"""Seconds that a sender waits for room in the transmit queue, as for a real adapter."""
KEPT_FAULTS: Final = 1_000
"""The number of latest faults that are kept for inspection; `PhysicalBus.counts` counts all."""

_buses: RunVar[dict[str, PhysicalBus]] = RunVar(dict)


class PhysicalBus:
    """A wire that runs, and its members. The first member that opens it makes it.

    wire: the machine; read only. counts: the faults so far, by kind. faults: the latest of them.
    """

    def __init__(self, name: str, settings: WireSettings) -> None:
        self.name = name
        self._loop = current_loop()
        self._clock = self._loop.clock()
        self.wire = Wire(settings, self.now())
        self.counts: Counter[FaultKind] = Counter()
        self.faults: deque[FaultHappened] = deque(maxlen=KEPT_FAULTS)
        self._transports: dict[WireMember, WireTransport] = {}
        self._changed = self._loop.parking_lot()
        self._wake: Time = NEVER  # when `_run` looks at the wire again
        self._is_handing_out = False
        self._room = self._loop.parking_lot()
        self._bit = self.wire.time_of(1)

    def now(self) -> Time:
        """Return the time in ns, on the loop's clock."""
        return round(self._clock() * SECOND)

    # ---- for tests ----

    @property
    def rates(self) -> FaultRates:
        """How often frames are hit. Setting it takes effect at once."""
        return self.wire.rates

    @rates.setter
    def rates(self, rates: FaultRates) -> None:
        self.wire.rates = rates
        self._changed.unpark_all()  # what was foreseen may come sooner now

    def bus_off(self, transport: WireTransport) -> None:
        """Take a member bus-off: its queued frames are lost, and it hears nothing."""
        self.wire.bus_off(transport.member, self.now())
        self.hand_out()

    def restart(self, transport: WireTransport) -> None:
        """Let a member that is bus-off return."""
        self.wire.restart(transport.member, self.now())
        self.hand_out()

    def babble(self, frame: Frame, seconds: float) -> None:
        """Add a node that sends this frame again and again for `seconds`."""
        now = self.now()
        self.wire.babble(frame, now + round(seconds * SECOND), now)
        self.hand_out()

    def cut(self, half: Iterable[WireTransport]) -> None:
        """Cut the cable: these members on one side, all others on the other. Raises LocalProtocolError if it is cut already."""
        self.wire.cut([transport.member for transport in half], self.now())
        self.hand_out()

    def mend(self) -> None:
        """Mend the cable."""
        self.wire.mend(self.now())
        self.hand_out()

    def load(self) -> float:
        """Return the part of the time since the bus was opened in which it was busy: 0 to 1."""
        return self.wire.load(self.now())

    # ---- members ----

    def join(self, transport: WireTransport, order: QueueOrder, queue_size: int) -> WireMember:
        """Add a member. The first one starts the bus."""
        member = self.wire.join(self.now(), order=order, queue_size=queue_size)
        if not self._transports:
            self._loop.spawn_system_task(self._run, name=f"virtual bus {self.name}")
        self._transports[member] = transport
        self.hand_out()
        return member

    def leave(self, transport: WireTransport) -> None:
        """Remove a member. The last one ends the bus."""
        self.wire.leave(transport.member, self.now())
        del self._transports[transport.member]
        if not self._transports:
            del _buses.get()[self.name]
        self.hand_out()
        self._room.unpark_all()

    def send(self, member: WireMember, frame: Frame) -> None:
        """Queue a frame; there must be room."""
        self.wire.send(member, frame, self.now())
        self.hand_out()

    async def settle(self, member: WireMember) -> None:
        """Wait until the frames that the other members have queued now are sent or lost, but at most ROOM_TIME: frames may
        starve."""
        queued = {each: each.sent + each.queued for each in self.wire.members if each is not member and each.queued}
        with self._loop.move_on_after(ROOM_TIME):
            while any(each.queued and each.sent < count for each, count in queued.items()):
                await self.room()

    async def room(self) -> None:
        """Wait until a frame has left a queue."""
        await self._room.park()

    async def _run(self) -> None:
        """Run the wire one bit time late, so that all members that send at one time take part in the arbitration, whichever task
        runs first. A receiver still has two bits of the intermission to answer before the next frame begins."""
        while self._transports:
            self._wake = due = self.wire.next_output()
            with self._loop.move_on_at((due + self._bit) / SECOND if due < NEVER else math.inf) as scope:
                await self._changed.park()
            if scope.cancelled_caught:
                self.wire.handle_timeout(max(due, self.now() - self._bit))
                self.hand_out()

    def hand_out(self) -> None:
        """Deliver what came out of the wire, and look again when the next thing comes out."""
        if self._is_handing_out:
            return  # a receiver sends: the outer call goes on
        self._is_handing_out = True
        try:
            while self._hand_out_once():
                pass
        finally:
            self._is_handing_out = False
        if not self._transports or self.wire.next_output() < self._wake:
            self._changed.unpark_all()

    def _hand_out_once(self) -> bool:
        """Deliver what came out so far. Returns whether anything did."""
        deliveries, events = self.wire.drain()
        touched: dict[WireTransport, None] = {}
        for delivery in deliveries:
            for member in delivery.receivers:
                transport = self._transports.get(member)
                if transport is None or not (transport.is_open or delivery.queued > transport.joined_at):
                    continue
                if transport.take(delivery.frame, delivery.at):
                    touched[transport] = None
        for event in events:
            if isinstance(event, StateReported):
                transport = self._transports.get(event.member)
                if transport is not None:
                    transport.queue.report(_report(transport, event))
                    touched[transport] = None
            else:
                self.counts[event.kind] += 1
                self.faults.append(event)
        for transport in touched:
            transport.queue.wake()
        if deliveries or events:
            self._room.unpark_all()
        return bool(deliveries or events)


class WireTransport(AsyncResource):
    """A member of a PhysicalBus until `aclose`; made by `open_wire`.

    bus: to break it in tests. member: its controller, with state, error counters and transmit queue; read only. is_open: whether
    it hears all frames; before, only those queued after joined_at. Time stamps: the end of a frame. Times are ns on
    the loop's clock.
    """

    def __init__(self, locator: str, bus: PhysicalBus, order: QueueOrder, queue_size: int) -> None:
        self._loop = current_loop()
        self.locator = locator
        self.bus = bus
        self.queue = ReceiveQueue(locator, RECEIVE_QUEUE_SIZE)
        self.is_open = False
        self.joined_at = bus.now()
        self.member = bus.join(self, order, queue_size)
        self._sending = self._loop.lock()
        self._receiver: Callable[[Frame, Time], None] | None = None
        self._closed = False

    @property
    def bitrate(self) -> int:
        """Of the bus, bit/s."""
        return self.bus.wire.settings.bitrate

    async def open(self) -> None:
        """Wait until the frames from before are over, then hear all."""
        try:
            await self.bus.settle(self.member)
        except BaseException:
            self._leave()
            raise
        self.is_open = True

    async def send(self, frame: Frame) -> None:
        """Queue the frame as soon as there is room. It is sent later, in its turn."""
        check_frame(frame)
        async with self._sending:
            with self._loop.move_on_after(ROOM_TIME):
                while not self._closed and self.member.state is not BusState.BUS_OFF and not self.member.has_room:
                    await self.bus.room()
            if not self._try_to_send(frame):
                raise self._no_room(frame)
        # The frame is queued, so a cancel must not be reported here: it would tell the caller that it is not.
        await self._loop.cancel_shielded_checkpoint()

    def send_nowait(self, frame: Frame) -> bool:
        """Queue the frame. Returns False, and queues nothing, if there is no room or another task waits."""
        check_frame(frame)
        return not self._sending.locked() and self._try_to_send(frame)

    def _try_to_send(self, frame: Frame) -> bool:
        if self._closed:
            raise self._loop.ClosedResourceError(f"{self.locator} was closed")
        if self.member.state is BusState.BUS_OFF:
            raise FrameNotSentError(NOT_ACKNOWLEDGED, self.locator, f"{frame} was not sent", seen="the controller is bus-off")
        if not self.member.has_room:
            return False
        self.bus.send(self.member, frame)
        return True

    def take(self, frame: Frame, at: Time) -> bool:
        """Push a frame to the receiver, or queue it if there is none or earlier frames wait. Returns whether it was queued."""
        if self._receiver is not None and self.queue.is_empty():
            self._receiver(frame, at)
            return False
        self.queue.put((frame, at))
        return True

    def push_to(self, receiver: Callable[[Frame, Time], None] | None) -> None:
        """Call `receiver` with each frame, until None is given."""
        self._receiver = receiver

    async def receive(self) -> Received | Report:
        return await self.queue.get()

    async def receive_many(self, limit: int) -> list[Received | Report]:
        return await self.queue.get_many(limit)

    async def aclose(self) -> None:
        """Leave the bus. The last member to leave ends it."""
        self._leave()
        await self._loop.checkpoint()

    def _leave(self) -> None:
        if not self._closed:
            self._closed = True
            self._receiver = None
            self.bus.leave(self)
            self.queue.close()

    def _no_room(self, frame: Frame) -> TransportError:
        alone, full = self.member.unacknowledged, f"no room in the transmit queue of {self.member.size} frames"
        return TransportError(
            NOT_ACKNOWLEDGED,
            self.locator,
            f"{frame} was not sent on {self.locator}",
            seen=f"{full} for {ROOM_TIME:g} s; the controller is {self.member.state.value}",
            cause="nobody else is on the bus to acknowledge" if alone else "frames with lower identifiers take the whole bus",
            tries=_ALONE if alone else ("a higher bit rate", "fewer frames"),
        )


async def open_wire(locator: str, name: str, bitrate: int | None, options: Mapping[str, Option]) -> WireTransport | None:
    """Open one more member of the physical bus of this name. Returns None without options if there is no such bus.

    bitrate: the one after the locator's @. Raises TransportError (CO100) for options that are not valid, or not those of the bus.
    """
    buses = _buses.get()
    bus = buses.get(name)
    if bitrate is None and not options and bus is None:
        return None
    try:
        settings, order, queue_size = _settings(bitrate, dict(options))
        if bus is None:
            bus = buses.setdefault(name, PhysicalBus(name, settings))
        elif (bitrate is not None or set(options) - _OF_MEMBER) and settings != bus.wire.settings:
            raise ValueError(f"a bus of this name is open with other options: {bus.wire.settings}")
        transport = WireTransport(locator, bus, order, queue_size)
    except (ValueError, LocalProtocolError) as error:
        tries = (f"virtual:{name}?bitrate=500k&loss=0.001&seed=7", f"known options: {', '.join(sorted(_KNOWN))}")
        raise bad_locator(locator, str(error), tries) from error
    await transport.open()
    return transport


_RATES: Final = {"loss": "loss", "repeat": "repetition", "corrupt": "corruption", "delay": "delay"}
_OF_MEMBER: Final = {"queue", "queue_size"}
_KNOWN: Final = {"bitrate", "delay_ms", "seed", "ack", "recover", *_RATES, *_OF_MEMBER}


def _settings(bitrate: int | None, options: dict[str, Option]) -> tuple[WireSettings, QueueOrder, int]:
    unknown = sorted(set(options) - _KNOWN)
    if unknown:
        raise ValueError(f"a virtual bus has no option {unknown[0]!r}")
    rates = {field: _number(options, name, 0.0) for name, field in _RATES.items()}
    named = options.get("bitrate")
    if named is not None and bitrate is not None:
        raise ValueError("the bit rate is given twice")
    if named is not None:
        bitrate = parse_bitrate(str(named))
    settings = WireSettings(
        bitrate=DEFAULT_BITRATE if bitrate is None else bitrate,
        rates=FaultRates(**rates, delay_time=round(_number(options, "delay_ms", 5.0) * MILLISECOND)),
        seed=_whole(options, "seed", 0),
        acknowledge=_flag(options, "ack"),
        auto_recovery=_flag(options, "recover"),
    )
    order = options.get("queue", QueueOrder.FIFO.value)
    if order not in [each.value for each in QueueOrder]:
        raise ValueError(f"queue={order} is neither fifo nor priority")
    queue_size = _whole(options, "queue_size", TRANSMIT_QUEUE_SIZE)
    if queue_size < 1:
        raise ValueError(f"queue_size={queue_size} is less than 1")
    return settings, QueueOrder(order), queue_size


def _number(options: Mapping[str, object], name: str, default: float) -> float:
    value = options.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{name}={value} is not a number")
    return value


def _whole(options: Mapping[str, object], name: str, default: int) -> int:
    value = options.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError(f"{name}={value} is not a whole number")
    return value


def _flag(options: Mapping[str, object], name: str) -> bool:
    value = options.get(name, True)
    if value not in (True, False):
        raise ValueError(f"{name}={value} is neither true nor false")
    return bool(value)


_CAUSES: Final = {
    BusState.NO_ACKNOWLEDGE: ("nobody else is on the bus, or the cable is cut", _ALONE),
    BusState.BUS_OFF: ("its frames were disturbed again and again, or a test took it bus-off", ("wait for error-active",)),
}


def _report(transport: WireTransport, event: StateReported) -> BusStateChanged:
    member = event.member
    seen = f"transmit error counter {member.transmit_errors}, receive error counter {member.receive_errors}"
    cause, tries = _CAUSES.get(event.state, ("", ()))
    return BusStateChanged(transport.locator, event.state, seen, cause=cause, tries=tries)
