"""The pump: it drives the Networks of one participant, on one or several buses. A master has one, a simulated device has one.

The core's driver loop is: mutate, drain, send, deliver, wait. Here (of sending and of what a bus reports: bus.py)

- one task per bus receives frames, one per bus sends them, and one for all buses keeps the time. Delivery needs no task: events
  go into bounded queues and wake tasks, which neither blocks nor calls anybody's code;
- a bus inside this process pushes its frames (`PushingTransport`): they are taken in within the turn of the participant that
  sends them, and no task is woken. So a read of a simulated device costs one round of the scheduler: the caller's own;
- whatever mutates a machine (a frame, a deadline, a command of any task) is followed by `pump`, at once and without a checkpoint
  between: it drains all networks until none has anything more to say. A task that is cancelled can so never leave the core ahead
  of the wire, nor the wire ahead of the core;
- what delivery itself mutates (a chain that stops because a joint failed) is drained in the same turn;
- a machine may be commanded by anybody, without `pump` behind it (`node.remote.start_guarding(...)`): before the loop sleeps,
  the pump sees what was left, and takes it up.

The tasks are shielded and survive the cancelling of the user's code: `Pump.run` ends by `Pump.stop` only. Without that a cancel
would put nothing on the wire, and drives would run on. All of it is protected from a KeyboardInterrupt in the middle of a turn.

**Time.** One clock, the loop's, in ns. Before a due timeout is handled, the frames that are already there are taken in, at once
where the transport can tell what has come, else by giving the receivers a few rounds of the loop: a process that was stalled (a
laptop's lid, a debugger) then finds the heartbeats that came meanwhile, and reports no false HeartbeatLost. If it was stalled
during that look, it looks again. Participants of one process (a master and its simulated devices) are stalled together: if any of
them is late, all are, and a device waits for the overdue heartbeat of its master. An alarm for what has been settled meanwhile,
as the timeout of a request that was answered, is not due, and costs nothing. The timekeeper sleeps by the finest timer that the
platform has (alarm.py); however late it is, SYNC keeps its phase.

**A child by `os.fork`** has copies of all this, but buses and loop are its parent's: the kernel has one list of what the loop
waits for, for both. So nothing is sent there, and commands are refused. A child that goes on in the loop would make its parent
deaf, and is ended.

**When a bus fails**, its tasks end, what is queued for it is dropped, and `on_failure` is told once; the other buses run on until
they are stopped. A bug in the core is told in the same way, and the pump runs on, so that drives can still be halted.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from typing import Final, TypeAlias

from canopen_master.errors import forked
from canopen_master.participant.alarm import Alarm, best_alarm
from canopen_master.participant.bus import MAX_BATCH, Bus
from canopen_proto.explained import counted
from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, Time
from canopen_transports import FrameNotSentError, Received, Report, TransportError
from canopen_transports.errors import BUS_LOST, NOT_ACKNOWLEDGED
from canopen_transports.loop import TASK_STATUS_IGNORED, CancelScope, RunVar, TaskStatus, current_loop, protected

MAX_CATCH_UP: Final = 4096
"""Frames that are taken in before a due timeout is handled. A bus that brings more, without end, must not hold up the time."""

_STALL: Final = 5 * MILLISECOND
"""An alarm that comes later than this means that the process was stalled."""

MAX_LOOKS: Final = 4
"""How often, before a due timeout is handled, it is seen to that the process was not stalled while it looked at what had come."""

QUIET_TICKS: Final = 3
"""A sender that sends a frame in each round is heard at least once in three: a receiver that waits is woken in the next round."""

_all: Final[set[Pump]] = set()  # those of all loops of this process that run
_pumps: RunVar[set[Pump]] = RunVar(set)  # those of this run of the loop that run


OnEvents: TypeAlias = Callable[[Bus, Sequence[Event]], None]
"""Events came out of a bus's network, in order. May mutate machines; must not block. It tells all of them, whatever one raises;
`OnFailure` is told of the exception that it raises then."""

OnFailure: TypeAlias = Callable[[Bus | None, Exception], None]
"""A bus failed (TransportError), or, without a bus, something is wrong in our own code. At most once per bus."""


class Pump:
    """Runs the networks of `buses`; see this module's text. buses: at least one, all with the first one's Runner.

    on_events, on_failure: called with what the networks report, and with what goes wrong.
    quiet_ticks: after a stall, so many rounds of the loop without a frame show that all frames were taken in.
    before_timeouts: called before due timeouts are handled, with the time. May mutate machines; must not block or raise.
    """

    def __init__(
        self,
        buses: Sequence[Bus],
        on_events: OnEvents,
        on_failure: OnFailure,
        quiet_ticks: int = QUIET_TICKS,
        before_timeouts: Callable[[Time], None] | None = None,
    ) -> None:
        self.buses = tuple(buses)
        self._on_events = on_events
        self._on_failure = on_failure
        self._quiet_ticks = quiet_ticks
        self._before_timeouts = before_timeouts
        self._loop = current_loop()
        self._token = self._loop.token()
        self._scope = self._loop.cancel_scope(shield=True)
        self._all_tasks: CancelScope | None = None
        self._alarm: Alarm | None = None
        self._wake: Time = NEVER  # what the alarm is set for
        self._is_pumping = False
        self.is_inherited = False
        self._received = 0
        outs = [bus.network.out for bus in self.buses]
        self._said = tuple((bus, out.frames, out.events) for bus, out in zip(self.buses, outs, strict=True))
        self._left = tuple(each for out in outs for each in (out.frames, out.events, out.armed, out.rerouted))
        deadlines = [bus.network.next_deadline for bus in self.buses]
        self._next_deadline = deadlines[0] if len(deadlines) == 1 else lambda: min([each() for each in deadlines])
        self._clock = self._loop.clock()
        self._running = _pumps.get()
        self._filtered = tuple(bus for bus in self.buses if bus.is_filtered)
        self._renew_filters()

    def now(self) -> Time:
        """Return the loop's clock in ns: the one time of all machines."""
        return round(self._clock() * SECOND)

    @protected
    def pump(self, now: Time | None = None) -> None:
        """Take up everything that the machines have to say, until nothing is left. Call it after each mutation (at `now`)."""
        if self._is_pumping:
            return  # called by what is being delivered: the loop below goes round again
        self._is_pumping = True
        try:
            if now is None:
                now = self.now()
            busy = True
            while busy:
                busy = False
                for bus, frames, events in self._said:
                    if frames or events:
                        busy = True
                        self._take(bus, now)
        finally:
            self._is_pumping = False
        if self._filtered:
            self._renew_filters()
        self._set_alarm()

    def _renew_filters(self) -> None:
        for bus in self._filtered:
            bus.renew_filters()

    def _take(self, bus: Bus, now: Time) -> None:
        frames, events = bus.network.drain(now)
        try:
            if frames and not bus.queue(frames, now):
                name, seen = getattr(bus.transport, "locator", bus.name), f"{counted(bus.pending, 'frame')} still to be sent"
                raise TransportError(NOT_ACKNOWLEDGED, name, f"{name} does not take our frames", seen=seen)
        except Exception as error:  # noqa: BLE001 - a transport of somebody else's may raise anything
            self._fail(bus, error, "send")
        if bus.hears_own_sync:
            events = bus.with_own_syncs(events, now)
        if events:
            try:
                self._on_events(bus, events)
            except Exception as error:  # noqa: BLE001 - it must reach the user
                self._on_failure(None, error)

    def stop(self) -> None:
        """End the tasks. Queued frames are not sent: call `flush` before."""
        self._scope.cancel()

    async def flush(self) -> None:
        """Wait until all that is queued has reached the transports."""
        for bus in self.buses:
            await bus.flush()

    @protected
    async def run(self, task_status: TaskStatus[None] = TASK_STATUS_IGNORED) -> None:
        """The tasks. Started in a nursery; returns after `stop` only, whatever is cancelled around it."""
        end_looks = self._loop.before_sleep(self._look)
        self._running.add(self)
        _all.add(self)
        try:
            with self._loop.holding_interrupts(), self._scope:
                async with self._loop.open_nursery() as nursery:
                    self._all_tasks = nursery.cancel_scope
                    for bus in self.buses:
                        bus.push_to(partial(self._pushed, bus))
                        nursery.start_soon(self._receive, bus)
                        nursery.start_soon(self._send, bus)
                    nursery.start_soon(self._keep_time)
                    task_status.started()
        finally:
            self._running.discard(self)
            _all.discard(self)
            for bus in self.buses:
                bus.push_to(None)
            end_looks()

    def leave_to_parent(self) -> None:
        """In a child by `fork`: send nothing, and let the loop not go on."""
        self.is_inherited = True
        for bus in self.buses:
            bus.silence()
        if self._loop.cancels_at_end:  # asyncio.run: it would cancel, and forget sockets, before the loop sleeps
            self._token.run_sync_soon(self._look, None)

    def _look(self, timeout: float | None) -> None:
        """Look at the machines before the loop sleeps."""
        if self.is_inherited:
            os.write(2, f"this child process is ended, since it goes on in its parent's event loop: {forked()}\n".encode())
            os._exit(1)
        if any(self._left):
            self._token.run_sync_soon(self.pump, idempotent=True)  # which ends this sleep at once

    def _is_ending(self) -> bool:
        """Whether a call of a transport was cancelled by us.

        On asyncio anybody's `Task.cancel` may end it, in spite of the shield, if the transport awaits something of its own. It
        has done nothing then, and is called again.
        """
        return self._scope.cancel_called or self._all_tasks is None or self._all_tasks.cancel_called

    @protected
    async def _receive(self, bus: Bus) -> None:
        while not bus.failed:
            try:
                received = await bus.receive()
            except self._loop.Cancelled:
                if self._is_ending():
                    raise
            except Exception as error:  # noqa: BLE001 - a transport of somebody else's may raise anything
                self._fail(bus, error, "receive")
            else:
                self._received += len(received)
                self._take_in(bus, received, self.now())

    @protected
    def _pushed(self, bus: Bus, frame: Frame, now: Time) -> None:
        if bus.failed:
            return
        self._received += 1
        bus.note(frame, now, is_sent=False)
        try:
            bus.network.receive(frame, now, now)
            self.pump(now)
        except Exception as error:  # noqa: BLE001 - as in `_turn`
            self._on_failure(None, error)

    def _take_in(self, bus: Bus, received: Sequence[Received | Report], now: Time) -> None:
        """Hand over all that came, and pump once."""
        left = iter(received)
        try:
            while True:
                try:
                    bus.take_in(left, now)
                    break
                except Exception as error:  # noqa: BLE001 - as in `_turn`, but the rest of the frames shall be heard
                    self._on_failure(None, error)
            self.pump(now)  # also where the frames have changed values only: what was commanded by hand before is taken up now
        except Exception as error:  # noqa: BLE001 - as in `_turn`
            self._on_failure(None, error)

    @protected
    async def _send(self, bus: Bus) -> None:
        while not bus.failed:
            frame = await bus.next_frame(self.now)
            try:
                await bus.transport.send(frame)
            except FrameNotSentError as refusal:
                self._turn(bus.drop, refusal.seen)
            except self._loop.Cancelled:
                if self._is_ending():
                    raise
                bus.put_back(frame)
            except Exception as error:  # noqa: BLE001 - as above
                self._fail(bus, error, f"send {frame}")
            else:
                bus.note(frame, self.now(), is_sent=True)
                if bus.is_dropping:
                    self._turn(bus.settle_not_sent)

    @protected
    async def _keep_time(self) -> None:
        with closing(best_alarm()) as self._alarm:
            while True:
                self._set_alarm()
                await self._alarm.wait()
                self._wake = NEVER
                now = self.now()
                late = now - self._next_deadline()
                if late >= 0:
                    if len(self._running) > 1:
                        late = now - min(each._next_deadline() for each in self._running)
                    self._turn(self._handle_timeouts, await self._take_in_before(now, late))

    async def _take_in_before(self, looked: Time, late: Time) -> Time:
        """Take in what has come, and return the time for which the timeouts may be handled: _STALL after the last look, at most.

        If it took longer, the process was stalled meanwhile, and has to look again. looked: the time now. late: of this process.
        """
        for _ in range(MAX_LOOKS):
            is_all = late <= _STALL
            for bus in self.buses:
                is_all = self._take_what_has_come(bus) and is_all
            if not is_all:
                await self._catch_up(self._quiet_ticks if late > _STALL else self._loop.rounds_to_hear)
            now = self.now()
            late, looked = now - looked, now
            if late <= _STALL:
                break
        return looked

    def _take_what_has_come(self, bus: Bus) -> bool:
        """Take in what a bus has brought so far, without waiting for its receiver; False if that may not have been all."""
        if bus.failed:
            return True
        try:
            received = bus.receive_nowait()
        except Exception as error:  # noqa: BLE001 - a transport of somebody else's may raise anything
            self._fail(bus, error, "receive")
            return True
        if received:
            self._received += len(received)
            self._take_in(bus, received, self.now())
        return received is not None and len(received) < MAX_BATCH

    async def _catch_up(self, ticks: int) -> None:
        """Let the receivers handle what is already there, until for so many rounds of the scheduler no frame has come."""
        enough = self._received + MAX_CATCH_UP
        while self._received < enough:
            received = self._received
            for _ in range(ticks):
                await self._loop.checkpoint()
            if received == self._received:
                return

    def _handle_timeouts(self, now: Time) -> None:
        """One instant for all buses: SYNCs that are due together go out together."""
        if self._before_timeouts is not None:
            self._before_timeouts(now)
        for bus in self.buses:
            bus.network.handle_timeout(now)

    def _set_alarm(self) -> None:
        """Wake the timekeeper in time. An earlier alarm is left alone: an early wake does no harm."""
        deadline = self._next_deadline()  # it also takes up what machines have announced
        if deadline < self._wake and self._alarm is not None:
            self._wake = deadline
            self._alarm.set(deadline / SECOND)

    def _turn(self, mutate: Callable[..., object], *args: object) -> None:
        """Call something that mutates machines, then pump."""
        try:
            mutate(*args)
            self.pump()
        except Exception as error:  # noqa: BLE001 - a bug in the core: it must reach the user, but the drives be halted before
            self._on_failure(None, error)

    def _fail(self, bus: Bus, error: Exception, doing: str) -> None:
        if bus.failed:
            return
        bus.fail()
        if not isinstance(error, TransportError):
            closed = isinstance(error, self._loop.ClosedResourceError)
            seen = "somebody has closed the transport" if closed else f"{type(error).__name__}: {error}"
            name = getattr(bus.transport, "locator", bus.name)
            cause, error = error, TransportError(BUS_LOST, name, f"cannot {doing} on {name}", seen=seen)
            error.__cause__ = cause
        self._on_failure(bus, error)


def _leave_to_parent() -> None:
    for each in tuple(_all):
        each.leave_to_parent()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_leave_to_parent)
