"""Node guarding and life guarding: the NMT master sends requests to each node, and each side notices when the other falls silent
(CiA 301 v4.2.0, 7.2.8.3.2.1).

Once per guard time the master sends a remote frame on 0x700 + node-ID. The node answers on that CAN-ID with one byte: its NMT
state in bits 0 to 6, and in bit 7 a toggle bit, 0 in the first answer and then changing each time. Both sides use the node life
time, which is guard time * life time factor:

    master   `GuardingMaster`   a request that is not answered within the node life time: NodeGuardingLost
    slave    `GuardingSlave`    no request for that long: LifeGuardingLost. It begins with the first request. Without a guard
                                time (0x100C) or life time factor (0x100D) the slave only answers

    not begun --request--> watched --life time over: LifeGuardingLost--> lost --request: LifeGuardingRecovered--> watched

An answer with the same toggle bit as the one before is handled as if it had not come, and reported by `GuardingToggleRepeated`.
So one lost answer counts as two: the next one looks like a repetition. The first answer that a master hears may have either
toggle bit, since another master may have asked before. After a boot-up frame it must be 0: only a boot-up resets it.

A node has either guarding or a heartbeat: while its producer heartbeat time (0x1017) is not 0, it does not answer; its owner
calls `set_enabled`. Heartbeats need no remote frames and are the better choice (CiA 301 recommends them). Guarding is here for
devices that have nothing else, and for masters that insist on it.

Answers and heartbeats share a CAN-ID: a `HeartbeatConsumer` beside a `GuardingMaster` hears the answers as signs of life too.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from canopen_proto.frame import ERROR_CONTROL, REMOTE, Frame, RoutingKey, routing_key
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

TOGGLE: Final = 0x80
MIN_GUARD_TIME: Final = MILLISECOND
"""The unit of 0x100C."""
MAX_LIFE_TIME_FACTOR: Final = 255
"""0x100D is an UNSIGNED8."""


class GuardingAnswered(Event):
    """A node answered a guarding request. timestamp: the transport's, if it has one. state: the node's NMT state, as it says."""

    __match_args__ = ("node_id", "state", "timestamp")

    def __init__(self, node_id: int, state: NmtState, timestamp: int | None) -> None:
        self.node_id = node_id
        self.state = state
        self.timestamp = timestamp


class GuardingToggleRepeated(FrameIgnored):
    """An answer with the same toggle bit as the one before; it counts as not received."""


class GuardingRequestsSkipped(Event):
    """The master was woken so late that it left out requests. skipped: their number, 1 or more."""

    __match_args__ = ("node_id", "skipped")

    def __init__(self, node_id: int, skipped: int) -> None:
        self.node_id = node_id
        self.skipped = skipped


class GuardingStateUnexpected(Event):
    """A node answered with an unexpected NMT state. Reported once for each such state. state: what it answered. expected: what it
    should be in.

    Together with NodeGuardingLost this is the "node guarding event". CiA 301 v4.2.0, 7.2.8.2.2.1
    """

    __match_args__ = ("node_id", "state", "expected")

    def __init__(self, node_id: int, state: NmtState, expected: NmtState) -> None:
        self.node_id = node_id
        self.state = state
        self.expected = expected


class NodeGuardingLost(Event):
    """A node did not answer within the node life time. Reported once; NodeGuardingRecovered follows with its next answer.

    state: of its last answer, None if it never answered. life_time: ns.
    """

    __match_args__ = ("node_id", "state", "life_time")

    def __init__(self, node_id: int, state: NmtState | None, life_time: Time) -> None:
        self.node_id = node_id
        self.state = state
        self.life_time = life_time


class NodeGuardingRecovered(Event):
    """A lost node answered (the GuardingAnswered before this one). state: the node's NMT state, as it says."""

    __match_args__ = ("node_id", "state")

    def __init__(self, node_id: int, state: NmtState) -> None:
        self.node_id = node_id
        self.state = state


class LifeGuardingLost(Event):
    """Our own slave got no request within its node life time. Once; LifeGuardingRecovered follows with the next request.
    life_time: ns."""

    __match_args__ = ("node_id", "life_time")

    def __init__(self, node_id: int, life_time: Time) -> None:
        self.node_id = node_id
        self.life_time = life_time


class LifeGuardingRecovered(Event):
    """Our own slave gets requests again."""


class GuardingMaster(Machine):
    """The master's side of guarding, for one node.

    guard_time, life_time: ns, 0 while stopped. state: of the node's last answer, or None. expected: the NMT state that the node
    should have, None for any. lost: NodeGuardingLost was reported, and no answer came since. All read-only outside.
    """

    def __init__(self, out: Outbox, node_id: int) -> None:
        """Make a master that asks nothing before `start`. node_id: 1..127, else LocalProtocolError."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.guard_time: Time = 0
        self.life_time: Time = 0
        self.state: NmtState | None = None
        self.expected: NmtState | None = None
        self.lost = False
        self._reported: NmtState | None = None  # the unexpected state that was reported last, if it is one still
        self._toggle: int | None = None  # of the next answer; None: either
        self._next_request: Time = NEVER
        self._unanswered_since: Time = NEVER  # when the oldest request was sent that waits for an answer

    def can_ids(self) -> Iterable[RoutingKey]:
        return (routing_key(ERROR_CONTROL + self.node_id),)

    def start(self, guard_time: Time, life_time_factor: int, now: Time) -> None:
        """Ask now, and then once per guard time (ns, 1 ms or more); a master that already asks starts again.

        life_time_factor: 1..255. Events: GuardingAnswered with each answer; NodeGuardingLost, NodeGuardingRecovered. Raises
        LocalProtocolError for other values. CiA 301 v4.2.0, 7.2.8.3.2.1
        """
        if guard_time < MIN_GUARD_TIME:
            raise LocalProtocolError(f"a guard time is 1 ms or more, not {guard_time} ns; stop() ends guarding")
        if not 1 <= life_time_factor <= MAX_LIFE_TIME_FACTOR:
            raise LocalProtocolError(f"a life time factor is 1 to {MAX_LIFE_TIME_FACTOR}, not {life_time_factor}")
        self.guard_time = guard_time
        self.life_time = guard_time * life_time_factor
        self.lost = False
        self._toggle = None
        self._unanswered_since = NEVER
        self._request(now)
        self._next_request = now + guard_time
        self._rearm()

    def stop(self) -> None:
        """Stop asking."""
        self.guard_time = self.life_time = 0
        self.lost = False
        self._next_request = self._unanswered_since = NEVER
        self._rearm()

    def expect(self, state: NmtState | None) -> None:
        """Say which NMT state the node should have, None for any. Another one is reported: GuardingStateUnexpected."""
        self.expected = state
        self._reported = None

    def receive(self, frame: Frame, now: Time) -> None:
        """Take an answer. Events, in this order: GuardingAnswered; NodeGuardingRecovered; GuardingStateUnexpected.

        Else GuardingToggleRepeated, or FrameIgnored if it is not an answer. A boot-up frame is not an answer: the toggle bit
        starts from 0 again, and earlier requests no longer count. While stopped nothing is taken. CiA 301 v4.2.0, 7.2.8.3.2.1
        """
        if not self.guard_time:
            return
        data, out = frame.data, self.out
        if len(data) != 1:
            out.events.append(FrameIgnored(self.node_id, frame, f"a guarding answer has 1 byte, not {len(data)}"))
            return
        if data[0] == 0:
            self._toggle = 0
            self._unanswered_since = NEVER
            self._rearm()
            return
        state, toggle = STATE_OF_BYTE[data[0]], data[0] & TOGGLE
        if state is None or state is NmtState.INITIALISING:
            out.events.append(FrameIgnored(self.node_id, frame, f"0x{data[0]:02X} is not an NMT state"))
            return
        if self._toggle is not None and toggle != self._toggle:
            out.events.append(GuardingToggleRepeated(self.node_id, frame, "the toggle bit of the answer before"))
            return
        self._toggle = toggle ^ TOGGLE
        self._unanswered_since = NEVER
        self._rearm()
        out.events.append(GuardingAnswered(self.node_id, state, out.timestamp))
        if self.lost:
            self.lost = False
            out.events.append(NodeGuardingRecovered(self.node_id, state))
        self.state = state
        if self.expected is None or state is self.expected:
            self._reported = None
        elif state is not self._reported:
            self._reported = state
            out.events.append(GuardingStateUnexpected(self.node_id, state, self.expected))

    def handle_timeout(self, now: Time) -> None:
        """Report NodeGuardingLost, once, and send the due request: only one, however late (GuardingRequestsSkipped)."""
        if now < self.deadline:
            return
        if now >= self._unanswered_since + self.life_time:
            self._unanswered_since = NEVER  # not again until it answers: the loss is reported once
            self.lost = True
            self.out.events.append(NodeGuardingLost(self.node_id, self.state, self.life_time))
        if now >= self._next_request:
            skipped = (now - self._next_request) // self.guard_time
            self._request(now)
            self._next_request += (skipped + 1) * self.guard_time
            if skipped:
                self.out.events.append(GuardingRequestsSkipped(self.node_id, skipped))
        self._rearm()

    def _request(self, now: Time) -> None:
        self.out.frames.append(Frame(ERROR_CONTROL + self.node_id, b"", REMOTE, 1))
        if not self.lost:
            self._unanswered_since = min(self._unanswered_since, now)

    def _rearm(self) -> None:
        self._arm(min(self._next_request, self._unanswered_since + self.life_time, NEVER))


class GuardingSlave(Machine):
    """Answers a master's guarding requests for our own node, and notices when they stop.

    life_time: ns; 0: not watched. state: the NMT state for the answer. lost: LifeGuardingLost was reported, and no request came
    since. enabled: whether guarding is used. All read-only outside.
    """

    def __init__(self, out: Outbox, node_id: int) -> None:
        """Make a slave in INITIALISING, with life time 0, not enabled. node_id: 1..127, else LocalProtocolError."""
        super().__init__(out)
        self.node_id = check_node_id(node_id)
        self.enabled = False
        self.life_time: Time = 0
        self.state = NmtState.INITIALISING
        self.lost = False
        self._begun = False  # a request came: life guarding has begun
        self._toggle = 0

    def can_ids(self) -> Iterable[RoutingKey]:
        return (routing_key(ERROR_CONTROL + self.node_id, REMOTE),) if self.enabled else ()

    def set_node_id(self, node_id: int) -> None:
        """Answer for another node-ID from now on (LSS)."""
        self.node_id = node_id
        self._reroute()

    def set_enabled(self, enabled: bool) -> None:
        """Say whether the node uses guarding: not while it has a producer heartbeat time. CiA 301 v4.2.0, 7.2.8.3.2"""
        if enabled != self.enabled:
            self.enabled = enabled
            self._forget()
            self._reroute()

    def set_life_time(self, life_time: Time, now: Time) -> None:
        """Set the node life time: guard time * life time factor, in ns; 0: do not watch. LocalProtocolError if it is negative.

        The watch starts now if a request was received before, else with the first one. A lost slave stays lost until the next
        request, or until 0 is set. CiA 301 v4.2.0, 7.5.2.11 and 7.5.2.12
        """
        if life_time < 0:
            raise LocalProtocolError(f"the node life time is {life_time} ns, less than 0")
        self.life_time = life_time
        if life_time == 0:
            self.lost = False
            self._arm(NEVER)
        elif self._begun and not self.lost:
            self._arm(now + life_time)

    def set_state(self, state: NmtState) -> None:
        """Set the node's NMT state. In INITIALISING it does not answer, and toggle bit and life guarding start again."""
        self.state = state
        if state is NmtState.INITIALISING:
            self._forget()

    def receive(self, frame: Frame, now: Time) -> None:
        """Answer a request. Event: LifeGuardingRecovered if it was lost. CiA 301 v4.2.0, 7.2.8.3.2.1"""
        if not self.enabled or self.state is NmtState.INITIALISING:
            return
        self.out.frames.append(Frame(ERROR_CONTROL + self.node_id, bytes((self.state | self._toggle,))))
        self._toggle ^= TOGGLE
        self._begun = True
        if self.life_time:
            self._arm(now + self.life_time)
        if self.lost:
            self.lost = False
            self.out.events.append(LifeGuardingRecovered(self.node_id))

    def handle_timeout(self, now: Time) -> None:
        """Report LifeGuardingLost, once, when the node life time is over."""
        if now < self.deadline:
            return
        self._arm(NEVER)
        self.lost = True
        self.out.events.append(LifeGuardingLost(self.node_id, self.life_time))

    def _forget(self) -> None:
        self._toggle = 0
        self._begun = False
        self.lost = False
        self._arm(NEVER)
