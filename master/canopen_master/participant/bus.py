"""`Bus`: one bus of a participant: its Network, its transport, and the frames that wait to be sent. The pump (pump.py) drives it.

**SYNC by the transport.** A transport may send the cyclic SYNC itself (`sends_sync`; with socketcan's `?sync=bcm` the kernel
does). Our SYNC producer then rests, and each SYNC that comes is reported as `SyncSent`, so that everything else follows it as
before. The buses then have the same period, but not the same phase.

**Sending.** A frame goes to the kernel in the turn that made it, if the transport can do that (`send_nowait`): waiting for
another task costs a round of the scheduler. A frame is queued if the transport cannot, has no room, or other frames wait already.
The sender task then hands over one after the other.

**Order.** Frames leave in the order in which the core made them, except SDO frames. These wait until nothing else is to be sent,
and are held back shortly before a SYNC is due (SDO_GUARD). So a cycle is SYNC, then the PDOs after it, then SDO in the time left.

**Filters.** A transport that filters (`filtered`) gets the CAN-IDs that our machines want, and gets them again when they change.
The Network then knows that it does not hear everything.

**Listeners** (`Bus.listen`) are told each frame that passes, and where frames were lost, in its order: for a recording, or a
display. While there is one, the transport leaves out no frame.

**When a bus is away** for a while, and its transport reports that it may come back (BusStateChanged: interface down, bus-off),
frames that cannot be sent are dropped and counted in `FramesNotSent`. Keeping them would be dangerous: an old set-point, sent
when the bus comes back, would make a drive jump. Requests time out, and their errors say why (`Network.outage`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Sequence
from typing import Final, TypeAlias

from canopen_proto.frame import Frame, RoutingKey, frame_for_key
from canopen_proto.frame_bits import FRAME_BITS
from canopen_proto.machine import MICROSECOND, NEVER, SECOND, Event, Time
from canopen_proto.network import Network
from canopen_proto.sync import SyncConsumer, SyncProducer, SyncReceived, SyncSent
from canopen_transports import (
    BatchTransport,
    BusState,
    BusStateChanged,
    CyclicTransport,
    EagerTransport,
    FilteringTransport,
    FrameNotSentError,
    PromptTransport,
    PushingTransport,
    RatedTransport,
    Received,
    ReceiveOverrun,
    Report,
    Transport,
    TransportError,
)
from canopen_transports.loop import current_loop

MAX_BATCH: Final = 64
"""The most frames that are received in one turn: 4 ms of a 1 Mbit/s bus that is full of 8-byte frames."""

MAX_SEND_QUEUE: Final = 4096
"""The most frames that wait to be sent on one bus: about one second at 500 kbit/s. With more, the bus counts as failed."""

SDO_GUARD: Final = 300 * MICROSECOND
"""No SDO frame is sent so shortly before a SYNC: the longest frame takes 270 us at 500 kbit/s, and would delay the SYNC."""

SAME_SYNC: Final = 10
"""SYNCs that come within this part of their period were waiting for this process, which was stalled."""

MAX_HELD: Final = 256
"""Received frames that wait for the one that is being sent, before a listener is told of both."""

HeardFrame: TypeAlias = Callable[[Frame, Time, "int | None", bool], None]
"""Takes a frame, the participant's time (ns), the transport's own time stamp (ns) if it has one, and whether we have sent it."""

HeardLoss: TypeAlias = Callable[[int, str], None]
"""Takes how many frames were lost at least, and where, for people."""

_Passed: TypeAlias = tuple[Frame, Time, "int | None", bool] | ReceiveOverrun
_Listeners: TypeAlias = tuple[tuple[HeardFrame, HeardLoss], ...]

_SDO_FIRST, _SDO_LAST = 0x580, 0x67F
_NOT_ASKED: Final = (RoutingKey(-1),)
"""What nobody wants: the first filters are always others."""
_BUS_OFF: Final = BusState.BUS_OFF


class FramesLost(Event):
    """Received frames were lost, at this place in the order of frames: PDOs and answers may be missing. node_id is 0.

    lost: how many at least. reason: where, for people.
    """

    __match_args__ = ("node_id", "lost", "reason")

    def __init__(self, node_id: int, lost: int, reason: str) -> None:
        self.node_id = node_id
        self.lost = lost
        self.reason = reason


class BusChanged(Event):
    """A bus reports something that is no frame, at this place in the order of frames. node_id is 0.

    state: what it is now. reason: what was seen, for people.
    """

    __match_args__ = ("node_id", "state", "reason")

    def __init__(self, node_id: int, state: BusState, reason: str) -> None:
        self.node_id = node_id
        self.state = state
        self.reason = reason


class FramesNotSent(Event):
    """Frames were dropped, because the bus is away for a while. node_id is 0. The first one is reported at once, the others
    together when the bus changes or takes a frame again.

    count: the number of frames. reason: for the first one, as text.
    """

    __match_args__ = ("node_id", "count", "reason")

    def __init__(self, node_id: int, count: int, reason: str) -> None:
        self.node_id = node_id
        self.count = count
        self.reason = reason


class Bus:
    """One bus of a participant: its Network, its transport, and the frames that wait to be sent.

    name: the participant's name for it. sync, consumer: our SYNC producer, if there is one, and the consumer of the SYNC of
    others. state: the last one that the transport reported. bitrate: bit/s, None if nobody tells it. bits: of all frames that
    were sent and heard so far, about (FRAME_BITS); with `bitrate` they tell the load.
    """

    def __init__(
        self,
        name: str,
        transport: Transport,
        network: Network,
        sync: SyncProducer | None = None,
        consumer: SyncConsumer | None = None,
    ) -> None:
        self.name = name
        self.transport = transport
        self.network = network
        self.sync = sync
        self.consumer = consumer
        self.bitrate = transport.bitrate if isinstance(transport, RatedTransport) else None
        self._own_bits = 0
        self.failed = False
        self.state = BusState.ACTIVE
        self._not_sent = 0  # beside the first, which was reported
        self._reason = ""
        self._first: deque[Frame] = deque()
        self._sdo: deque[Frame] = deque()
        self._is_sending = False
        self._filter = transport if isinstance(transport, FilteringTransport) and transport.filtered else None
        self._eager = transport if isinstance(transport, EagerTransport) else None
        self._batch = transport if isinstance(transport, BatchTransport) else None
        self._prompt = transport if isinstance(transport, PromptTransport) else None
        self._wanted: tuple[RoutingKey, ...] | None = _NOT_ASKED  # None: all
        self._cyclic = transport if isinstance(transport, CyclicTransport) and transport.sends_sync else None
        self._period: Time = 0  # of the transport's SYNC
        self._last_sync: Time | None = None
        self._loop = current_loop()
        self._work = self._loop.parking_lot()  # the sender waits for frames
        self._sent = self._loop.parking_lot()  # others wait for the sender
        self._listeners: _Listeners = ()
        self._held: list[tuple[_Passed, _Listeners]] = []  # what listeners are told behind a frame that is being sent
        self._handing = 0  # frames that are being handed over at once: others may come before that has returned

    @property
    def bits(self) -> int:
        """See the class."""
        return self._own_bits + self.network.bits

    def note(self, frame: Frame, now: Time, *, is_sent: bool) -> None:
        """Count a frame that passed beside `take_in`, and tell the listeners."""
        self._own_bits += FRAME_BITS[len(frame.data)]
        if not self._listeners:
            return
        if is_sent:
            self._held.insert(0, ((frame, now, None, True), self._listeners))
            self._tell_held()
        else:
            self._tell_received((frame, now, None, False))

    def listen(self, heard: HeardFrame, lost: HeardLoss = lambda count, seen: None) -> Callable[[], None]:
        """Call `heard` with each frame that is received or sent from now on; return what ends that. It must not raise, and must
        not block: it is called in the turn of the pump. A frame that we send is told once the transport has it. lost: is called
        in the same way where received frames were lost, between the frames before and behind it; FramesLost comes behind them."""
        listener = heard, lost
        self._listeners = (*self._listeners, listener)
        self.renew_filters()

        def end() -> None:
            self._listeners = tuple(each for each in self._listeners if each is not listener)
            self.renew_filters()

        return end

    @property
    def pending(self) -> int:
        """The number of frames that have not reached the transport yet."""
        return len(self._first) + len(self._sdo) + self._is_sending

    def queue(self, frames: Sequence[Frame], now: Time) -> bool:
        """Send frames at once if the transport can and no frame waits, else queue them. Returns False if they are too many.

        Raises the transport's error if sending at once fails.
        """
        if self.failed:
            return True
        first, sdo = self._first, self._sdo
        eager = self._eager is not None and not first and not self._is_sending
        for frame in frames:
            if _SDO_FIRST <= frame.key <= _SDO_LAST:
                sdo.append(frame)
            elif not (eager and self._send_at_once(frame, now)):
                eager = False
                first.append(frame)
        if eager and sdo and self._until_sync(now) > SDO_GUARD:
            while sdo and self._send_at_once(sdo[0], now):
                sdo.popleft()
        if not (first or sdo):
            return True
        self._work.unpark()
        return len(first) + len(sdo) <= MAX_SEND_QUEUE

    def _send_at_once(self, frame: Frame, now: Time) -> bool:
        """Try to send a frame. Return False if it has to wait; a frame that the bus cannot send now is dropped."""
        assert self._eager is not None
        place = len(self._held)
        self._handing += 1
        try:
            if not self._eager.send_nowait(frame):
                return False
        except FrameNotSentError as refusal:
            self.drop(refusal.seen)
        else:
            self._own_bits += FRAME_BITS[len(frame.data)]
            if self._listeners:
                self._held.insert(place, ((frame, now, None, True), self._listeners))
            if self._reason:
                self.settle_not_sent()
        finally:
            self._handing -= 1
            if self._held and not self._handing:
                self._tell_held()
        return True

    def receive(self) -> Awaitable[Sequence[Received | Report]]:
        """Wait as `_receive_one` does; the transport's own coroutine, where it returns several at once."""
        return self._receive_one() if self._batch is None else self._batch.receive_many(MAX_BATCH)

    async def _receive_one(self) -> Sequence[Received | Report]:
        """Wait until something comes; return the frames and reports that are there, at most MAX_BATCH.

        Raises the transport's error: it has failed then.
        """
        return (await self.transport.receive(),)

    def receive_nowait(self) -> Sequence[Received | Report] | None:
        """Return what has come, MAX_BATCH at most; None if the transport cannot tell. Raises as `receive` does."""
        return None if self._prompt is None else self._prompt.receive_nowait(MAX_BATCH)

    def push_to(self, receiver: Callable[[Frame, Time], None] | None) -> None:
        """Let the transport push frames to `receiver`, if it can; None = stop."""
        if isinstance(self.transport, PushingTransport):
            self.transport.push_to(receiver)

    def take_in(self, received: Iterator[Received | Report], now: Time) -> None:
        """Hand frames to the network, and handle reports. Events: FramesLost, BusChanged, FramesNotSent, and the network's.

        After an exception (a bug of the core), `received` still has the items after the one that caused it.
        """
        network = self.network
        if self._listeners:
            received = self._told(received, now)
        while True:
            item = next(received, None) if self.state is _BUS_OFF else network.receive_many(received, now)
            if item is None:
                return
            if isinstance(item, tuple):
                self.change(BusState.ACTIVE, "a frame was received")
                network.receive_many(iter((item,)), now)
            elif isinstance(item, ReceiveOverrun):
                network.note_gap(item.lost, item.seen, now)
                network.out.events.append(FramesLost(0, item.lost, item.seen))
            elif isinstance(item, BusStateChanged):
                self.change(item.state, item.seen)

    def _told(self, received: Iterator[Received | Report], now: Time) -> Iterator[Received | Report]:
        """Pass on what was received, and tell the listeners of its frames. What comes while one of ours is being sent waits for
        it: an answer must not be told before its request."""
        for item in received:
            if isinstance(item, tuple):
                self._tell_received((item[0], now, item[1], False))
            elif isinstance(item, ReceiveOverrun):
                self._tell_received(item)
            yield item

    def _tell_received(self, passed: _Passed) -> None:
        self._held.append((passed, self._listeners))
        if not (self._handing or self._is_sending) or len(self._held) > MAX_HELD:
            self._tell_held()

    def _tell_held(self) -> None:
        held, self._held = self._held, []
        for passed, listeners in held:
            for listener in listeners:
                if listener not in self._listeners:
                    continue  # it has ended
                heard, lost = listener
                if isinstance(passed, tuple):
                    heard(*passed)
                else:
                    lost(passed.lost, passed.seen)

    def change(self, state: BusState, reason: str) -> None:
        """Handle a change that the transport reports. Events: FramesNotSent, BusChanged. reason: for people."""
        self.state = state
        self.settle_not_sent()
        if state in (BusState.BUS_OFF, BusState.DOWN):
            self.network.outage = f"{self.name} is {state.value}: {reason}"
        elif state not in (BusState.NO_ACKNOWLEDGE, BusState.FAULT):
            self.network.outage = ""
        self.network.out.events.append(BusChanged(0, state, reason))
        if state is BusState.UP and self._period:
            self._start_sync_again()

    def _start_sync_again(self) -> None:
        """Start the transport's SYNC again: an adapter that was unplugged has lost it. Event: BusChanged if the adapter is gone
        again."""
        try:
            self.start_sync(self._period, 0)
        except TransportError as error:
            self.network.out.events.append(BusChanged(0, BusState.FAULT, f"SYNC is not sent: {error.failed} ({error.seen})"))

    def drop(self, reason: str) -> None:
        """Count a frame that could not be sent. Event: FramesNotSent, for the first of them. reason: for people."""
        if self._reason:
            self._not_sent += 1
        else:
            self._reason = reason or "the bus is away"
            self.network.out.events.append(FramesNotSent(0, 1, self._reason))

    def settle_not_sent(self) -> None:
        """Stop counting: the bus changed, or takes frames again. Event: FramesNotSent if more than one frame was dropped."""
        if self._not_sent:
            self.network.out.events.append(FramesNotSent(0, self._not_sent, self._reason))
        self._not_sent, self._reason = 0, ""

    @property
    def is_filtered(self) -> bool:
        """Whether the transport wants to know which frames our machines want."""
        return self._filter is not None

    def renew_filters(self) -> None:
        """Give the CAN-IDs that our machines want to a transport that filters; a listener wants all."""
        if self._filter is not None:
            wanted = None if self._listeners else self.network.can_ids()
            if wanted != self._wanted:
                self._wanted = wanted
                self.network.hears_all = not self._filter.set_filters(wanted)

    @property
    def sync_period(self) -> Time:
        """The time between two SYNCs of ours or of our transport, ns; 0 = none."""
        return self._period or (self.sync.period if self.sync is not None else 0)

    @property
    def hears_own_sync(self) -> bool:
        """Whether a SYNC that comes is ours, because the transport sends it."""
        return bool(self._period)

    def start_sync(self, period: Time, now: Time) -> None:
        """Send SYNC now and then once per period (ns), by our producer or by the transport. Raises TransportError."""
        assert self.sync is not None
        if self._cyclic is None:
            self.sync.start(period, now)
            return
        key, overflow = self.sync.key, self.sync.counter_overflow
        if self.consumer is not None:
            self.consumer.configure(key, overflow)  # by which we follow it
        counters = [bytes((count,)) for count in range(1, overflow + 1)] or [b""]
        self._cyclic.start_cyclic([frame_for_key(key, counter) for counter in counters], period)
        self._period, self._last_sync = period, None

    def stop_sync(self) -> None:
        """Stop the periodic SYNC."""
        if self.sync is not None:
            self.sync.stop()
        if self._cyclic is not None:
            self._cyclic.stop_cyclic()
            self._period = 0

    def with_own_syncs(self, events: Sequence[Event], now: Time) -> list[Event]:
        """Return the events with SyncSent in place of a SYNC that the transport has sent for us (`hears_own_sync`).

        Of several that came while this process was stalled the first one counts, with the others as skipped ones. A path would go
        on by a step for each of them otherwise, all in one period.
        """
        told: list[Event] = []
        for each in events:
            if not isinstance(each, SyncReceived):
                told.append(each)
                continue
            since = self._period if self._last_sync is None else now - self._last_sync
            if since * SAME_SYNC >= self._period:
                told.append(SyncSent(0, each.counter, max(0, round(since / self._period) - 1)))
                self._last_sync = now
        return told

    def _until_sync(self, now: Time) -> Time:
        """Return the time until the next SYNC is due, ns."""
        if self._period and self._last_sync is not None:
            return (self._last_sync + self._period - now) % self._period
        return self.sync.deadline - now if self.sync is not None else NEVER

    @property
    def is_dropping(self) -> bool:
        """Whether the last frame could not be sent."""
        return bool(self._reason)

    def fail(self) -> None:
        """Drop what waits: nothing more can be sent."""
        self.silence()
        self._tell_held()
        self._sent.unpark_all()

    def silence(self) -> None:
        """Send nothing any more, and wake nobody."""
        self.failed = True
        self._first.clear()
        self._sdo.clear()

    async def flush(self) -> None:
        """Wait until the transport has all frames, also those queued during the wait, or the bus has failed."""
        while self.pending and not self.failed:
            await self._sent.park()

    async def next_frame(self, now: Callable[[], Time]) -> Frame:
        """Return the next frame to send."""
        self._is_sending = False
        if self._held:
            self._tell_held()
        if not self.pending:
            self._sent.unpark_all()
        while True:
            if self._first:
                frame = self._first.popleft()
                break
            if self._sdo:
                until_sync = self._until_sync(now())
                if until_sync > SDO_GUARD:
                    frame = self._sdo.popleft()
                    break
                with self._loop.move_on_after(max(until_sync, SDO_GUARD) / SECOND):
                    await self._work.park()
            else:
                await self._work.park()
        self._is_sending = True
        return frame

    def put_back(self, frame: Frame) -> None:
        """The frame was not sent: it is the next one again."""
        self._first.appendleft(frame)
