"""The pump: it drives the Networks of one participant, on one or several buses, with trio. A master has one, a simulated device
has one.

Theory of operation
-------------------
The core's driver loop is: mutate, drain, send, deliver, wait. Here

- one task per bus receives frames, one per bus sends them, and one for all buses keeps the time. Delivery needs no task: events
  go into bounded queues and wake tasks, which neither blocks nor calls anybody's code;
- whatever mutates a machine (a frame, a deadline, a command of any task) is followed by `pump`, at once and without a checkpoint
  between: it drains all networks until none has anything more to say. A task that is cancelled can so never leave the core ahead
  of the wire, nor the wire ahead of the core;
- what delivery itself mutates (a chain that stops because a joint failed) is drained in the same turn.

The tasks are shielded and survive the cancelling of the user's code: `Pump.run` ends by `Pump.stop` only. Without that a cancel
would put nothing on the wire, and drives would run on. All of it is protected from a KeyboardInterrupt in the middle of a turn.

**Time.** One clock, trio's, in ns. Before a due timeout is handled, the frames that are already there are taken in: a process
that was stalled (a laptop's lid, a debugger) then finds the heartbeats that came meanwhile, and reports no false HeartbeatLost.
An alarm for what has been settled meanwhile, as the timeout of a request that was answered, is not due, and costs nothing.
The timekeeper sleeps by the finest timer that the platform has (alarm.py); however late it is, SYNC keeps its phase.

**SYNC by the transport.** Where a transport wants to send the cyclic SYNC itself (`sends_sync`: socketcan's `?sync=bcm`, by which
the kernel does), our SYNC producer rests, and each SYNC that comes is reported as `SyncSent`: what follows SYNC follows it still.
Buses then keep the period, but not one phase.

**Sending.** Where the transport can (`send_nowait`), a frame goes to the kernel in the very turn that made it: one that waits
for another task costs a round of the scheduler. Where it cannot, has no room, or others wait already, it is queued, and the
sender task hands over one after the other.

**What goes first.** Frames leave in the order in which the core made them, but for SDO: its frames wait until nothing else is to
be sent, and are held back shortly before a SYNC is due (SDO_GUARD). So a cycle is SYNC, then the PDOs behind it, then SDO in what
is left.

**Filters.** Where a transport filters (`filtered`), it is told the CAN-IDs that our machines want, anew whenever they change; and
the Network that it no longer hears all.

**When a bus is away** for a while and its transport says that it may come back (BusStateChanged: interface down, bus-off), frames
that cannot be sent are dropped and counted in `FramesNotSent`. They are not kept: a set-point of some seconds ago, sent when the
bus comes back, would make a drive jump. Requests meanwhile time out as if nobody answered.

**When a bus fails**, its tasks end, what is queued for it is dropped, and `on_failure` is told once; the other buses run on until
they are stopped. A bug in the core is told in the same way, and the pump runs on, so that drives can still be halted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Final, Protocol

import trio
from trio.lowlevel import enable_ki_protection

from canopen_master.alarm import Alarm, best_alarm
from canopen_proto.frame import EXTENDED, Frame, frame_for_key
from canopen_proto.machine import MICROSECOND, NEVER, SECOND, Event, Time, event
from canopen_proto.network import Network
from canopen_proto.sync import SyncProducer, SyncReceived, SyncSent
from canopen_transports import (
    BusState,
    BusStateChanged,
    CyclicTransport,
    EagerTransport,
    FilteringTransport,
    FrameNotSent,
    ReceiveOverrun,
    Transport,
    TransportError,
)
from canopen_transports.errors import BUS_LOST, NOT_ACKNOWLEDGED

MAX_SEND_QUEUE: Final = 4096
"""Frames that wait to be sent on one bus: about one second at 500 kbit/s. A bus that is behind by more has failed."""

SDO_GUARD: Final = 300 * MICROSECOND
"""Before a SYNC no SDO frame is begun: the longest frame takes 270 us at 500 kbit/s, and a frame under way delays the SYNC."""

MAX_CATCH_UP: Final = 4096
"""Frames that are taken in before a due timeout is handled. A bus that brings more, without end, must not hold up the time."""

_QUIET_TICKS: Final = 2
"""A frame that is there reaches us within two rounds of trio's scheduler."""

_SDO_FIRST, _SDO_LAST = 0x580, 0x67F


@event
class FramesLost(Event):
    """Received frames were lost, at this place in the order of frames: PDOs and answers may be missing. node_id is 0.

    lost: how many at least. reason: where, for people.
    """

    lost: int
    reason: str


@event
class BusChanged(Event):
    """A bus reports something that is no frame, at this place in the order of frames. node_id is 0.

    state: what it is now. reason: what was seen, for people.
    """

    state: BusState
    reason: str


@event
class FramesNotSent(Event):
    """Frames were dropped, as the bus is away for the time being. node_id is 0. One event for the first of them, at once; another
    for the rest, when the bus changes or takes a frame again.

    count: how many. reason: what was seen with the first, for people.
    """

    count: int
    reason: str


class Bus:
    """One participant's place on one bus: its Network, the transport, and what waits to be sent.

    name: as this participant calls it. sync: the SYNC producer, if it has one. state: what the transport reported last.
    """

    def __init__(self, name: str, transport: Transport, network: Network, sync: SyncProducer | None = None) -> None:
        self.name = name
        self.transport = transport
        self.network = network
        self.sync = sync
        self.failed = False
        self.state = BusState.ACTIVE
        self._not_sent = 0  # beside the first, which was reported
        self._reason = ""
        self._first: deque[Frame] = deque()
        self._sdo: deque[Frame] = deque()
        self._is_sending = False
        self._filter = transport if isinstance(transport, FilteringTransport) and transport.filtered else None
        self._eager = transport if isinstance(transport, EagerTransport) else None
        self._wanted: tuple[int, ...] | None = None
        self._cyclic = transport if isinstance(transport, CyclicTransport) and transport.sends_sync else None
        self._period: Time = 0  # of the transport's SYNC
        self._last_sync: Time | None = None
        self._work = trio.lowlevel.ParkingLot()  # the sender waits for frames
        self._sent = trio.lowlevel.ParkingLot()  # others wait for the sender

    @property
    def pending(self) -> int:
        """Frames that have not reached the transport yet."""
        return len(self._first) + len(self._sdo) + self._is_sending

    def queue(self, frames: Sequence[Frame], now: Time) -> bool:
        """Send frames at once, where the transport can and nothing waits before them, else queue them; False: they are too many.

        Raises what the transport does where sending at once fails.
        """
        if self.failed:
            return True
        eager = self._eager is not None and not self._first and not self._is_sending
        for frame in frames:
            if _SDO_FIRST <= frame.can_id <= _SDO_LAST and not frame.flags & EXTENDED:
                self._sdo.append(frame)
            elif not (eager and self._send_at_once(frame)):
                eager = False
                self._first.append(frame)
        if eager:
            while self._sdo and self._until_sync(now) > SDO_GUARD and self._send_at_once(self._sdo[0]):
                self._sdo.popleft()
        if self._first or self._sdo:
            self._work.unpark()
        return len(self._first) + len(self._sdo) <= MAX_SEND_QUEUE

    def _send_at_once(self, frame: Frame) -> bool:
        """Whether the frame is out, or cannot get out now and was dropped."""
        assert self._eager is not None
        try:
            if not self._eager.send_nowait(frame):
                return False
        except FrameNotSent as refusal:
            self.drop(refusal.seen)
        else:
            self.settle_not_sent()
        return True

    def change(self, state: BusState, reason: str) -> None:
        """The transport reports a change. Events: FramesNotSent, BusChanged."""
        self.state = state
        self.settle_not_sent()
        if state is BusState.UP and self._period:
            self.start_sync(self._period, 0)  # an adapter that was plugged in again has forgotten it
        self.network.out.events.append(BusChanged(0, state, reason))

    def drop(self, reason: str) -> None:
        """A frame could not be sent. Event: FramesNotSent, for the first of them."""
        if self._reason:
            self._not_sent += 1
        else:
            self._reason = reason or "the bus is away"
            self.network.out.events.append(FramesNotSent(0, 1, self._reason))

    def settle_not_sent(self) -> None:
        """The bus changed, or takes frames again. Event: FramesNotSent, where more than the first were dropped."""
        if self._not_sent:
            self.network.out.events.append(FramesNotSent(0, self._not_sent, self._reason))
        self._not_sent, self._reason = 0, ""

    def renew_filters(self) -> None:
        """Tell a transport that filters what our machines want."""
        if self._filter is not None:
            wanted = self.network.can_ids()
            if wanted != self._wanted:
                self._wanted = wanted
                self.network.hears_all = not self._filter.set_filters(wanted)

    # ---- SYNC ----

    @property
    def sync_period(self) -> Time:
        """ns between two SYNCs that we send, or our transport; 0 for none."""
        return self._period or (self.sync.period if self.sync is not None else 0)

    def start_sync(self, period: Time, now: Time) -> None:
        """Send SYNC now and then once per period (ns), by our producer or by the transport. Raises TransportError."""
        assert self.sync is not None
        if self._cyclic is None:
            self.sync.start(period, now)
            return
        key, overflow = self.sync.key, self.sync.counter_overflow
        counters = [bytes((count,)) for count in range(1, overflow + 1)] or [b""]
        self._cyclic.start_cyclic([frame_for_key(key, counter) for counter in counters], period)
        self._period, self._last_sync = period, None

    def stop_sync(self) -> None:
        """Send no more SYNC by itself."""
        if self.sync is not None:
            self.sync.stop()
        if self._cyclic is not None:
            self._cyclic.stop_cyclic()
            self._period = 0

    def sync_came(self, sync: SyncReceived, now: Time) -> Event:
        """What a received SYNC is here: ours, where the transport sends them."""
        if not self._period:
            return sync
        skipped = 0
        if self._last_sync is not None:
            skipped = max(0, round((now - self._last_sync) / self._period) - 1)
        self._last_sync = now
        return SyncSent(0, sync.counter, skipped)

    def _until_sync(self, now: Time) -> Time:
        """ns until the next SYNC is due."""
        if self._period and self._last_sync is not None:
            return (self._last_sync + self._period - now) % self._period
        return self.sync.deadline - now if self.sync is not None else NEVER

    @property
    def is_dropping(self) -> bool:
        """Whether the last frame could not be sent."""
        return bool(self._reason)

    def fail(self) -> None:
        """Drop what waits: nothing more can be sent."""
        self.failed = True
        self._first.clear()
        self._sdo.clear()
        self._sent.unpark_all()

    async def flush(self) -> None:
        """Wait until all frames queued so far and meanwhile have reached the transport, or the bus has failed."""
        while self.pending and not self.failed:
            await self._sent.park()

    async def next_frame(self, now: Callable[[], Time]) -> Frame:
        """The frame that is to be sent next."""
        self._is_sending = False
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
                with trio.move_on_after(max(until_sync, SDO_GUARD) / SECOND):
                    await self._work.park()
            else:
                await self._work.park()
        self._is_sending = True
        return frame


class Listener(Protocol):
    """Who is told of each event, and of a failure."""

    def on_event(self, bus: Bus, event: Event) -> None:
        """An event came out of a bus's network. May mutate machines; must not raise or block."""

    def on_failure(self, bus: Bus | None, error: Exception) -> None:
        """A bus failed (TransportError), or, without a bus, something is wrong in our own code. At most once per bus."""


class Pump:
    """Runs the networks of `buses`; see this module's text. buses: at least one, all with the first one's Runner."""

    def __init__(self, buses: Sequence[Bus], listener: Listener) -> None:
        self.buses = tuple(buses)
        self._listener = listener
        self._scope = trio.CancelScope(shield=True)
        self._alarm: Alarm | None = None
        self._is_pumping = False
        self._received = 0
        self._renew_filters()

    def now(self) -> Time:
        """trio's clock in ns: the one time of all machines."""
        return round(trio.current_time() * SECOND)

    @enable_ki_protection
    def pump(self, now: Time | None = None) -> None:
        """Take up everything that the machines have to say, until they have no more. After each mutation (at `now`)."""
        if self._is_pumping:
            return  # called by what is being delivered: the loop below goes round again
        self._is_pumping = True
        try:
            if now is None:
                now = self.now()
            busy = True
            while busy:
                busy = False
                for bus in self.buses:
                    out = bus.network.out
                    if out.frames or out.events:
                        busy = True
                        self._take(bus, now)
        finally:
            self._is_pumping = False
        self._renew_filters()
        self._set_alarm()

    def _renew_filters(self) -> None:
        for bus in self.buses:
            bus.renew_filters()

    def _take(self, bus: Bus, now: Time) -> None:
        frames, events = bus.network.drain(now)
        try:
            if frames and not bus.queue(frames, now):
                name, seen = getattr(bus.transport, "locator", bus.name), f"{bus.pending} frames wait to be sent"
                raise TransportError(NOT_ACKNOWLEDGED, name, f"{name} does not take our frames", seen=seen)
        except Exception as error:  # noqa: BLE001 - a transport of somebody else's may raise anything
            self._fail(bus, error, "send")
        for each in events:
            self._listener.on_event(bus, bus.sync_came(each, now) if isinstance(each, SyncReceived) else each)

    def stop(self) -> None:
        """End the tasks. What is queued is not sent any more: `flush` first."""
        self._scope.cancel()

    async def flush(self) -> None:
        """Wait until all that is queued has reached the transports."""
        for bus in self.buses:
            await bus.flush()

    @enable_ki_protection
    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """The tasks. Started in a nursery; returns after `stop` only, whatever is cancelled around it."""
        with self._scope:
            async with trio.open_nursery() as nursery:
                for bus in self.buses:
                    nursery.start_soon(self._receive, bus)
                    nursery.start_soon(self._send, bus)
                nursery.start_soon(self._keep_time)
                task_status.started()

    @enable_ki_protection
    async def _receive(self, bus: Bus) -> None:
        while not bus.failed:
            try:
                frame, timestamp = await bus.transport.receive()
            except ReceiveOverrun as overrun:
                self._turn(bus.network.out.events.append, FramesLost(0, overrun.lost, overrun.seen))
            except BusStateChanged as change:
                self._turn(bus.change, change.state, change.seen)
            except Exception as error:  # noqa: BLE001 - a transport of somebody else's may raise anything
                self._fail(bus, error, "receive")
            else:
                self._received += 1
                now = self.now()
                self._turn(bus.network.receive, frame, now, timestamp, now=now)

    @enable_ki_protection
    async def _send(self, bus: Bus) -> None:
        while not bus.failed:
            frame = await bus.next_frame(self.now)
            try:
                await bus.transport.send(frame)
            except FrameNotSent as refusal:
                self._turn(bus.drop, refusal.seen)
            except Exception as error:  # noqa: BLE001 - as above
                self._fail(bus, error, f"send {frame}")
            else:
                if bus.is_dropping:
                    self._turn(bus.settle_not_sent)

    @enable_ki_protection
    async def _keep_time(self) -> None:
        with closing(best_alarm()) as self._alarm:
            while True:
                self._set_alarm()
                await self._alarm.wait()
                if self._next_deadline() <= self.now():
                    await self._catch_up()
                    self._turn(self._handle_timeouts)

    async def _catch_up(self) -> None:
        """Let the receivers handle what is already there."""
        for _ in range(MAX_CATCH_UP):
            received = self._received
            for _ in range(_QUIET_TICKS):
                await trio.lowlevel.checkpoint()
            if received == self._received:
                return

    def _handle_timeouts(self) -> None:
        """One instant for all buses: SYNCs that are due together go out together."""
        now = self.now()
        for bus in self.buses:
            bus.network.handle_timeout(now)

    def _set_alarm(self) -> None:
        """Wake the timekeeper in time. An earlier alarm is left alone: an early wake does no harm."""
        if self._alarm is not None:
            deadline = self._next_deadline()
            if deadline < NEVER:
                self._alarm.set(deadline / SECOND)

    def _next_deadline(self) -> Time:
        nearest = NEVER
        for bus in self.buses:
            deadline = bus.network.next_deadline()
            if deadline < nearest:
                nearest = deadline
        return nearest

    def _turn(self, mutate: Callable[..., object], *args: object, now: Time | None = None) -> None:
        try:
            mutate(*args)
            self.pump(now)
        except Exception as error:  # noqa: BLE001 - a bug in the core: it must reach the user, but the drives be halted before
            self._listener.on_failure(None, error)

    def _fail(self, bus: Bus, error: Exception, doing: str) -> None:
        if bus.failed:
            return
        bus.fail()
        if not isinstance(error, TransportError):
            closed = isinstance(error, trio.ClosedResourceError)
            seen = "somebody has closed the transport" if closed else f"{type(error).__name__}: {error}"
            name = getattr(bus.transport, "locator", bus.name)
            cause, error = error, TransportError(BUS_LOST, name, f"cannot {doing} on {name}", seen=seen)
            error.__cause__ = cause
        self._listener.on_failure(bus, error)
