"""The longest time that a CAN frame may wait: the classic analysis, without a simulation.

R. I. Davis, A. Burns, R. J. Bril, J. J. Lukkien: "Controller Area Network (CAN) schedulability analysis: Refuted, revisited and
revised", Real-Time Systems 35 (2007), 239-272.

Each message m has a priority (its identifier), a period T (or a shortest distance), a queuing jitter J (how long after the start
of its period it may be queued) and a transmission time C with the most stuff bits and the intermission. A frame that is being
sent is not interrupted, so the longest frame of lower priority may just have begun: the blocking B. Then the priority level-m
busy period begins, and lasts (equation 8)

    t = B + sum over k of priority m or higher of ceil((t + J_k) / T_k) C_k

It may contain several instances of m, Q = ceil((t + J) / T); for the q-th of them (equations 11 and 12)

    w(q) = B + q C + sum over k of higher priority of ceil((w + J_k + bit) / T_k) C_k        R(q) = J + w(q) - q T + C

The largest of these is the response time: from the start of the period to the end of the intermission. (The receivers have the
frame 3 bits earlier.) The paper refuted the older analysis, which looked at q = 0 only: a frame may wait longest in its second
instance.

The analysis presumes that each member sends its most urgent frame first (see QueueOrder). For members that send in the order of
queuing (`queue` of a PeriodicMessage) the bound here is simpler than the published one (R. I. Davis, S. Kollmann, V. Pollex, F.
Slomka: "Schedulability analysis for CAN with FIFO queues", ECRTS 2011), and not below it. A frame is only as urgent as the
least urgent one of its queue, and waits for all frames of its queue. To other members it comes with the jitter that its own
queue gives it.

Errors: `error_interval` is the shortest time between two errors on the bus. Each error costs an error frame and a repetition of
the longest frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from canopen_proto.frame_bits import duration
from canopen_proto.machine import NEVER, LocalProtocolError, Time

MAX_INSTANCES: Final = 1_000
"""Instances of one message in one busy period: its next frame always waits already. A network that is meant to work has a few."""
MAX_ROUNDS: Final = 100
"""Rounds in which queues and response times may make each other longer, before the network counts as overloaded."""
ERROR_OVERHEAD: Final = 31
"""Bits of an error frame at worst: flag and echo 12, delimiter 8, intermission 3, suspend transmission 8."""


@dataclass(frozen=True, slots=True)
class PeriodicMessage:
    """A frame that is sent again and again.

    priority: the lower one goes first; two messages of one priority wait for each other. time: on the wire at worst, ns. period:
    ns, or the shortest distance of two frames. jitter: ns. deadline: ns, default: the period. queue: the name of its member's
    FIFO; None if the member sends its most urgent frame first.
    """

    name: str
    priority: int
    time: Time
    period: Time
    jitter: Time = 0
    deadline: Time | None = None
    queue: str | None = None

    def __post_init__(self) -> None:
        if self.time < 1 or self.period < 1 or self.jitter < 0:
            raise LocalProtocolError(f"message {self.name}: time and period must be at least 1 ns, and the jitter at least 0")

    @property
    def due(self) -> Time:
        """The deadline in ns."""
        return self.period if self.deadline is None else self.deadline


@dataclass(frozen=True, slots=True)
class ResponseTime:
    """The result for one message. worst: ns, NEVER if it grows without end. instance: which one waits longest, from 0. instances:
    how many lie in the longest busy period. blocking: by one frame of lower priority, ns."""

    message: PeriodicMessage
    worst: Time
    instance: int
    instances: int
    blocking: Time

    @property
    def fits(self) -> bool:
        """Whether the message always meets its deadline."""
        return self.worst <= self.message.due


def utilisation(messages: Sequence[PeriodicMessage]) -> float:
    """Return the part of the bus that the messages need at worst."""
    return sum(message.time / message.period for message in messages)


def response_times(messages: Sequence[PeriodicMessage], bitrate: int, *, error_interval: Time = NEVER) -> list[ResponseTime]:
    """Return the worst-case response time of each message, in the order given. bitrate: bit/s. error_interval:
    ns, least, between two bus errors; NEVER for none."""
    bit = duration(1, bitrate)
    seen = list(messages)  # as others see them: a queue makes its frames late
    for _ in range(MAX_ROUNDS):
        found = [_of_message(number, messages, seen, bit, error_interval) for number in range(len(messages))]
        late = [
            message if message.queue is None else replace(message, jitter=min(each.worst, NEVER) - message.time)
            for message, each in zip(messages, found, strict=True)
        ]
        if late == seen:
            return found
        if any(each.worst >= NEVER for each in found):
            break
        seen = late
    return [each if each.message.queue is None and _is_above_queues(each.message, messages) else _endless(each) for each in found]


def _is_above_queues(message: PeriodicMessage, messages: Sequence[PeriodicMessage]) -> bool:
    """Return whether this message is more urgent than all messages of queues, so that the queues do not delay it."""
    return all(other.queue is None or other.priority > message.priority for other in messages)


def _endless(response: ResponseTime) -> ResponseTime:
    return replace(response, worst=NEVER, instance=0, instances=0)


def _of_message(
    number: int, messages: Sequence[PeriodicMessage], seen: Sequence[PeriodicMessage], bit: Time, error_interval: Time
) -> ResponseTime:
    message = messages[number]
    others = [(other, late) for place, (other, late) in enumerate(zip(messages, seen, strict=True)) if place != number]
    mates = [other for other, _ in others if message.queue is not None and other.queue == message.queue]
    urgency = max([message.priority, *(mate.priority for mate in mates)])
    strangers = [late for other, late in others if message.queue is None or other.queue != message.queue]
    before = [*mates, *(other for other in strangers if other.priority <= urgency)]
    behind = [other.time for other in strangers if other.priority > urgency]
    blocking = max(behind, default=0)
    if error_interval < NEVER:
        again = max([message.time, blocking, *(other.time for other in before)])
        before.append(PeriodicMessage("errors", -1, ERROR_OVERHEAD * bit + again, error_interval))
    busy = NEVER
    if utilisation([message, *before]) < 1:
        longest = MAX_INSTANCES * message.period
        busy = _fixed_point(blocking + message.time, blocking, 0, [message, *before], longest)
    instances = -(-(busy + message.jitter) // message.period)
    if instances > MAX_INSTANCES:
        return ResponseTime(message, NEVER, 0, 0, blocking)
    worst = at = wait = 0
    for instance in range(instances):
        own = blocking + instance * message.time
        wait = _fixed_point(max(wait, own), own, bit, before, NEVER)
        response = message.jitter + wait - instance * message.period + message.time
        if response > worst:
            worst, at = response, instance
    return ResponseTime(message, worst, at, instances, blocking)


def _fixed_point(start: Time, own: Time, granularity: Time, messages: Sequence[PeriodicMessage], longest: Time) -> Time:
    """Return the smallest t >= `start` with t = own + the time that the messages need in t; NEVER if it is above `longest`."""
    time = start
    while time <= longest:
        needed = own + sum(-(-(time + each.jitter + granularity) // each.period) * each.time for each in messages)
        if needed <= time:
            return time
        time = needed
    return NEVER
