"""`Story`: what happened on a bus, in the order of time: boot-ups, emergencies, drives in fault, silent nodes, aborted transfers.

    story, observer = Story(), Observer(dictionaries.get)
    for frame, now in recording:
        for event in story.add(frame, observer.observe(frame, now), now):
            event.time, event.node_id, event.text

An event is no breach of a rule: the bus works as the standard says, and a machine stands still all the same. What comes again and
again is told once, and counted: `repeated`. What the observer finds at the same frame, such as a late heartbeat or a boot-up in
the middle of operation, is not told once more. Memory is bounded: MAX_KINDS kinds of events, and the last state of 127 nodes.

`is_wrong` tells whether anything of it was wrong. A boot-up is not. An abort is not if the object does not exist, or if a client
has waited in vain for a node that nobody has heard: many programs look for what may be missing.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from canopen_proto.abort import AbortCode
from canopen_proto.drives.cia402.objects import STATUSWORD
from canopen_proto.drives.cia402.states import FAULT_STATES, State, state_of
from canopen_proto.frame import (
    ALL_NODE_IDS,
    BY_THE_NODE,
    FUNCTION,
    MAX_NODE_ID,
    Frame,
)
from canopen_proto.machine import MILLISECOND, NEVER, Time
from canopen_proto.multiplexer import index_of
from canopen_proto.nmt import NmtCommand
from canopen_proto.observer.finding import duration_text
from canopen_proto.observer.observer import Observation

MAX_KINDS: Final = 4096
"""Kinds of events that are told apart. Further ones are counted only."""
MISSED: Final = 3
"""A node is silent behind so many of its heartbeat times without a heartbeat."""

_ABORT: Final = b"\x80"
_MISSING: Final = (AbortCode.NO_SUCH_OBJECT, AbortCode.NO_SUCH_SUBINDEX)
_RESETS: Final = (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)
_STATUSWORD: Final = index_of(STATUSWORD)


KINDS: Final = {
    "boot": "a node boots",
    "EMCY": "a node tells an error, or the end of its errors",
    "fault": "a drive falls into fault, or leaves it",
    "silent": "no heartbeat any more, or no frame at all",
    "back": "a heartbeat again",
    "abort": "an SDO transfer is aborted",
}
"""By the kind of an event: what happened, in words."""


class BusEvent(NamedTuple):
    """Something that happened. time: ns. kind: one of KINDS. text: for people."""

    time: Time
    kind: str
    node_id: int
    text: str


class _Beat:
    """The heartbeat of a node. period: the longest time between two of the first ones; 0 before the second one."""

    __slots__ = ("count", "is_silent", "last", "period")

    def __init__(self, now: Time) -> None:
        self.last = now
        self.count = 0
        self.period: Time = 0
        self.is_silent = False


class Story:
    """See this module's text. told: events by kind. repeated: events that were told before, by kind. is_wrong: something was."""

    def __init__(self) -> None:
        self.told: dict[str, int] = {}
        self.repeated: dict[str, int] = {}
        self.is_wrong = False
        self._alive: set[int] = set()  # nodes that have sent something
        self._is_reset: set[int] = set()  # nodes that were told to boot, and have not yet
        self._kinds: set[tuple[str, int, bytes | str]] = set()
        self._emergencies: dict[int, bytes] = {}
        self._states: dict[tuple[int, int], State] = {}  # by node and object, of those in fault
        self._beats: dict[int, _Beat] = {}
        self._untold: set[int] = set()  # nodes whose last emergency was forgotten: it is told when it comes again
        self._deadline: Time = NEVER
        self._last: Time = -NEVER

    def add(self, frame: Frame, observation: Observation, now: Time) -> list[BusEvent]:
        """Take a frame, and what the observer says of it. Return what it shows to have happened. now: ns."""
        events: list[BusEvent] = []
        is_gap_told = False
        for finding in observation.findings:
            if finding.rule == "late heartbeat":
                self._is_told_silent(finding.node_id, now)
            is_gap_told = is_gap_told or finding.rule == "missing"
        if now >= self._deadline:
            self._silences(now, events, is_gap_told=is_gap_told)
        if now > self._last:
            self._last = now
        service, node_id = observation.meaning.service, observation.meaning.node_id
        if observation.statuswords:
            for index, word in observation.statuswords:
                self._statusword(node_id, index, word, now, events)
        if frame.can_id & FUNCTION in BY_THE_NODE:
            self._alive.add(node_id)
        if service == "boot-up" and not any(each.rule == "boot-up" for each in observation.findings):
            self._tell("boot", node_id, f"it boots{', as it was told to' if node_id in self._is_reset else ''}", now, events)
        if service == "boot-up":
            self._is_reset.discard(node_id)
        if service == "heartbeat" or service == "boot-up":
            self._heard(node_id, service == "boot-up", now, events)
        elif service == "EMCY":
            self._emergency(node_id, frame.data, observation, now, events)
        elif service == "NMT":
            self._command(frame.data)
        elif service == "SDO" and frame.data[:1] == _ABORT and observation.meaning.text.startswith("aborted"):
            code = int.from_bytes(frame.data[4:8], "little")
            is_in_vain = code == AbortCode.TIMED_OUT and node_id not in self._alive
            self.is_wrong = self.is_wrong or not (code in _MISSING or is_in_vain)
            self._tell_kind("abort", node_id, frame.data[4:8], observation.meaning.text, now, events)
        return events

    def forget_told(self) -> None:
        """Forget what was told, and how often, but not how the bus is: what comes again is told again, as in a part of it."""
        self.told.clear()
        self.repeated.clear()
        self.is_wrong = False
        self._kinds.clear()
        self._untold = set(self._emergencies)

    def _tell(self, kind: str, node_id: int, text: str, now: Time, events: list[BusEvent]) -> None:
        self.told[kind] = self.told.get(kind, 0) + 1
        self.is_wrong = self.is_wrong or kind not in ("boot", "abort")
        events.append(BusEvent(now, kind, node_id, text))

    def _tell_kind(self, kind: str, node_id: int, mark: bytes, text: str, now: Time, events: list[BusEvent]) -> None:
        """Tell an event, if its mark is a new one of this node; count it in any case."""
        key = (kind, node_id, mark)
        if key in self._kinds or len(self._kinds) >= MAX_KINDS:
            self.repeated[kind] = self.repeated.get(kind, 0) + 1
            return
        self._kinds.add(key)
        self._tell(kind, node_id, text, now, events)

    def _emergency(self, node_id: int, data: bytes, observation: Observation, now: Time, events: list[BusEvent]) -> None:
        """An emergency that says the same as the last one counts only. The end of all errors is told if there were some."""
        if data[:2] == bytes(2) and node_id not in self._emergencies:
            return
        if self._emergencies.get(node_id) == data and node_id not in self._untold:
            self.repeated["EMCY"] = self.repeated.get("EMCY", 0) + 1
            return
        self._emergencies[node_id] = data
        self._untold.discard(node_id)
        self._tell("EMCY", node_id, observation.meaning.text, now, events)

    def _statusword(self, node_id: int, index: int, word: int, now: Time, events: list[BusEvent]) -> None:
        """Tell when a drive falls into fault, and when it leaves that."""
        state, key = state_of(word), (node_id, index)
        before = self._states.get(key)
        if (state in FAULT_STATES) == (before is not None):
            return
        which = "the drive" if index == _STATUSWORD else f"the drive of statusword {index:04X}"
        if before is None:
            self._states[key] = state
            self._tell("fault", node_id, f"{which} is in fault (statusword 0x{word:04X})", now, events)
        else:
            del self._states[key]
            name = state.name.lower().replace("_", " ")
            self._tell("fault", node_id, f"{which} has left fault: {name} (statusword 0x{word:04X})", now, events)

    def _command(self, data: bytes) -> None:
        """An NMT command may switch a heartbeat off: the next one is the first again."""
        if len(data) == 2 and data[1] <= MAX_NODE_ID:
            if data[0] in _RESETS:
                self._is_reset.update((data[1],) if data[1] else ALL_NODE_IDS)
            for node_id in [data[1]] if data[1] else list(self._beats):
                self._beats.pop(node_id, None)

    def _heard(self, node_id: int, is_boot_up: bool, now: Time, events: list[BusEvent]) -> None:
        beat = self._beats.get(node_id)
        if beat is not None and beat.is_silent:
            self._tell("back", node_id, f"it is back {duration_text(now - beat.last)} behind its last heartbeat", now, events)
        if beat is None or beat.is_silent or is_boot_up:
            self._beats[node_id] = _Beat(now)
            return
        if beat.count < MISSED:
            beat.count += 1
            beat.period = max(beat.period, now - beat.last)
        beat.last = now
        if beat.count >= MISSED:
            self._deadline = min(self._deadline, now + MISSED * beat.period)

    def _is_told_silent(self, node_id: int, now: Time) -> None:
        """The observer has told that a node is silent, so it is not told once more; but not where the whole bus was silent."""
        beat = self._beats.get(node_id)
        if beat is not None and (now - self._last) * 2 <= now - beat.last:
            beat.is_silent = True

    def _silences(self, now: Time, events: list[BusEvent], *, is_gap_told: bool) -> None:
        """Tell which nodes have become silent. Where no frame came at all, the bus has, or the recording stood still: if the
        observer has not told that."""
        pause = now - self._last
        self._deadline = NEVER
        silent = []
        for node_id, beat in self._beats.items():
            if beat.count < MISSED or beat.is_silent:
                continue
            due = beat.last + MISSED * max(beat.period, MILLISECOND)
            if due <= now:
                silent.append((node_id, beat))
            else:
                self._deadline = min(self._deadline, due)
        if silent and pause * 2 > min(now - beat.last for _, beat in silent):
            text = f"the recording has no frame at all for {duration_text(pause)} before this one"
            if not is_gap_told:
                self._tell("silent", 0, text, now, events)
            for _, beat in silent:
                beat.last = now
                self._deadline = min(self._deadline, now + MISSED * beat.period)
            return
        for node_id, beat in silent:
            beat.is_silent = True
            text = f"no heartbeat any more; it had one in {duration_text(beat.period)} at most"
            text += f"; the last one came {duration_text(now - beat.last)} before"
            self._tell("silent", node_id, text, now, events)
