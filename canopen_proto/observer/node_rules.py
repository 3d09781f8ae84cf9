"""Look whether the nodes of a bus keep to the rules of network management, by listening only: states and heartbeats.

The state of a node is the one that its last heartbeat, or guarding answer, has told. An NMT command counts as well, once the node
had the time to obey; a node that does not obey shows it by its next heartbeat. Behind a boot-up the state is not known: the node
may start by itself (0x1F80, CiA 302-2).

Two nodes with one ID: their heartbeats tell two states in turn. A state that changes, back, and again, without an NMT command or
a boot-up, is that; a single change is a device that changes its state by itself (CiA 301 v4.2.0, 7.3.2.2). Or heartbeats with
one state come in less than half of the producer time (0x1017), again and again, once the recording has shown that time.

A boot-up of a node that has sent something since its last one, and was not told to reset, is told: it was switched off and on, or
has reset itself; or the recording lacks the command.

Two masters are not seen by NMT commands: CAN does not tell who has sent them. A node that is operational behind its boot-up
without a command is no fault: it may start by itself (CiA 301 v4.2.0, 7.3.2.2.1; 0x1F80).
"""

from __future__ import annotations

from typing import Final

from canopen_proto.frame import MAX_NODE_ID
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.observer.finding import Finding, ms_text
from canopen_proto.observer.words import nmt_command_text

OBEYING: Final = 100 * MILLISECOND
"""Time for a node to obey an NMT command: what it has in its queues still goes out, and a slow node takes its time."""
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
_COMMANDS: Final = frozenset(int(command) for command in NmtCommand)
_STATES: Final = frozenset(int(state) for state in NmtState)
_TURNS: Final = 3
"""Changes of a state without a reason that only two nodes can make: A, B, A, B."""
_EARLY: Final = 3
"""Heartbeats in a row that come too early, until that is told: one may wait for the bus, and the next one not."""
_TOGGLE: Final = 0x80


class _View:
    """One node, as it was heard. state: None if it is not known. since: when it got there at the latest."""

    __slots__ = (
        "deadline", "early", "is_asked", "is_reset", "is_said", "is_told", "is_up", "last", "limit", "period", "since",
        "state", "toggle", "turns",
    )  # fmt: skip

    def __init__(self) -> None:
        self.state: int | None = None
        self.since: Time = 0
        self.turns: list[int] = []  # states without a reason for the change, the oldest first
        self.limit: Time = NEVER  # of its heartbeat, by its most impatient consumer
        self.deadline: Time = NEVER
        self.is_told = False  # that an SDO went to the stopped node
        self.is_said = False  # the state, by the node itself
        self.period: Time = 0  # of its heartbeat (0x1017); 0 if it is not known, or switched off
        self.last: Time = -NEVER  # its last heartbeat
        self.early = 0  # heartbeats in a row that came too early
        self.is_asked = False  # by a guarding request
        self.is_up = False  # it has sent something since it booted
        self.is_reset = False  # it was told to boot
        self.toggle: int | None = None  # the toggle bit of its last guarding answer


class NodeRules:
    """See this module's text. deadline: the time at which a heartbeat is late; NEVER if none can be."""

    __slots__ = ("_consumers", "_views", "deadline")

    def __init__(self) -> None:
        self._views = [_View() for _ in range(MAX_NODE_ID + 1)]
        self._consumers: dict[tuple[int, int], tuple[int, Time]] = {}  # by consumer and subindex: the producer and its time
        self.deadline: Time = NEVER

    def consumer(self, node_id: int, subindex: int, value: int) -> None:
        """Take note of an entry of a node's 0x1016. value: node-ID << 16 | ms."""
        producer, time = value >> 16 & 0x7F, (value & 0xFFFF) * MILLISECOND
        self._consumers.pop((node_id, subindex), None)
        if producer and time and 0 < subindex <= MAX_CONSUMERS:
            self._consumers[node_id, subindex] = (producer, time)
        for number, view in enumerate(self._views):
            view.limit = min((time for each, time in self._consumers.values() if each == number), default=NEVER)
            if view.limit == NEVER:
                view.deadline = NEVER

    def producer(self, node_id: int, period: Time) -> None:
        """Take note of a node's producer heartbeat time (0x1017). period: ns."""
        view = self._views[node_id]
        view.period, view.early, view.last = period, 0, -NEVER

    def is_operational(self, node_id: int) -> bool:
        """Return whether the node has said that it is operational, and was not told otherwise since."""
        view = self._views[node_id]
        return view.is_said and view.state == NmtState.OPERATIONAL

    def asked(self, node_id: int) -> None:
        """Take note of a guarding request."""
        self._views[node_id].is_asked = True

    def overdue(self, now: Time) -> list[Finding]:
        """Return the heartbeats that are later than their consumers allow; each one once."""
        found = []
        for node_id, view in enumerate(self._views):
            if view.deadline <= now:
                view.deadline = NEVER
                allowed = view.limit // MILLISECOND
                waiting = [str(consumer) for (consumer, _), (each, _) in sorted(self._consumers.items()) if each == node_id]
                text = f"no heartbeat for more than {allowed} ms, which node {', '.join(waiting)} allows"
                found.append(Finding("late heartbeat", node_id, text))
        self.deadline = min(view.deadline for view in self._views)
        return found

    def command(self, command: int, node_id: int, now: Time) -> list[Finding]:
        """Take note of an NMT command. node_id: 0 for all nodes."""
        if command not in _COMMANDS:
            return [Finding("nmt", 0, f"an NMT command 0x{command:02X} for node {node_id}: there is no such command")]
        if node_id > MAX_NODE_ID:
            name = nmt_command_text(command)
            text = f"the NMT command {name} (0x{command:02X}) with node-ID {node_id}: 0 is all nodes, 1 to {MAX_NODE_ID} one node"
            return [Finding("nmt", 0, text)]
        for view in self._views[node_id : node_id + 1] if node_id else self._views:
            view.state = _AFTER.get(command)
            view.since = now
            view.turns.clear()
            view.is_told = view.is_said = False
            view.last = -NEVER  # a heartbeat that tells the new state may come at once
            view.is_reset = view.is_reset or command in _RESETS
        return []

    def error_control(self, node_id: int, data: bytes, now: Time) -> list[Finding]:
        """Take note of a boot-up, a heartbeat, or a guarding answer."""
        if len(data) != 1:
            return [Finding("length", node_id, f"a heartbeat of {len(data)} bytes; it has one")]
        view, state = self._views[node_id], data[0] & _STATE
        view.deadline = NEVER if view.limit == NEVER else now + view.limit
        self.deadline = min(self.deadline, view.deadline)
        if state == _BOOT_UP:
            view.state = None
            view.is_said = view.is_asked = False
            view.turns.clear()
            view.period, view.toggle = 0, _TOGGLE  # the first guarding answer has 0 (CiA 301 v4.2.0, 7.2.8.3.2.1)
            is_expected = view.is_reset or not view.is_up
            view.is_reset = view.is_up = False
            text = "it boots in the middle of operation, and no reset command is in the recording"
            return [] if is_expected else [Finding("boot-up", node_id, text, is_certain=False)]
        view.is_up = True
        found = self._answered(node_id, view, data[0])
        if state not in _STATES:
            found.append(Finding("state", node_id, f"its heartbeat says state 0x{state:02X}, which CiA 301 does not have"))
        if now - view.last >= view.period // 2 or state != view.state:
            view.early = 0
        else:
            view.early += 1
            if view.early == _EARLY:
                text = f"its heartbeats come {ms_text(now - view.last)} apart, and it sends one in {ms_text(view.period)}"
                found.append(Finding("double id", node_id, f"{text}: two nodes have one ID"))
        view.last, view.is_said = now, True
        if not view.turns or state != view.turns[-1]:
            view.turns.append(state)
            if len(view.turns) > _TURNS:
                if view.turns[-1] == view.turns[-3] and view.turns[-2] == view.turns[-4]:
                    text = f"its heartbeats say {_word(view.turns[-2])} and {_word(state)} in turn: two nodes have one ID"
                    found.append(Finding("double id", node_id, text))
                del view.turns[:-1]
        if state != view.state:
            view.state, view.since, view.is_told = state, now, False
        return found

    def _answered(self, node_id: int, view: _View, byte: int) -> list[Finding]:
        """Return whether an answer to a guarding request has the toggle bit of the one before."""
        if not view.is_asked:
            return []
        view.is_asked = False
        last, view.toggle = view.toggle, byte & _TOGGLE
        if view.toggle != last:
            return []
        text = "its guarding answers do not alternate the toggle bit: it sends heartbeats instead, or two nodes have one ID"
        return [Finding("toggle", node_id, text)]

    def sdo(self, node_id: int, now: Time, found: list[Finding], *, is_answer: bool) -> None:
        """Take note of an SDO frame."""
        view = self._views[node_id]
        view.is_up = view.is_up or is_answer
        if view.state != NmtState.STOPPED or now - view.since < OBEYING or (view.is_told and not is_answer):
            return
        view.is_told = True
        text = "it is stopped, and answers an SDO" if is_answer else "an SDO goes to a node that is stopped: it may not answer"
        found.append(Finding("stopped", node_id, text))

    def pdo(self, node_id: int, now: Time, found: list[Finding]) -> None:
        """Take note of a PDO that a node has sent."""
        view = self._views[node_id]
        view.is_up = True
        if view.state is None or view.state == _OPERATIONAL or now - view.since < OBEYING:
            return
        view.since = now  # said again after a while only
        found.append(Finding("not operational", node_id, f"it sends a PDO, and is {_word(view.state)}"))


def _word(state: int) -> str:
    return NmtState(state).name.lower().replace("_", "-") if state in set(NmtState) else f"in state 0x{state:02X}"
