"""Heartbeat: a node reports its NMT state once per period; other nodes notice when it stops (CiA 301 v4.2.0, 7.2.8.3.2.2).

The producer sends one byte, its NMT state, on 0x700 + node-ID once per producer heartbeat time (0x1017, 0 = never). The same
CAN-ID carries the boot-up frame, the one byte 0, which the producer's NmtSlave sends.

`HeartbeatProducer` begins as 7.2.8.3.2.2 says. A time that is set while the node runs begins at once, with a frame. If the time
is not 0 when the node boots, the boot-up frame counts as the first heartbeat, and the next one follows a period later. A change
of state sends nothing by itself: the next heartbeat carries it.

`HeartbeatConsumer` listens to one node. With a consumer heartbeat time (0x1016) it also watches: from the first heartbeat on,
each one must follow within that time (7.5.2.19). A boot-up frame is not a heartbeat, so a node without a heartbeat can't be lost.

    not begun --heartbeat--> watching --time over: HeartbeatLost--> lost --heartbeat: HeartbeatRecovered--> watching

A boot-up frame does not change this state, but a watched node gets its full time again: it is alive, and its heartbeat time may
begin only now. A node that forgets its heartbeat time in the reset is lost one consumer time after its boot-up.

Every frame becomes an event of its own, in order, so a heartbeat right after a boot-up does not hide it.

A heartbeat that was waiting to be handled when its time ran out is in time: a driver that was stalled hands over the frames
first, then the time, so our own delay loses no node.

Left out: node guarding, which shares the CAN-ID but uses remote frames (guarding.py). The toggle bit of a guarding answer is
masked out here, so that a node that another master guards is still understood. The node of a device sends EMCY 0x8130 and reacts
to a lost heartbeat.

`OwnHeartbeat` is the heartbeat of a participant that is no device: a master whose drives watch over it (drives/axis/watchdog.py).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canopen_proto.frame import ERROR_CONTROL, Frame, RoutingKey, routing_key
from canopen_proto.machine import (
    MILLISECOND,
    NEVER,
    Event,
    FrameIgnored,
    LocalProtocolError,
    Machine,
    Outbox,
    Time,
    check_node_id,
)
from canopen_proto.nmt import STATE_OF_BYTE, NmtState

MIN_PERIOD: Final = MILLISECOND
"""The shortest heartbeat time: the unit of 0x1016 and 0x1017."""

_NO_DATA: Final = bytes(9)
"""The data of no frame: it has one byte too many."""


class HeartbeatsSkipped(Event):
    """Our producer was woken so late that it left out heartbeats. skipped: how many, 1 or more."""

    __slots__ = ("skipped",)
    __match_args__ = ("node_id", "skipped")

    def __init__(self, node_id: int, skipped: int) -> None:
        self.node_id = node_id
        self.skipped = skipped


class HeartbeatReceived(Event):
    """A heartbeat was received. timestamp: of the frame, from the transport. state: the node's NMT state, as it says."""

    __slots__ = ("state", "timestamp")
    __match_args__ = ("node_id", "state", "timestamp")
    is_usual = True

    def __init__(self, node_id: int, state: NmtState, timestamp: int | None) -> None:
        self.node_id = node_id
        self.state = state
        self.timestamp = timestamp


class NodeBooted(Event):
    """A boot-up frame was received: the node was reset or switched on, and is in PRE-OPERATIONAL now. timestamp: of the frame."""

    __slots__ = ("timestamp",)
    __match_args__ = ("node_id", "timestamp")

    def __init__(self, node_id: int, timestamp: int | None) -> None:
        self.node_id = node_id
        self.timestamp = timestamp


class NmtStateReported(Event):
    """A node's heartbeat or boot-up shows a state that is not the one known before. previous: None if none was known."""

    __slots__ = ("previous", "state")
    __match_args__ = ("node_id", "previous", "state")

    def __init__(self, node_id: int, previous: NmtState | None, state: NmtState) -> None:
        self.node_id = node_id
        self.previous = previous
        self.state = state


class HeartbeatLost(Event):
    """No heartbeat came within the consumer time. Reported once; HeartbeatRecovered follows with the next heartbeat.

    state: of the last heartbeat. last_heard: the time of the last frame; of the begin of the watch, if there was none. timeout:
    the consumer time, ns.
    """

    __slots__ = ("last_heard", "state", "timeout")
    __match_args__ = ("node_id", "state", "last_heard", "timeout")

    def __init__(self, node_id: int, state: NmtState | None, last_heard: Time, timeout: Time) -> None:
        self.node_id = node_id
        self.state = state
        self.last_heard = last_heard
        self.timeout = timeout


class HeartbeatRecovered(Event):
    """A lost node's heartbeat is back (the HeartbeatReceived before this one). state: the node's NMT state, as it says."""

    __slots__ = ("state",)
    __match_args__ = ("node_id", "state")

    def __init__(self, node_id: int, state: NmtState) -> None:
        self.node_id = node_id
        self.state = state


class ForeignHeartbeat(Event):
    """Another node uses the node-ID of our own heartbeat. A node that watches this ID will not notice when we are gone. Reported
    once in each run of our heartbeat. state: of the other node; None for a boot-up frame."""

    __slots__ = ("state",)
    __match_args__ = ("node_id", "state")

    def __init__(self, node_id: int, state: NmtState | None) -> None:
        self.node_id = node_id
        self.state = state


def _check_time(name: str, value: Time) -> Time:
    if value != 0 and value < MIN_PERIOD:
        raise LocalProtocolError(f"{name} is {value} ns; it must be 0 (off), or 1 ms or more")
    return value


class HeartbeatProducer(Machine):
    """Sends a node's heartbeat: once per period, in every state but INITIALISING.

    period: ns; 0 = off. state: shown by the next heartbeat. Both are read-only.
    """

    __slots__ = ("node_id", "period", "state")

    def __init__(self, out: Outbox, node_id: int) -> None:
        """node_id: 1..127, else LocalProtocolError. The state is INITIALISING, the period 0."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.period: Time = 0
        self.state = NmtState.INITIALISING

    def set_period(self, period: Time, now: Time) -> None:
        """Set the producer heartbeat time: 0 stops; 1 ms or more begins at once, with a frame, unless the node is INITIALISING.
        period: ns.

        Raises LocalProtocolError for other values. CiA 301 v4.2.0, 7.2.8.3.2.2 and 7.5.2.20
        """
        self.period = _check_time("the producer heartbeat time", period)
        if period == 0:
            self._arm(NEVER)
        elif self.state is not NmtState.INITIALISING:
            self._send()
            self._arm(now + period)

    def set_state(self, state: NmtState, now: Time) -> None:
        """Set the node's NMT state, which the next heartbeat shows.

        Leaving INITIALISING starts the period without a frame: the boot-up frame is the first heartbeat. Entering it stops.
        CiA 301 v4.2.0, 7.2.8.3.2.2
        """
        previous, self.state = self.state, state
        if state is NmtState.INITIALISING:
            self._arm(NEVER)
        elif previous is NmtState.INITIALISING and self.period:
            self._arm(now + self.period)

    def handle_timeout(self, now: Time) -> None:
        """Send the due heartbeat. If it is late by whole periods: send one, keep the phase, report HeartbeatsSkipped."""
        if now < self.deadline:
            return
        self._send()
        skipped = (now - self.deadline) // self.period
        self._arm(self.deadline + (skipped + 1) * self.period)
        if skipped:
            self.out.events.append(HeartbeatsSkipped(self.node_id, skipped))

    def _send(self) -> None:
        self.out.frames.append(Frame(ERROR_CONTROL + self.node_id, bytes((self.state,))))


class OwnHeartbeat(HeartbeatProducer):
    """The heartbeat of a participant that is no device, such as a master. Reports another node with the same node-ID.

    It shows OPERATIONAL, and sends no boot-up frame.
    """

    __slots__ = ("_told",)

    def __init__(self, out: Outbox, node_id: int) -> None:
        """node_id: 1..127, else LocalProtocolError. It sends nothing before `start`."""
        super().__init__(out, node_id)
        self.state = NmtState.OPERATIONAL
        self._told = False

    def can_ids(self) -> Iterable[RoutingKey]:
        return (routing_key(ERROR_CONTROL + self.node_id),)

    def start(self, period: Time, now: Time) -> None:
        """Send a heartbeat now, then once per period (ns). Does nothing if it already runs with this period."""
        if period != self.period:
            self._told = False
            self.set_period(period, now)

    def stop(self, now: Time) -> None:
        """Stop sending."""
        self.set_period(0, now)

    def receive(self, frame: Frame, now: Time) -> None:
        """Take another node's frame with our node-ID. Event: ForeignHeartbeat, once, while ours is sent."""
        data = frame.data
        if self.period and not self._told and len(data) == 1:
            self._told = True
            state = STATE_OF_BYTE[data[0]]
            told = None if state is NmtState.INITIALISING else state
            self.out.events.append(ForeignHeartbeat(self.node_id, told))


class HeartbeatConsumer(Machine):
    """Receives one node's boot-up frames and heartbeats, and notices when they stop.

    state: the node's NMT state in the last frame, PRE_OPERATIONAL after a boot-up frame (7.2.8.3.3); None before the first frame,
    and from HeartbeatLost to the next frame. last_heard: when the last frame came, on the driver's clock, or None. lost:
    HeartbeatLost was reported, and no heartbeat came since. timeout: ns; 0 = listen only. usual: the data of a heartbeat that
    would change nothing of this but the time: the last one's, unless a boot-up or a loss came since; else what no frame has.
    told: what is reported of such a one without a time stamp. All are read-only.
    """

    __slots__ = ("_begun", "last_heard", "lost", "node_id", "state", "timeout", "told", "usual")

    def __init__(self, out: Outbox, node_id: int, timeout: Time = 0) -> None:
        """node_id: 1..127. timeout: as in `set_timeout`. Raises LocalProtocolError for other values."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.timeout = _check_time("the consumer heartbeat time", timeout)
        self.state: NmtState | None = None
        self.last_heard: Time | None = None
        self.lost = False
        self.usual = _NO_DATA
        self.told = HeartbeatReceived(node_id, NmtState.INITIALISING, None)
        self._begun = False  # a heartbeat was heard: monitoring has begun

    def can_ids(self) -> Iterable[RoutingKey]:
        return (routing_key(ERROR_CONTROL + self.node_id),)

    def set_timeout(self, timeout: Time, now: Time, *, begun: bool = False) -> None:
        """Set the consumer heartbeat time, in ns: 0 = listen only; else 1 ms or more.

        The watch starts now if a heartbeat came before, else with the first one. begun: it starts now in any case, since the node
        is known to send heartbeats (its 0x1017). A lost node stays lost until its next heartbeat, or until 0 is set. Raises
        LocalProtocolError for other values. CiA 301 v4.2.0, 7.5.2.19
        """
        self.timeout = _check_time("the consumer heartbeat time", timeout)
        self._begun = self._begun or (begun and timeout > 0)
        if timeout == 0:
            self.lost = False
            self._arm(NEVER)
        elif self._begun and not self.lost:
            self._arm(now + timeout)

    def receive(self, frame: Frame, now: Time) -> None:
        """Take a boot-up frame or a heartbeat.

        Events, in this order: NodeBooted or HeartbeatReceived; HeartbeatRecovered if it was lost; NmtStateReported if the
        state is a new one. A frame that is not one byte long, or has no valid state, is FrameIgnored and no sign of life.
        CiA 301 v4.2.0, 7.2.8.3.2.2 and 7.2.8.3.3
        """
        data, out = frame.data, self.out
        if data == self.usual:
            timestamp, told = out.root.timestamp, self.told  # without one the same is told again: an event never changes
            out.events.append(told if timestamp is None else HeartbeatReceived(self.node_id, told.state, timestamp))
        elif not self._receive_unusual(data, frame, now):
            return
        self.last_heard = now
        timeout = self.timeout
        if timeout:
            self.deadline = deadline = now + timeout
            if deadline < self._wake:  # rare: a deadline that moves later need not be announced
                self._arm(deadline)

    def _receive_unusual(self, data: bytes, frame: Frame, now: Time) -> bool:
        """Take any frame but a heartbeat with the data in `usual`. Returns False if it is no heartbeat."""
        events = self.out.events
        if len(data) != 1:
            events.append(FrameIgnored(self.node_id, frame, f"a heartbeat has 1 byte, not {len(data)}"))
            return False
        state = STATE_OF_BYTE[data[0]]
        if state is None:
            events.append(FrameIgnored(self.node_id, frame, f"0x{data[0]:02X} is not an NMT state"))
            return False
        if not state:
            self._on_boot_up(now)
            return False
        events.append(HeartbeatReceived(self.node_id, state, self.out.root.timestamp))
        if self.lost:
            self.lost = False
            events.append(HeartbeatRecovered(self.node_id, state))
        self._begun = True
        if state is not self.state:
            events.append(NmtStateReported(self.node_id, self.state, state))
            self.state = state
        self.usual = data
        if state is not self.told.state:
            self.told = HeartbeatReceived(self.node_id, state, None)
        return True

    def _on_boot_up(self, now: Time) -> None:
        self.last_heard = now
        self.usual = _NO_DATA
        self.out.events.append(NodeBooted(self.node_id, self.out.timestamp))
        if self.timeout and self._begun and not self.lost:
            self._arm(now + self.timeout)
        if self.state is not NmtState.PRE_OPERATIONAL:
            self.out.events.append(NmtStateReported(self.node_id, self.state, NmtState.PRE_OPERATIONAL))
            self.state = NmtState.PRE_OPERATIONAL

    def handle_timeout(self, now: Time) -> None:
        """Report HeartbeatLost, once, when the consumer time is over."""
        if now < self.deadline:
            return
        self._arm(NEVER)
        last_heard = now - self.timeout if self.last_heard is None else self.last_heard
        self.out.events.append(HeartbeatLost(self.node_id, self.state, last_heard, self.timeout))
        self.lost = True
        self.state = None
        self.usual = _NO_DATA
