"""`BusKnowledge`: what was last heard from each node, so that an error can say what was seen, not only what was missing.

A request without an answer has many causes, and most of them can be heard: the node is stopped, it has just booted, another
client talks to it, it answered too late, it has another node-ID, or there is nothing on the bus. `BusKnowledge` remembers the
last frame of every 11-bit CAN-ID and its time, whether a machine wanted it or not. A frame costs two list stores; its meaning is
worked out only on a query. Its size is bounded: a slot for each of the 2048 CAN-IDs, and three small facts for each of the 127
node-IDs.

The sender of a frame follows from the predefined connection set (CiA 301 v4.2.0, 7.3.3): CAN-ID = function code + node-ID. That
is a hint, not a proof: a configuration can give a device's PDOs, its EMCY and its further SDO channels other COB-IDs. The COB-ID
of error control (0x700 + node-ID) is fixed, and those of EMCY and of the first SDO server hardly ever change: these count as
signs of their node. PDOs often have other COB-IDs: they are kept apart (`NodeHeard.pdo`) and are no sign of a node.

The frames alone do not show three things, which come from our SDO clients or follow from the CAN-ID:

- an answer that came for none of our requests (`unasked_answer`): another client asks this node, or two devices have its node-ID;
- a second answer to one request, with another value (`second_answer`): two devices have its node-ID;
- an answer that came after the request had timed out (`late_answer`): the time limit was too short;
- requests of other clients (`foreign_request`): any frame to 0x600 + node-ID, since we do not receive our own frames;
- the last command of another NMT master (`foreign_command`), if it is for this node or for all.

Left out: 29-bit CAN-IDs and remote frames (only the time of the last one is kept), and all frames of our own machines. If a
transport filters frames (`hears_all` is False), a node that was not heard may still be there.
"""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple

from canopen_proto.frame import (
    ALL_NODE_IDS,
    EMCY,
    ERROR_CONTROL,
    MAX_NODE_ID,
    NMT,
    SDO_CLIENT_TO_SERVER,
    SDO_SERVER_TO_CLIENT,
    TPDOS,
    Frame,
)
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Time, check_node_id
from canopen_proto.nmt import STATE_OF_BYTE, NmtState
from canopen_proto.sdo.codec import ABORT, INITIATE_DOWNLOAD_RESPONSE, INITIATE_UPLOAD_RESPONSE, SPECIFIER

SLOTS: Final = 0x800
"""One for each 11-bit CAN-ID."""

MAX_LATENESS: Final = 10 * SECOND
"""An answer later than this belongs to something else: no device takes so long for one response."""

COPY_TIME: Final = 5 * MILLISECOND
"""The same answer again within this time is a second copy, which CAN itself can make, not the answer to another client."""

_NOT_HEARD: Final = -NEVER


class HeardService(Enum):
    """The service by which a node was heard."""

    HEARTBEAT = "heartbeat"
    BOOT_UP = "boot-up"
    EMCY = "emergency"
    SDO = "SDO answer"


class Seen(NamedTuple):
    """A frame that was seen. time: ns on the driver's clock."""

    time: Time
    frame: Frame


class EmcySeen(NamedTuple):
    """The last emergency message. error_code: 0 means that the errors are gone."""

    time: Time
    error_code: int


class LateAnswer(NamedTuple):
    """An answer to a request that had timed out. behind: ns by which it exceeded the time limit."""

    time: Time
    behind: Time


class NodeHeard(NamedTuple):
    """All that was heard of one node; see this module's text. None in a field: never.

    time, service: of its last sign. state, state_time: of its last heartbeat or guarding answer; PRE_OPERATIONAL after a boot-up.
    second_answer: the last answer that gave another value than the answer before it, and no request came between them: two
    devices have this node-ID.
    pdo: the last frame on a CAN-ID that the predefined connection set gives its TPDOs; it may be another node's. answer: the last
    SDO answer, to any client.
    """

    node_id: int
    time: Time | None
    service: HeardService | None
    state: NmtState | None
    state_time: Time | None
    emcy: EmcySeen | None
    answer: Seen | None
    unasked_answer: Seen | None
    late_answer: LateAnswer | None
    foreign_request: Seen | None
    pdo: Seen | None
    second_answer: Seen | None = None
    foreign_command: Seen | None = None


class Gap(NamedTuple):
    """Received frames that were lost before they came here. time: when that was noticed. lost: how many, at least. reason: where
    they were lost, for people."""

    time: Time
    lost: int
    reason: str


class BusKnowledge:
    """The memory of one Network. The Network itself writes `times`, `frames` (by CAN-ID) and `other`: this is its hot path.

    other: when the last frame without a slot came. hears_all: False if the transport filters. outage: why no frame passes at
    present, "" while the bus works. gap: the last frames that were lost on their way to us.
    """

    __slots__ = ("_given_up", "_late", "_second", "_unasked", "frames", "gap", "hears_all", "other", "outage", "times")

    def __init__(self) -> None:
        self.times: list[Time] = [_NOT_HEARD] * SLOTS
        self.frames: list[Frame | None] = [None] * SLOTS
        self.other: Time = _NOT_HEARD
        self.hears_all = True
        self.outage = ""
        self.gap: Gap | None = None
        # By node-ID, so at most 127 of each
        self._given_up: dict[int, tuple[Time, bytes]] = {}  # when, and the multiplexer
        self._unasked: dict[int, Seen] = {}
        self._second: dict[int, Seen] = {}
        self._late: dict[int, LateAnswer] = {}

    def on_given_up(self, node_id: int, index: int, subindex: int, now: Time) -> None:
        """Take note of a request that ended because no answer came in time."""
        self._given_up[node_id] = now, bytes((index & 0xFF, index >> 8, subindex))

    def on_ignored(self, frame: Frame, now: Time) -> None:
        """Take note of a frame that a client ignored. Called while the frame's slot still holds the one before."""
        node_id = frame.key - SDO_SERVER_TO_CLIENT
        if not (1 <= node_id <= MAX_NODE_ID and frame.data):
            return
        given_up = self._given_up.get(node_id)
        if given_up is not None:
            since, multiplexer = given_up
            if now - since > MAX_LATENESS:
                del self._given_up[node_id]
            elif _may_answer(frame.data, multiplexer):
                del self._given_up[node_id]
                self._late[node_id] = LateAnswer(now, now - since)
                return
        before = self.frames[frame.key]
        if before is not None and self._contradicts(node_id, frame, before, now):
            self._second[node_id] = Seen(now, frame)
        if before is None or before.data != frame.data or now - self.times[frame.key] > COPY_TIME:
            self._unasked[node_id] = Seen(now, frame)

    def _contradicts(self, node_id: int, frame: Frame, before: Frame, now: Time) -> bool:
        """Return whether an ignored answer gives another value of the object of the answer before it. A request of another client
        explains that, or one that is not heard."""
        key = SDO_SERVER_TO_CLIENT + node_id
        is_same = before.data[1:4] == frame.data[1:4] and before.data != frame.data
        are_values = before.data[:1] != b"" and all(
            each.data[0] & SPECIFIER == INITIATE_UPLOAD_RESPONSE for each in (before, frame)
        )
        was_asked = self.times[SDO_CLIENT_TO_SERVER + node_id] >= self.times[key] - SECOND
        return is_same and are_values and now - self.times[key] <= SECOND and self.hears_all and not was_asked

    @property
    def last_heard(self) -> Time | None:
        """When the last frame came, from any node; None if there was none yet."""
        last = max(*self.times, self.other)
        return None if last == _NOT_HEARD else last

    def time_of(self, can_id: int) -> Time | None:
        """Return when a frame of a CAN-ID last came; None if none came, or if it has no slot."""
        time = self.times[can_id] if 0 <= can_id < SLOTS else _NOT_HEARD
        return None if time == _NOT_HEARD else time

    def nodes(self) -> tuple[int, ...]:
        """Return the node-IDs that showed a sign of life (PDOs do not count), in order."""
        frames = self.frames  # what they say is not asked: that would take twenty times as long
        return tuple(
            node_id
            for node_id in ALL_NODE_IDS
            if frames[ERROR_CONTROL + node_id] is not None
            or frames[EMCY + node_id] is not None
            or frames[SDO_SERVER_TO_CLIENT + node_id] is not None
        )

    def heard(self, node_id: int) -> NodeHeard:
        """Return all that was heard of a node. Raises LocalProtocolError for a node-ID outside 1..127."""
        check_node_id(node_id)
        control, emcy = self._seen(ERROR_CONTROL + node_id), self._seen(EMCY + node_id)
        answer = self._seen(SDO_SERVER_TO_CLIENT + node_id)
        signs: list[tuple[Time, HeardService]] = []
        state: NmtState | None = None
        if control is not None:
            data = control.frame.data
            state = STATE_OF_BYTE[data[0]] if len(data) == 1 else None
            is_boot_up = state is NmtState.INITIALISING  # whatever its toggle bit, as for `HeartbeatConsumer`
            signs.append((control.time, HeardService.BOOT_UP if is_boot_up else HeardService.HEARTBEAT))
            if is_boot_up:  # after it the node is pre-operational: CiA 301 v4.2.0, 7.2.8.3.3
                state = NmtState.PRE_OPERATIONAL
        emergency: EmcySeen | None = None
        if emcy is not None:
            signs.append((emcy.time, HeardService.EMCY))
            if len(emcy.frame.data) >= 2:  # else it has no code; 0 would say that all errors are gone
                emergency = EmcySeen(emcy.time, int.from_bytes(emcy.frame.data[:2], "little"))
        if answer is not None:
            signs.append((answer.time, HeardService.SDO))
        time, service = max(signs, key=lambda sign: sign[0], default=(None, None))
        command = self._seen(NMT)
        pdos = [seen for base in TPDOS if (seen := self._seen(base + node_id)) is not None]
        return NodeHeard(
            node_id,
            time,
            service,
            state,
            control.time if control is not None and state is not None else None,
            emergency,
            answer,
            self._unasked.get(node_id),
            self._late.get(node_id),
            self._seen(SDO_CLIENT_TO_SERVER + node_id),
            max(pdos, key=lambda seen: seen.time, default=None),
            self._second.get(node_id),
            command if command is not None and command.frame.data[1:] in (b"\x00", bytes((node_id,))) else None,
        )

    def _seen(self, can_id: int) -> Seen | None:
        frame = self.frames[can_id]
        return None if frame is None else Seen(self.times[can_id], frame)


def _may_answer(data: bytes, multiplexer: bytes) -> bool:
    """Return whether an SDO answer may belong to a request for this mux. Answers within a transfer do not carry it."""
    specifier = data[0] & SPECIFIER
    if specifier in (INITIATE_UPLOAD_RESPONSE, INITIATE_DOWNLOAD_RESPONSE, ABORT):
        return data[1:4] == multiplexer
    return True
