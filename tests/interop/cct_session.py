"""The published session of CiA's conformance test tool (CCT) with a C stack's demo device, and how it is replayed to our device.

The session is not part of the repository: it is looked for where the recorded sessions are (see `recorded`), with the EDS that
the tool had; without both the tests are skipped.

It has no time stamps, only an order: what the tool sent, what the device sent, the case, the verdict. So the order makes the
time: what the tool sent is heard at once; for what the recorded device sent, time passes until ours sends a frame with that
CAN-ID too. Frames are compared for each CAN-ID by itself, as they come. How often something comes that goes by a timer is no
difference: how long the tool listened nobody wrote down.
"""

from __future__ import annotations

import re
import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import pytest

from canopen_data.description import DeviceDescription
from canopen_data.reading import read_description
from canopen_proto.datatypes import Value
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import EMCY, ERROR_CONTROL, SDO_CLIENT_TO_SERVER, SDO_SERVER_TO_CLIENT, Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtState, NmtStateChanged
from canopen_proto.sdo.events import ObjectAccessPending
from tests.interop.recorded import FOLDER, VARIABLE

SESSION, EDS = "cct-session.txt", "cct-device.eds"
NODE_ID: Final = 4
OTHER_NODES = ("081#",)
"""Where frames of other nodes begin that were recorded among the device's."""

PATIENCE: Final = 2 * SECOND
"""The longest time that ours gets to send what goes by a timer; the tool sets no longer one that it waits for."""
TOOL_HEARTBEAT: Final = 900 * MILLISECOND
"""At least so far apart are the heartbeats by which the tool is monitored; the first one of a node comes so late, too. (It sends
11 or 12 in 10 s.)"""

APPLICATION: Final[Mapping[tuple[int, int], Value]] = {
    (0x1008, 0): "CANopenDemoPIC32",
    (0x1009, 0): "---",
    (0x100A, 0): "---",
    (0x2106, 0): 1,
    (0x2120, 5): struct.unpack("<d", bytes.fromhex("EE242C4158245143"))[0],
    (0x2121, 3): bytes.fromhex("C83DBB").ljust(10, b"\0"),
    (0x2122, 0): bytes(range(256)) * 4,
    (0x6000, 1): 0xFF,
    **{(0x6401, number): 0x3FF for number in (*range(1, 7), *range(9, 17))},
}
"""What the demo's application had set, and no file tells."""


class Difference(NamedTuple):
    """Where our device answers otherwise, and why both may.

    case: its number. theirs, ours: regular expressions for a whole frame in candump's notation; "" for none.
    """

    case: str
    theirs: str
    ours: str
    why: str

    def explains(self, case: str, theirs: str, ours: str) -> bool:
        """Whether it is this one."""
        return case == self.case and bool(re.fullmatch(self.theirs, theirs)) and bool(re.fullmatch(self.ours, ours))


@dataclass
class Session:
    """The record. verdicts: the tool's, by case. lines: case, sign and frame, in order; `>`: sent by the tool, `<`: by the
    device."""

    verdicts: dict[str, str] = field(default_factory=dict)
    lines: list[tuple[str, str, str]] = field(default_factory=list)


def load_session() -> Session:
    """The record; the test is skipped where there is none."""
    session, case = Session(), ""
    for line in _read(SESSION).decode().splitlines():
        sign, _, text = line.partition(" ")
        if sign == "#":
            case = text.split()[0]
        elif sign == "=":
            session.verdicts[case] = text
        elif not text.startswith(OTHER_NODES):
            session.lines.append((case, sign, text))
    return session


def load_device() -> DeviceDescription:
    """The tool's EDS of the device; the test is skipped where there is none."""
    return read_description(_read(EDS), EDS)


def _read(name: str) -> bytes:
    path = FOLDER / name
    if not path.exists():
        pytest.skip(f"no recorded session {name}: {FOLDER} has none (${VARIABLE} names another folder)")
    return path.read_bytes()


def with_application(dictionary: ObjectDictionary) -> ObjectDictionary:
    """The dictionary with the values of the demo's application."""
    objects = dict(dictionary.objects)
    for (index, subindex), value in APPLICATION.items():
        variables = dict(objects[index].variables)
        variables[subindex] = replace(variables[subindex], default=value)
        objects[index] = replace(objects[index], variables=variables)
    return ObjectDictionary(objects.values())


class Replay:
    """Our device in the place of the recorded one. differences: (case, theirs, ours) as they came, of whole frames."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self.network = Network()
        self.node = LocalNode(self.network.out, NODE_ID, with_application(dictionary))
        self.network.attach(self.node)
        self.now: Time = 0
        self.differences: list[tuple[str, str, str]] = []
        self.matched = 0
        self._waiting: defaultdict[int, list[str]] = defaultdict(list)  # sent by ours, by CAN-ID, and not compared yet
        self._seen: set[str] = set()  # what ours sent in this case
        self._heartbeats: dict[int, Time] = {}  # of the tool: when it sent the last one
        self.node.boot(self.now)
        self._pump()
        self._waiting.clear()

    def play(self, session: Session, table: tuple[Difference, ...]) -> None:
        """Go through the record. An emergency message that ours does not send, as the table says, is not waited for."""
        case = ""
        for now_case, sign, text in session.lines:
            if now_case != case:
                self._end(case)
                case = now_case
            frame = Frame.parse(text)
            if sign == ">":
                self._hear(frame)
            elif frame.can_id == EMCY + NODE_ID and any(each.explains(case, text, "") for each in table):
                self.differences.append((case, text, ""))
            else:
                self._compare(case, frame.can_id, text)
        self._end(case)

    def _hear(self, frame: Frame) -> None:
        self._advance(self.now + MILLISECOND)
        if frame.can_id == SDO_CLIENT_TO_SERVER + NODE_ID:
            self._forget_repetitions()  # it is about something else from now on
            self._heartbeats.clear()
        if ERROR_CONTROL < frame.can_id < ERROR_CONTROL + 0x80:
            self._advance(self._heartbeats.get(frame.can_id, self.now) + TOOL_HEARTBEAT)
            self._heartbeats[frame.can_id] = self.now
        self.network.receive(frame, self.now)
        self._pump()

    def _compare(self, case: str, can_id: int, theirs: str) -> None:
        """Our next frame with that CAN-ID, which should be theirs."""
        by_request = can_id == SDO_SERVER_TO_CLIENT + NODE_ID
        end = self.now + (0 if by_request else PATIENCE)
        while not self._waiting[can_id] and self.network.next_deadline() <= end:
            self._advance(self.network.next_deadline())
        ours = self._waiting[can_id].pop(0) if self._waiting[can_id] else ""
        if ours == theirs:
            self.matched += 1
        else:
            self.differences.append((case, theirs, ours))
        self._seen.add(ours)

    def _end(self, case: str) -> None:
        """What ours sent more than theirs, but for repetitions."""
        self._forget_repetitions()
        self.differences += [(case, "", text) for texts in self._waiting.values() for text in texts]
        self._waiting.clear()
        self._seen.clear()

    def _forget_repetitions(self) -> None:
        for can_id, texts in self._waiting.items():
            self._waiting[can_id] = [text for text in texts if text not in self._seen]

    def _advance(self, to: Time) -> None:
        while (deadline := self.network.next_deadline()) <= to:
            self.now = max(self.now, deadline)
            self.network.handle_timeout(self.now)
            self._pump()
        self.now = max(self.now, to)

    def _pump(self) -> None:
        busy = True
        while busy:
            frames, events = self.network.drain(self.now)
            for frame in frames:
                self._waiting[frame.can_id].append(str(frame))
            for event in events:
                if isinstance(event, ObjectAccessPending):  # to store
                    self.node.complete(event.access_id, None, self.now)
                elif isinstance(event, NmtStateChanged) and event.state is NmtState.OPERATIONAL:
                    for producer in self.node.pdos.producers.values():  # the demo sends its inputs then, as CiA 401 has it
                        producer.trigger(self.now)
            busy = bool(events)


def unexplained(replay: Replay, table: tuple[Difference, ...]) -> Iterator[str]:
    """The differences that no entry of the table explains, and the entries that explain none."""
    unused = set(table)
    for case, theirs, ours in replay.differences:
        found = [each for each in table if each.explains(case, theirs, ours)]
        if not found:
            yield f"{case}: {theirs or 'nothing'} was recorded, ours sent {ours or 'nothing'}"
        unused.difference_update(found)
    for entry in unused:
        yield f"no such difference any more: {entry}"
