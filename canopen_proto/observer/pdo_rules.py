"""Look whether PDOs come when their communication parameters say, by listening only.

Only parameters that the recording has shown count: a device may hold others than its file says. A frame may wait for the bus,
and a node may be busy. So only PDOs that come three times in a row within less than half of their inhibit time, later than one
and a half times its event timer, or missing at a SYNC and at the next one, is a fault; the last two of a node that says it is
operational.

Source: CiA 301 v4.2.0, 7.2.2, 7.5.2.35, 7.5.2.37.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from canopen_proto.dictionary import Direction
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.observer.finding import BusFinding, Gaps, ms_text
from canopen_proto.pdo.settings import EVENT_TIMER, INHIBIT_TIME, INHIBIT_UNIT, TRANSMISSION_TYPE, place_of

MAX_CYCLIC: Final = 240
"""The largest transmission type of synchronous PDOs: each 240th SYNC. 0: at a SYNC, but not at each one."""
EVENT_DRIVEN: Final = 254
"""The first transmission type of PDOs that an event sends, or the event timer."""

EARLY: Final = 3
"""So often in a row a PDO comes too soon until that is told: a frame may wait for the bus, and the next one not."""
_TWICE: Final = 5
"""So often in a row a PDO comes twice behind one SYNC until that is told: a SYNC may be missing, and a PDO late."""
BURST: Final = 2 * MILLISECOND
"""What comes closer together may have been held back, and be handed over at once."""


class _Timing:
    """One PDO: its parameters, and when it came. kind: the transmission type, -1 if it is not known. Times: ns, 0 for none."""

    __slots__ = (
        "at_sync", "data", "deadline", "early", "event_timer", "extra", "inhibit", "is_sent", "kind", "last", "name",
        "node_id", "twice_at",
    )  # fmt: skip

    def __init__(self, node_id: int, name: str, is_sent: bool) -> None:
        self.node_id = node_id
        self.name = name
        self.is_sent = is_sent  # by the node; others are sent to it
        self.kind = -1
        self.inhibit: Time = 0
        self.event_timer: Time = 0
        self.data = b""  # of the last one
        self.forget()

    def forget(self) -> None:
        """Begin again: what has come so far says nothing about the next one."""
        self.last: Time = -NEVER
        self.at_sync = -1  # the number of the last SYNC when it came
        self.deadline: Time = NEVER
        self.early = 0  # in a row, that came too soon
        self.extra = 0  # in a row, that came a second time behind one SYNC
        self.twice_at = -1  # the number of the last SYNC when it came a second time


class PdoTimings:
    """See this module's text. is_operational: whether a node has said that it is operational.

    deadline: the time at which a PDO is late for its event timer; NEVER if none can be.
    """

    def __init__(self, is_operational: Callable[[int], bool], gaps: Gaps) -> None:
        self._gaps = gaps
        self._sync_at: Time = -NEVER  # the last SYNC
        self._cycle: Time = NEVER  # the least time between two of them
        self._is_operational = is_operational
        self._timings: dict[tuple[int, str], _Timing] = {}  # by node and name: "TPDO 1"
        self._cyclic: list[_Timing] = []  # those that a node sends at each SYNC, or at each nth
        self._syncs = 0
        self.deadline: Time = NEVER

    def settle(self, node_id: int, index: int, subindex: int, value: int) -> None:
        """Take note of a parameter that a node holds. Does nothing for other objects."""
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

    def came(self, node_id: int, name: str, data: bytes, now: Time, found: list[BusFinding]) -> None:
        """Take note of a PDO. found: takes what is wrong with its time."""
        timing = self._timings.get((node_id, name)) if self._timings else None
        if timing is None:
            return
        interval = now - timing.last
        if timing.is_sent and interval * 2 < timing.inhibit:
            timing.early = timing.early + 1 if interval > BURST else 0
            if timing.early == EARLY:
                text = f"{name} {ms_text(interval)} behind the last one; its inhibit time is {ms_text(timing.inhibit)}"
                found.append(BusFinding("inhibit time", node_id, text))
        else:
            timing.early = 0
        if timing.is_sent and 0 <= timing.kind <= MAX_CYCLIC:
            if timing.at_sync == self._syncs > 0:
                self._twice(timing, data, interval, now, found)
            elif timing.twice_at != timing.at_sync:
                timing.extra = 0
        timing.last, timing.at_sync, timing.data = now, self._syncs, data
        if timing.event_timer and timing.kind >= EVENT_DRIVEN:
            timing.deadline = now + timing.event_timer * 3 // 2
            self.deadline = min(self.deadline, timing.deadline)

    def _twice(self, timing: _Timing, data: bytes, interval: Time, now: Time, found: list[BusFinding]) -> None:
        """A PDO comes a second time behind one SYNC. A SYNC may be missing between the two, if that was long enough."""
        text = f"{timing.name} comes a second time behind one SYNC"
        if data == timing.data:
            self._gaps.copied(timing.node_id, text, now, found)
        elif self._cycle == NEVER or interval * 2 >= self._cycle:
            self._gaps.missing(timing.node_id, text, now, found)
        else:
            timing.extra += timing.twice_at != self._syncs
            timing.twice_at = self._syncs
            if timing.extra == _TWICE:
                timing.extra = 0
                found.append(BusFinding("synchronous pdo", timing.node_id, f"{text}, {_TWICE} times in a row"))

    def sync(self, now: Time, found: list[BusFinding]) -> None:
        """Take note of a SYNC. found: takes the PDOs that were due behind the last two of theirs; each one once."""
        self._syncs += 1
        self._cycle = min(self._cycle, now - self._sync_at)
        self._sync_at = now
        for timing in self._cyclic:
            if 0 <= timing.at_sync < self._syncs - timing.kind - 1:
                timing.at_sync = -1
                if self._is_operational(timing.node_id):
                    text = f"{timing.name} does not come, at a SYNC and at the next one; its transmission type is {timing.kind}"
                    found.append(BusFinding("late pdo", timing.node_id, text, is_certain=False))

    def silent_in_pause(self, now: Time) -> set[int]:
        """Return the nodes whose PDOs have become late since the last frame of the bus."""
        return {each.node_id for each in self._timings.values() if each.deadline <= now}

    def lost(self) -> None:
        """Take note that frames were not heard: a PDO or a SYNC that is missing may be one of them."""
        for timing in self._timings.values():
            timing.forget()
        self.deadline = NEVER

    def overdue(self, now: Time) -> list[BusFinding]:
        """Return the PDOs that are later than their event timers allow; each one once."""
        found = []
        for timing in self._timings.values():
            if timing.deadline <= now:
                timing.deadline = NEVER
                if self._is_operational(timing.node_id):
                    text = f"{timing.name} does not come; its event timer is {ms_text(timing.event_timer)}"
                    found.append(BusFinding("late pdo", timing.node_id, text, is_certain=False))
        self.deadline = min((timing.deadline for timing in self._timings.values()), default=NEVER)
        return found

    def _choose(self) -> None:
        self._cyclic = [each for each in self._timings.values() if each.is_sent and 0 < each.kind <= MAX_CYCLIC]
