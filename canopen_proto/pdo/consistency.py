"""The PDOs of several nodes compared: who sends one to whom on a bus, and which of them contradict each other.

`flows_of` puts the PDOs of all nodes together by their CAN-ID, `check_pdos` says what is wrong. A finding is an error, which a
device notices or suffers from, or a remark, which may be meant: a TPDO that no node takes may be for the master, which is no
node here.

Rules of one PDO: its CAN-ID is restricted (CiA 301 v4.2.0, 7.3.5), it has more than 64 bits, it exists and carries nothing, an
object stands in two RPDOs of a node. Rules of a flow: two nodes send it; a receiver takes more bytes than come, and so ignores
the frame (emergency 0x8210), or fewer, and ignores the rest (0x8220; both from memory of 7.2.7.1); the borders between the
objects differ. A multiplexed PDO has no mapping, and is not looked into.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Final, NamedTuple

from canopen_proto.cob_id import check_can_id
from canopen_proto.dictionary import Direction
from canopen_proto.frame import RoutingKey
from canopen_proto.multiplexer import Mux, index_of, mapped, mux_text
from canopen_proto.pdo.mapping import LAST_DUMMY_INDEX, MAX_BITS
from canopen_proto.pdo.settings import PdoSettings, muxes_of


class PdoEnd(NamedTuple):
    """A PDO at one of its ends. node_id: whose it is."""

    node_id: int
    pdo: PdoSettings

    def __str__(self) -> str:
        return f"{self.pdo.name} of node {self.node_id}"


class PdoFlow(NamedTuple):
    """The PDOs with one CAN-ID. senders: TPDOs. receivers: RPDOs. Both in the order of their node-IDs."""

    key: RoutingKey
    senders: tuple[PdoEnd, ...]
    receivers: tuple[PdoEnd, ...]


class PdoFinding(NamedTuple):
    """One thing that a comparison has found. rule: its name in RULES. ends: the PDOs that it is about. is_error: whether
    it is an error, and no remark."""

    rule: str
    ends: tuple[PdoEnd, ...]
    text: str
    is_error: bool


RULES: Final = {
    "restricted": "the CAN-ID is that of another service",
    "too long": "more than 64 bits are mapped",
    "two senders": "two nodes send with one CAN-ID",
    "too short": "fewer bytes are sent than a receiver takes: it ignores the PDO",
    "set twice": "an object stands in two RPDOs of a node, which contradict each other",
    "rest ignored": "more bytes are sent than a receiver takes",
    "other borders": "sender and receiver divide the bytes differently",
    "empty": "the PDO exists, and carries nothing",
    "unheard": "no node takes it: is it for the master?",
    "unsent": "no node sends it: does the master?",
}
"""The names of all rules, those of errors first."""


def flows_of(pdos: Mapping[int, Sequence[PdoSettings]]) -> list[PdoFlow]:
    """Return who sends what to whom, in the order of the CAN-IDs. pdos: by node-ID; those that are not valid are left out."""
    ends: defaultdict[RoutingKey, tuple[list[PdoEnd], list[PdoEnd]]] = defaultdict(lambda: ([], []))
    for node_id in sorted(pdos):
        for pdo in pdos[node_id]:
            if pdo.is_valid:
                ends[pdo.key][pdo.direction is Direction.RPDO].append(PdoEnd(node_id, pdo))
    return [PdoFlow(key, tuple(senders), tuple(receivers)) for key, (senders, receivers) in sorted(ends.items())]


def check_pdos(pdos: Mapping[int, Sequence[PdoSettings]]) -> list[PdoFinding]:
    """Return what is wrong with the PDOs of several nodes, by CAN-ID; then the objects that are set twice. pdos: by node-ID."""
    found: list[PdoFinding] = []
    for flow in flows_of(pdos):
        for end in (*flow.senders, *flow.receivers):
            found += _of_one(end)
        found += _of_flow(flow)
    for node_id in sorted(pdos):
        found += _set_twice([PdoEnd(node_id, each) for each in pdos[node_id] if _is_live_rpdo(each)])
    return found


def _of_one(end: PdoEnd) -> list[PdoFinding]:
    found = []
    pdo = end.pdo
    if check_can_id(pdo.cob_id) is not None:
        found.append(PdoFinding("restricted", (end,), f"{end} has the CAN-ID {pdo.can_id_text}, which no PDO may have", True))
    if pdo.bits > MAX_BITS:
        found.append(PdoFinding("too long", (end,), f"{end} maps {pdo.bits} bits; a frame has {MAX_BITS}", True))
    if not pdo.entries:
        found.append(PdoFinding("empty", (end,), f"{end} ({pdo.can_id_text}) carries nothing", False))
    return found


def _of_flow(flow: PdoFlow) -> list[PdoFinding]:
    found = []
    name = (flow.senders or flow.receivers)[0].pdo.can_id_text
    if len(flow.senders) > 1:
        text = f"{name} is sent by {' and '.join(map(str, flow.senders))}"
        found.append(PdoFinding("two senders", flow.senders, text, True))
    for sender in flow.senders:
        if not flow.receivers:
            found.append(PdoFinding("unheard", (sender,), f"{sender} ({name}) is taken by no node", False))
        for receiver in flow.receivers:
            found += _of_pair(sender, receiver)
    if not flow.senders:
        found += [PdoFinding("unsent", (each,), f"{each} ({name}) is sent by no node", False) for each in flow.receivers]
    return found


def _of_pair(sender: PdoEnd, receiver: PdoEnd) -> list[PdoFinding]:
    if not (sender.pdo.entries and receiver.pdo.entries):
        return []  # told already, or multiplexed
    ends = (sender, receiver)
    sent, taken = sender.pdo.size, receiver.pdo.size
    if sent < taken:
        return [PdoFinding("too short", ends, f"{sender} sends {sent} bytes, {receiver} takes {taken}: it ignores them", True)]
    found = []
    if sent > taken:
        found.append(PdoFinding("rest ignored", ends, f"{sender} sends {sent} bytes, {receiver} takes the first {taken}", False))
    if not _borders(receiver.pdo) <= _borders(sender.pdo):
        text = f"{sender} divides its bytes as {_widths(sender.pdo)} bits, {receiver} as {_widths(receiver.pdo)}"
        found.append(PdoFinding("other borders", ends, text, False))
    return found


def _borders(pdo: PdoSettings) -> set[int]:
    """Return the bits at which an object begins or ends that is no filler."""
    ends = list(accumulate((bits for _, _, bits in map(mapped, pdo.entries)), initial=0))
    shown = [index > LAST_DUMMY_INDEX for index, _, _ in map(mapped, pdo.entries)]
    return {each for number, is_shown in enumerate(shown) if is_shown for each in ends[number : number + 2]}


def _widths(pdo: PdoSettings) -> str:
    return "+".join(str(bits) for _, _, bits in map(mapped, pdo.entries))


def _is_live_rpdo(pdo: PdoSettings) -> bool:
    return pdo.is_valid and pdo.direction is Direction.RPDO


def _set_twice(rpdos: Sequence[PdoEnd]) -> list[PdoFinding]:
    carried: defaultdict[Mux, list[PdoEnd]] = defaultdict(list)
    for end in rpdos:
        for key in muxes_of(end.pdo.entries):
            if index_of(key) > LAST_DUMMY_INDEX:
                carried[key].append(end)
    return [
        PdoFinding("set twice", tuple(ends), f"{mux_text(key)} is set by {' and '.join(map(str, ends))}", True)
        for key, ends in sorted(carried.items())
        if len(ends) > 1
    ]
