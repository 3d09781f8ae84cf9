"""Look whether the nodes of a bus keep to the rules of network management, by listening only: states and heartbeats.

The state of a node is the one that its last heartbeat, or guarding answer, has told. An NMT command counts as well, once the node
had the time to obey. A PDO or SDO that the state does not allow is a fault only if the next heartbeat tells the same state. Else
the recording may lack a command. Behind a boot-up the state is not known: the node may start by itself (0x1F80, CiA 302-2).

Two nodes with one ID: their heartbeats tell two states in turn. A state that changes, back, and again, without an NMT command or
a boot-up, is that; a single change is a device that changes its state by itself (CiA 301 v4.2.0, 7.3.2.2). Or heartbeats come
after a short time and a long one in turn, which together are the producer time (0x1017) that the recording has shown. A burst of
heartbeats that were held back does not look so. Where 0x1017 is not known, two devices are likely if both times stay the same,
and the long one is more than _UNLIKE times the short one: a device that counts in coarse ticks has only neighbouring multiples of
one tick, as 10 ms and 20 ms.

A boot-up of a node that has sent something since its last one, and was not told to reset, is told: it was switched off and on, or
has reset itself; or the recording lacks the command.

A heartbeat is late by its most impatient consumer (0x1016). Without one, a node that falls silent is late by SILENT of its own
periods: of its 0x1017, once the recording has shown that and a heartbeat, or of _STEADY heartbeats in an even rhythm.

Two heartbeats at once are a copy, or were held back, but for the first one of a new 0x1017, which comes at once, and for one that
is in time behind one that was late.

Two masters are not seen by NMT commands: CAN does not tell who has sent them. A node that is operational behind its boot-up
without a command is no fault: it may start by itself (CiA 301 v4.2.0, 7.3.2.2.1; 0x1F80).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from canopen_proto.explained import counted
from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.nmt import COMMAND_OF_BYTE, STATE_OF_BYTE, NmtCommand, NmtState
from canopen_proto.observer.finding import QUIET, BusFinding, Gaps, duration_text, ms_text
from canopen_proto.observer.words import nmt_command_text

OBEYING: Final = 100 * MILLISECOND
"""Time for a node to obey an NMT command: what it has in its queues still goes out, and a slow node takes its time."""
LATE: Final = 25 * MILLISECOND
"""A heartbeat that comes sooner behind a frame may have been sent before it."""
MAX_CONSUMERS: Final = 127
"""Entries of 0x1016 that one node may have (CiA 301 v4.2.0, 7.5.2.19)."""

_BOOT_UP: Final = 0
_OPERATIONAL: Final = int(NmtState.OPERATIONAL)
_STATE: Final = 0x7F
_AFTER: Final[dict[int, int]] = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}
"""The state behind a command; behind a reset it is not known until the node says it."""
_RESETS: Final = (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)
_TURNS: Final = 5
"""Changes of a state without a reason that only two nodes can make: A, B, A, B, A, B."""
_PAIRS: Final = 11
"""Intervals in a row that only two nodes can make: a short one and a long one in turn, together the heartbeat time."""
_UNLIKE: Final = 3
"""The intervals of one device in turn are one tick and two ticks of its clock at most."""
_SAME_TOGGLES: Final = 7
"""Guarding answers in a row with the same toggle bit that no loss makes: each time an odd number of answers would be missing."""
COPY: Final = 5 * MILLISECOND
"""The same heartbeat within this time is a copy, or was held back."""
SILENT: Final = 2.5
"""Periods without a heartbeat behind which a node is silent: one of two that are missing may be the recorder's loss."""
_STEADY: Final = 3
"""Intervals in a row that are as long as the one before: a rhythm."""
_TOGGLE: Final = 0x80


@dataclass(slots=True)
class _View:
    """One node, as it was heard. state: None if it is not known. since: when it got there at the latest."""

    state: int | None = None
    since: Time = 0
    turns: list[int] = field(default_factory=list)  # states without a reason for the change, the oldest first
    limit: Time = NEVER  # of its heartbeat, by its most impatient consumer
    deadline: Time = NEVER
    is_told: bool = False  # that an SDO went to the stopped node
    is_said: bool = False  # the state, by the node itself
    period: Time = 0  # of its heartbeat (0x1017); 0 if it is not known, or switched off
    rhythm: Time = 0  # the longest of some even intervals between its heartbeats; 0 if it has shown none
    steady: int = 0  # intervals in a row that are as long as the one before
    is_late: bool = False  # its last heartbeat came late
    is_excused: bool = False  # it was silent while no frame was heard at all
    last: Time = -NEVER  # its last heartbeat
    interval: Time = 0  # from the heartbeat before it
    both: Time = 0  # its last two intervals together
    pairs: int = 0  # heartbeats in a row that came in two rhythms
    byte: int = -1  # of its last heartbeat
    suspect: BusFinding | None = None  # what its next heartbeat may prove
    suspected: Time = 0  # when that was
    guarded: Time = -NEVER  # its last guarding answer
    guard_time: Time = NEVER  # the least time between two of them
    same_toggles: int = 0  # answers in a row that did not alternate
    is_asked: bool = False  # by a guarding request
    is_up: bool = False  # it has sent something since it booted
    is_reset: bool = False  # it was told to boot
    toggle: int | None = None  # the toggle bit of its last guarding answer

    def wait(self, now: Time) -> None:
        """Begin to wait for its next heartbeat."""
        if self.limit < NEVER:
            self.deadline = now + self.limit
        else:
            period = self.period or self.rhythm
            self.deadline = now + int(SILENT * period) if period else NEVER

    def beat(self, interval: Time) -> None:
        """Take the time from one heartbeat to the next; endless before the second one."""
        before, self.interval = self.interval, interval
        if interval >= NEVER:
            self.is_late, self.steady = False, 0
            return
        period = self.period or self.rhythm
        self.is_late = interval * 4 > period * 5 > 0
        self.steady = self.steady + 1 if abs(interval - before) * 8 <= before else 0
        if self.steady >= _STEADY:
            self.rhythm = max(interval, before)

    def has_new_period(self, period: Time) -> None:
        """Forget its rhythm. period: the new one; 0 if it is not known, or there is none."""
        self.period, self.rhythm, self.steady, self.pairs, self.last = period, 0, 0, 0, -NEVER


class NodeRules:
    """See this module's text. deadline: the time at which a heartbeat is late; NEVER if none can be."""

    def __init__(self, gaps: Gaps) -> None:
        self._gaps = gaps
        self._views = [_View() for _ in range(MAX_NODE_ID + 1)]
        self._consumers: dict[tuple[int, int], tuple[int, Time]] = {}  # by consumer and subindex: the producer and its time
        self.deadline: Time = NEVER

    def consumer(self, node_id: int, subindex: int, value: int) -> None:
        """Take note of an entry of a node's 0x1016. value: node-ID << 16 | ms."""
        producer, time = value >> 16 & 0x7F, (value & 0xFFFF) * MILLISECOND
        before = self._consumers.pop((node_id, subindex), None)
        if producer and time and 0 < subindex <= MAX_CONSUMERS:
            self._consumers[node_id, subindex] = (producer, time)
            self._limit(producer)
        if before is not None:
            self._limit(before[0])

    def no_consumers(self, node_id: int) -> None:
        """Take note that a node's 0x1016 is not known any more."""
        for key in [key for key in self._consumers if key[0] == node_id]:
            self._limit(self._consumers.pop(key)[0])

    def _limit(self, producer: int) -> None:
        """Renew after which silence of a node some consumer of it says so."""
        view = self._views[producer]
        before = view.limit
        view.limit = min((time for each, time in self._consumers.values() if each == producer), default=NEVER)
        if before < view.limit == NEVER and view.deadline < NEVER:
            view.wait(view.deadline - before)

    def producer(self, node_id: int, period: Time, now: Time) -> None:
        """Take note of a node's producer heartbeat time (0x1017). period: ns."""
        view = self._views[node_id]
        if period == view.period > 0:
            return
        view.has_new_period(period)
        if view.limit == NEVER and view.byte >= 0:  # else the recording may show no heartbeats at all
            view.wait(now)
            self.deadline = min(self.deadline, view.deadline)

    def is_to_begin(self, node_id: int) -> None:
        """Take note of a request to write a node's 0x1017: its next heartbeat comes at once."""
        self._views[node_id].last = -NEVER

    def is_operational(self, node_id: int) -> bool:
        """Return whether the node has said that it is operational, and was not told otherwise since."""
        view = self._views[node_id]
        return view.is_said and view.state == NmtState.OPERATIONAL

    def silent_in_pause(self, now: Time) -> set[int]:
        """Return the nodes whose heartbeats have become late since the last frame of the bus. Each is named once, until it sends
        one again: who is silent behind the pause, too, is late."""
        return {node_id for node_id, view in enumerate(self._views) if view.deadline <= now and not view.is_excused}

    def lost(self, now: Time) -> None:
        """Take note that frames were not heard: a heartbeat that is missing may be one of them, and so may an NMT command."""
        for view in self._views:
            view.last, view.steady, view.suspect = -NEVER, 0, None
            if view.deadline < NEVER:
                view.is_excused = view.is_excused or view.deadline <= now
                view.wait(now)
        self.deadline = min(view.deadline for view in self._views)

    def asked(self, node_id: int) -> None:
        """Take note of a guarding request."""
        self._views[node_id].is_asked = True

    def overdue(self, now: Time) -> list[BusFinding]:
        """Return the heartbeats that are later than their consumers allow; each one once."""
        found = []
        for node_id, view in enumerate(self._views):
            if view.deadline <= now:
                view.deadline = NEVER
                if view.limit < NEVER:
                    allowed = view.limit // MILLISECOND
                    waiting = [str(consumer) for (consumer, _), (each, _) in sorted(self._consumers.items()) if each == node_id]
                    text = f"no heartbeat for more than {allowed} ms, which node {', '.join(waiting)} allows"
                else:
                    period = view.period or view.rhythm
                    text = f"no heartbeat for more than {ms_text(int(SILENT * period))}, and it sends one in {ms_text(period)}"
                if view.last > -NEVER:
                    text += f"; the last one came {duration_text(now - view.last)} before"
                view.rhythm = view.steady = 0
                found.append(BusFinding("late heartbeat", node_id, text, is_certain=False))
        self.deadline = min(view.deadline for view in self._views)
        return found

    def command(self, command: int, node_id: int, now: Time) -> list[BusFinding]:
        """Take note of an NMT command. node_id: 0 for all nodes."""
        if command not in COMMAND_OF_BYTE:
            return [BusFinding("nmt", 0, f"an NMT command 0x{command:02X} for node {node_id}: there is no such command")]
        if node_id > MAX_NODE_ID:
            name = nmt_command_text(command)
            text = f"the NMT command {name} (0x{command:02X}) with node-ID {node_id}: 0 is all nodes, 1 to {MAX_NODE_ID} one node"
            return [BusFinding("nmt", 0, text)]
        for view in self._views[node_id : node_id + 1] if node_id else self._views:
            view.state = _AFTER.get(command)
            view.since = now
            view.turns.clear()
            view.suspect = None
            view.is_told = view.is_said = False
            view.last = -NEVER  # a heartbeat that tells the new state may come at once
            if command in _RESETS:
                view.is_reset = True
                view.has_new_period(0)
                if view.limit == NEVER:
                    view.deadline = NEVER
        return []

    def error_control(self, node_id: int, data: bytes, now: Time) -> list[BusFinding]:
        """Take note of a boot-up, a heartbeat, or a guarding answer."""
        if len(data) != 1:
            return [BusFinding("length", node_id, f"a heartbeat of {counted(len(data), 'byte')}; it has one")]
        view, state = self._views[node_id], data[0] & _STATE
        found = self._beat(node_id, view, data[0], state, now)
        view.wait(now)
        self.deadline = min(self.deadline, view.deadline)
        return found

    def _beat(self, node_id: int, view: _View, byte: int, state: int, now: Time) -> list[BusFinding]:
        if state == _BOOT_UP:
            view.state = None
            view.is_said = view.is_asked = False
            view.turns.clear()
            view.has_new_period(0)
            view.suspect, view.guarded = None, -NEVER
            view.toggle = _TOGGLE  # the first guarding answer has 0 (CiA 301 v4.2.0, 7.2.8.3.2.1)
            is_expected = view.is_reset or not view.is_up
            view.is_reset = view.is_up = False
            text = "it boots in the middle of operation, and no reset command is in the recording"
            return [] if is_expected else [BusFinding("boot-up", node_id, text, is_certain=False)]
        view.is_up, view.is_excused = True, False
        found: list[BusFinding] = []
        is_answer = view.is_asked
        if is_answer:
            self._answered(node_id, view, byte, now, found)
        elif byte == view.byte and now - view.last < min(COPY, view.period // 2 or COPY) and not view.is_late:
            self._gaps.copied(node_id, "heartbeats come at once: they are there twice, or were held back", now, found)
            return found
        view.byte = byte
        if view.suspect is not None and state != view.state:
            view.suspect = None
        elif view.suspect is not None and now - view.suspected > LATE:
            found.append(view.suspect)
            view.suspect = None
        if STATE_OF_BYTE[state] is None:
            found.append(BusFinding("state", node_id, f"its heartbeat says state 0x{state:02X}, which CiA 301 does not have"))
        self._in_turn(node_id, view, now, found, is_answer=is_answer)
        interval = now - view.last
        view.last, view.is_said = now, True
        if is_answer:
            view.interval, view.rhythm, view.steady = interval, 0, 0  # by the rhythm of the requests
        else:
            view.beat(interval)
        if now - self._gaps.last < QUIET:
            view.turns.clear()
        if not view.turns or state != view.turns[-1]:
            view.turns.append(state)
            if len(view.turns) > _TURNS:
                if len(set(view.turns[::2])) == len(set(view.turns[1::2])) == 1:
                    text = f"its heartbeats say {_word(view.turns[-2])} and {_word(state)} in turn: two nodes have one ID"
                    found.append(BusFinding("double id", node_id, text))
                del view.turns[:-1]
        if state != view.state:
            view.state, view.since, view.is_told = state, now, False
        return found

    def _in_turn(self, node_id: int, view: _View, now: Time, found: list[BusFinding], *, is_answer: bool) -> None:
        """Look whether heartbeats come in two rhythms, as those of two nodes do."""
        interval, before, period = now - view.last, view.interval, view.period
        both, was_both = interval + before, view.both
        if period:
            is_pair = abs(both - period) * 8 <= period and abs(interval - before) * 5 > period
        else:  # of guarding, each master has a rhythm of its own
            least, most = sorted((interval, before))
            is_pair = not is_answer and abs(both - was_both) * 16 <= both < NEVER and most > _UNLIKE * least
        view.both = both
        view.pairs = view.pairs + 1 if is_pair else 0
        if view.pairs != _PAIRS:
            return
        text = f"its heartbeats come {ms_text(before)} and {ms_text(interval)} apart in turn"
        text += f", and it sends one in {ms_text(period)}: two nodes have one ID" if period else ": two nodes have one ID"
        found.append(BusFinding("double id", node_id, text, is_certain=bool(period)))

    def _answered(self, node_id: int, view: _View, byte: int, now: Time, found: list[BusFinding]) -> None:
        """Look whether an answer to a guarding request has the toggle bit of the one before.

        A request and an answer may be missing between them. It is told once many in a row came, each in the time of one request.
        """
        view.is_asked = False
        last, view.toggle = view.toggle, byte & _TOGGLE
        interval, view.guarded = now - view.guarded, now
        is_early = interval < COPY or (view.guard_time < NEVER and interval * 4 < view.guard_time * 3)
        is_in_time = interval * 2 < view.guard_time * 3
        text = "its guarding answers do not alternate the toggle bit"
        if view.toggle == last and is_early:
            self._gaps.copied(node_id, f"{text}: one is there twice", now, found)
            return
        if interval >= COPY:
            view.guard_time = min(view.guard_time, interval)
        if view.toggle == last:
            view.same_toggles = view.same_toggles + 1 if is_in_time else 0
            if view.same_toggles == _SAME_TOGGLES:
                view.same_toggles = 0
                found.append(BusFinding("toggle", node_id, f"{text}: it sends heartbeats instead, or two nodes have one ID"))
            else:
                self._gaps.missing(node_id, text, now, found)
        else:
            view.same_toggles = 0

    def sdo(self, node_id: int, now: Time, found: list[BusFinding], *, is_answer: bool) -> None:
        """Take note of an SDO frame. found: takes the findings. is_answer: from the node; else to it."""
        view = self._views[node_id]
        view.is_up = view.is_up or is_answer
        if view.state != NmtState.STOPPED or now - view.since < OBEYING or (view.is_told and not is_answer):
            return
        view.is_told = True
        text = "it is stopped, and answers an SDO" if is_answer else "an SDO goes to a node that is stopped: it may not answer"
        view.suspect, view.suspected = BusFinding("stopped", node_id, text), now

    def pdo(self, node_id: int, now: Time, found: list[BusFinding]) -> None:
        """Take note of a PDO that a node has sent. found: takes the findings."""
        view = self._views[node_id]
        view.is_up = True
        if view.state is None or view.state == _OPERATIONAL or now - view.since < OBEYING:
            return
        view.since = now  # said again after a while only
        text = f"it sends a PDO, and is {_word(view.state)}"
        view.suspect, view.suspected = BusFinding("not operational", node_id, text), now


def _word(state: int) -> str:
    return NmtState(state).name.lower().replace("_", "-") if state in set(NmtState) else f"in state 0x{state:02X}"
