"""Look whether PDOs come when their communication parameters say, by listening only.

Only parameters that the recording has shown count: a device may hold others than its file says. A frame may wait for the bus, and
a node may be busy. So only a PDO within less than half of its inhibit time, later than one and a half times its event timer, or
missing at a SYNC and at the next one, is a fault; the last two of a node that says it is operational.

Source: CiA 301 v4.2.0, 7.2.2, 7.5.2.35, 7.5.2.37.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from canopen_proto.dictionary import Direction
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.observer.finding import INHIBIT_UNIT, Finding, ms_text
from canopen_proto.pdo.settings import EVENT_TIMER, INHIBIT_TIME, TRANSMISSION_TYPE, place_of

MAX_CYCLIC: Final = 240
"""The largest transmission type of synchronous PDOs: each 240th SYNC. 0: at a SYNC, but not at each one."""
EVENT_DRIVEN: Final = 254
"""The first transmission type of PDOs that an event sends, or the event timer."""


class _Timing:
    """One PDO: its parameters, and when it came. kind: the transmission type, -1 if it is not known. Times: ns, 0 for none."""

    __slots__ = ("at_sync", "deadline", "event_timer", "inhibit", "is_sent", "kind", "last", "name", "node_id")

    def __init__(self, node_id: int, name: str, is_sent: bool) -> None:
        self.node_id = node_id
        self.name = name
        self.is_sent = is_sent  # by the node; others are sent to it
        self.kind = -1
        self.inhibit: Time = 0
        self.event_timer: Time = 0
        self.forget()

    def forget(self) -> None:
        """Begin again: what has come so far says nothing about the next one."""
        self.last: Time = -NEVER
        self.at_sync = -1  # the number of the last SYNC when it came
        self.deadline: Time = NEVER


class PdoRules:
    """See this module's text. is_operational: whether a node has said that it is operational.

    deadline: the time at which a PDO is late for its event timer; NEVER if none can be.
    """

    __slots__ = ("_cyclic", "_is_operational", "_syncs", "_timings", "deadline")

    def __init__(self, is_operational: Callable[[int], bool]) -> None:
        self._is_operational = is_operational
        self._timings: dict[tuple[int, str], _Timing] = {}  # by node and name: "TPDO 1"
        self._cyclic: list[_Timing] = []  # those that a node sends at each SYNC, or at each nth
        self._syncs = 0
        self.deadline: Time = NEVER

    def settle(self, node_id: int, index: int, subindex: int, value: int) -> None:
        """Take note of a parameter that a node holds. Other objects do nothing."""
        place = place_of(index)
        if place is None or place.is_mapping or subindex > EVENT_TIMER:
            return
        name = f"{place.direction} {place.number}"
        timing = self._timings.get((node_id, name))
        if timing is None:
            timing = self._timings[node_id, name] = _Timing(node_id, name, place.direction is Direction.TPDO)
        timing.forget()
        if subindex == TRANSMISSION_TYPE:
            timing.kind = value
            self._choose()
        elif subindex == INHIBIT_TIME:
            timing.inhibit = value * INHIBIT_UNIT
        elif subindex == EVENT_TIMER:
            timing.event_timer = value * MILLISECOND

    def booted(self, node_id: int) -> None:
        """Take note of a boot-up: the node has its power-on values again, which are not known."""
        for key in [key for key in self._timings if key[0] == node_id]:
            del self._timings[key]
        self._choose()

    def commanded(self, node_id: int) -> None:
        """Take note of an NMT command to a node, 0 for all: it may stop its PDOs, or begin with them."""
        for timing in self._timings.values():
            if node_id in (0, timing.node_id):
                timing.forget()

    def came(self, node_id: int, name: str, now: Time, found: list[Finding]) -> None:
        """Take note of a PDO. found: takes what is wrong with its time."""
        timing = self._timings.get((node_id, name)) if self._timings else None
        if timing is None:
            return
        if timing.is_sent and (now - timing.last) * 2 < timing.inhibit:
            text = f"{name} {ms_text(now - timing.last)} behind the last one; its inhibit time is {ms_text(timing.inhibit)}"
            found.append(Finding("inhibit time", node_id, text))
        if timing.is_sent and 0 <= timing.kind <= MAX_CYCLIC and timing.at_sync == self._syncs > 0:
            found.append(Finding("synchronous pdo", node_id, f"{name} comes a second time behind one SYNC"))
        timing.last, timing.at_sync = now, self._syncs
        if timing.event_timer and timing.kind >= EVENT_DRIVEN:
            timing.deadline = now + timing.event_timer * 3 // 2
            self.deadline = min(self.deadline, timing.deadline)

    def sync(self, found: list[Finding]) -> None:
        """Take note of a SYNC. found: takes the PDOs that were due behind the last two of theirs; each one once."""
        self._syncs += 1
        for timing in self._cyclic:
            if 0 <= timing.at_sync < self._syncs - timing.kind - 1:
                timing.at_sync = -1
                if self._is_operational(timing.node_id):
                    text = f"{timing.name} does not come, at a SYNC and at the next one; its transmission type is {timing.kind}"
                    found.append(Finding("late pdo", timing.node_id, text))

    def overdue(self, now: Time) -> list[Finding]:
        """Return the PDOs that are later than their event timers allow; each one once."""
        found = []
        for timing in self._timings.values():
            if timing.deadline <= now:
                timing.deadline = NEVER
                if self._is_operational(timing.node_id):
                    text = f"{timing.name} does not come; its event timer is {ms_text(timing.event_timer)}"
                    found.append(Finding("late pdo", timing.node_id, text))
        self.deadline = min((timing.deadline for timing in self._timings.values()), default=NEVER)
        return found

    def _choose(self) -> None:
        self._cyclic = [each for each in self._timings.values() if each.is_sent and 0 < each.kind <= MAX_CYCLIC]
