"""Check COB-IDs: none uses a restricted CAN-ID, and no two services of the device share one.

The CAN-IDs are compared as they are after start-up, in a device with the commissioned node-ID. If none is commissioned, CAN-IDs
that depend on the node-ID are compared only among themselves, and so are the fixed ones.

Source: CiA 301 v4.2.0, 7.3.5 (predefined connection set, restricted CAN-IDs) and 7.5.2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from canopen_data.checks.subject import ERROR, WARNING, Number, Rule, Subject
from canopen_data.description import FileKind
from canopen_data.findings import Finding
from canopen_proto import indices
from canopen_proto.cob_id import RESTRICTED_CAN_IDS
from canopen_proto.dictionary.model import Variable
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID, MAX_NODE_ID
from canopen_proto.pdo.settings import COB_ID, place_of

DEFAULT_REQUESTS: Final = range(0x601, 0x680)
DEFAULT_RESPONSES: Final = range(0x581, 0x600)
"""The default SDO channel of each node; a client for it uses these CAN-IDs."""

PREDEFINED: Final = {
    indices.COB_ID_EMERGENCY: 0x080,
    **{indices.RPDO1_COMMUNICATION_PARAMETER + number: 0x200 + 0x100 * number for number in range(4)},
    **{indices.TPDO1_COMMUNICATION_PARAMETER + number: 0x180 + 0x100 * number for number in range(4)},
}
"""CAN-IDs that the node-ID is added to by default (CiA 301 v4.2.0, 7.3.5, table 39)."""

RULES: Final = (
    Rule("cob-id-restricted", ERROR, "a COB-ID on a CAN-ID that is kept for something else"),
    Rule("cob-id-clash", WARNING, "two services of the device use one CAN-ID"),
    Rule("cob-id-fixed", WARNING, "a CAN-ID of the predefined connection set without $NODEID: the same in every such device"),
)


class _Use(NamedTuple):
    """One COB-ID in use. restricts: whether restricted CAN-IDs are forbidden to it. also: the exceptions, which it may have."""

    variable: Variable
    cob_id: Number
    service: str
    restricts: bool = True
    also: range = range(0)

    @property
    def can_id(self) -> int:
        """The CAN-ID with the frame bit, so that 11 and 29 bits differ."""
        return self.cob_id.value & (0x1FFF_FFFF | COB_ID_EXTENDED)


def check_cob_ids(subject: Subject) -> Iterator[Finding]:
    """Check all COB-IDs that are in use after start-up."""
    seen: dict[tuple[int, bool], _Use] = {}
    for use in _uses(subject):
        if use.restricts:
            yield from _check_restricted(subject, use)
        yield from _check_fixed(subject, use)
        key = use.can_id, use.cob_id.adds_node_id
        first = seen.setdefault(key, use)
        if first is not use:
            where = f"{first.variable.index:04X}:{first.variable.subindex:02X}"
            text = f"{use.service} has COB-ID {use.cob_id}, which {first.service} ({where}) has already"
            yield subject.of_value("cob-id-clash", use.variable, text)


def _uses(subject: Subject) -> Iterator[_Use]:
    """Yield every COB-ID in use, beginning with the services that a device has once."""
    for index, service, bits in (
        (indices.COB_ID_SYNC, "SYNC", 0),
        (indices.COB_ID_TIME_STAMP, "TIME", 0),
        (indices.COB_ID_EMERGENCY, "EMCY", COB_ID_INVALID),
    ):
        yield from _use(subject, index, 0, service, bits)
    for index in subject.dictionary.objects:
        place = place_of(index)
        if index in indices.SDO_SERVERS or index in indices.SDO_CLIENTS:
            side = "SDO server" if index in indices.SDO_SERVERS else "SDO client"
            for subindex, default in ((1, DEFAULT_REQUESTS), (2, DEFAULT_RESPONSES)):
                also = default if index in indices.SDO_CLIENTS else range(0)
                for use in _use(
                    subject, index, subindex, f"{side} 0x{index:04X}", COB_ID_INVALID, index != indices.SDO_SERVER_PARAMETER
                ):
                    yield use._replace(also=also)
        elif place is not None and not place.is_mapping:
            yield from _use(subject, index, COB_ID, f"{place.direction}{place.number}", COB_ID_INVALID)


def _use(subject: Subject, index: int, subindex: int, service: str, unused: int, restricts: bool = True) -> Iterator[_Use]:
    """Yield a COB-ID if it is in use. unused: the bit that means "not in use". So does a value of 0: many files have it there."""
    cob_id = subject.number(index, subindex)
    if cob_id is None or cob_id.value & unused or not (cob_id.value or cob_id.adds_node_id):
        return
    yield _Use(subject.dictionary.variable((index, subindex)), cob_id, service, restricts)


def _check_restricted(subject: Subject, use: _Use) -> Iterator[Finding]:
    if use.can_id & COB_ID_EXTENDED:
        return
    for can_id in (use.can_id + 1, use.can_id + MAX_NODE_ID) if use.cob_id.adds_node_id else (use.can_id,):
        if can_id > 0x7FF:
            text = f"{use.service} has COB-ID {use.cob_id}: CAN-ID 0x{can_id:X} has more than 11 bits, and bit 29 is 0"
        elif can_id not in use.also and any(can_id in each for each in RESTRICTED_CAN_IDS):
            text = f"{use.service} has COB-ID {use.cob_id}: CAN-ID 0x{can_id:03X} is restricted (CiA 301, table 40)"
        else:
            continue
        yield subject.of_value("cob-id-restricted", use.variable, text)
        return


def _check_fixed(subject: Subject, use: _Use) -> Iterator[Finding]:
    """Check a file of a device type for CAN-IDs that are right for one node-ID only."""
    if use.cob_id.adds_node_id or subject.description.kind in (FileKind.DCF, FileKind.XDC):
        return
    base = PREDEFINED.get(use.variable.index)
    if base is not None and base <= use.can_id <= base + MAX_NODE_ID:
        node = f"right for node {use.can_id - base} only" if use.can_id > base else "the same in all nodes"
        text = f"{use.service} has COB-ID {use.cob_id}, which is {node}; $NODEID+0x{base:X} is right in each"
        yield subject.of_value("cob-id-fixed", use.variable, text)


CHECKS: Final[tuple[Callable[[Subject], Iterator[Finding]], ...]] = (check_cob_ids,)
