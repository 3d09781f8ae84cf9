"""A DBC file of one device: its PDOs with signals, scales, units and signs; its heartbeat and its emergencies.

Log tools know DBC, and no EDS. DBC says less: a message has one fixed layout, and a named value is of a whole signal. So what a
device says beside its PDOs, and what of them has no place in a DBC, is in `left_out`.

Source: no standard describes DBC; the form is that which cantools and CANdb++ read and write (from memory). The text is written
here, not by a library: it is a table of messages, and cantools reads it back in the tests.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from canopen_proto import indices
from canopen_proto.datatypes import DataType, is_number, is_signed
from canopen_proto.dictionary import Direction, ObjectDictionary, Variable
from canopen_proto.frame import COB_ID_EXTENDED, COB_ID_INVALID, EMCY, ERROR_CONTROL
from canopen_proto.multiplexer import mux_text
from canopen_proto.nmt import NmtState
from canopen_proto.pdo.mapping import MappedEntry
from canopen_proto.pdo.mapping import Mapping as PdoMapping
from canopen_proto.pdo.settings import EVENT_TIMER, PdoSettings, communication_index
from canopen_proto.pdo.slots import number_in, slots_of

MAX_NAME: Final = 32
"""Characters of a name; a longer one is an attribute of its message or signal, too."""
NOBODY: Final = "Vector__XXX"
"""The node of a message that no node of the file sends."""
ENCODING: Final = "cp1252"
"""Of DBC files: units have degree signs."""
_EXTENDED: Final = 0x8000_0000
_MPDO: Final = (254, 255)
"""Counts of mapped objects that mean a multiplexed PDO (CiA 301 v4.2.0, 7.5.2.36)."""
_WORDS: Final = frozenset(("VERSION", "NS_", "BS_", "BU_", "BO_", "SG_", "CM_", "BA_", "BA_DEF_", "BA_DEF_DEF_", "VAL_", "EV_"))
_STATES: Final = {state.value: state.name.lower() for state in NmtState}
_HEAD: Final = """\
VERSION ""

NS_ :

BS_:

BU_: {node}

"""
_ATTRIBUTES: Final = """\
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "SystemMessageLongSymbol" STRING ;
BA_DEF_ SG_ "SystemSignalLongSymbol" STRING ;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "SystemMessageLongSymbol" "";
BA_DEF_DEF_ "SystemSignalLongSymbol" "";
"""


class LeftOut(NamedTuple):
    """What a DBC does not say. what: a PDO, an object, a service."""

    what: str
    reason: str


class DbcFile(NamedTuple):
    """A DBC. messages, signals: how many it has."""

    text: str
    messages: int
    signals: int
    left_out: tuple[LeftOut, ...]


class _Signal(NamedTuple):
    """A signal. name: as the device has it. start, bits: its place, the lowest bit first. values: its named values. kind: 0: a
    whole number, 1 and 2: a REAL32, a REAL64."""

    name: str
    start: int
    bits: int
    signed: bool = False
    factor: float = 1.0
    least: float | None = None
    most: float | None = None
    unit: str = ""
    values: Mapping[int, str] = {}
    comment: str = ""
    kind: int = 0


class _DbcMessage(NamedTuple):
    """A message. can_id: with bit 31 for one of 29 bits. size: bytes. cycle: ms; 0: no fixed time. is_sent: by the device."""

    name: str
    can_id: int
    size: int
    is_sent: bool
    signals: tuple[_Signal, ...]
    comment: str
    cycle: int = 0


def dbc_of(dictionary: ObjectDictionary, node_id: int, name: str = "") -> DbcFile:
    """Return the DBC of a device. node_id: 1..127. name: of the node in the file; by default "node5"."""
    left_out: list[LeftOut] = []
    node = _Names().take(name or f"node{node_id}")[0]
    messages = [*_pdos(dictionary, node_id, left_out), *_others(dictionary, node_id)]
    left_out.append(LeftOut("SDO, LSS, NMT commands, SYNC, TIME", "a DBC has no transfers, and these belong to no single device"))
    text = "".join(_lines(node, messages, left_out))
    return DbcFile(text, len(messages), sum(len(each.signals) for each in messages), tuple(left_out))


def _pdos(dictionary: ObjectDictionary, node_id: int, left_out: list[LeftOut]) -> Iterator[_DbcMessage]:
    taken: dict[int, str] = {}
    for slot in slots_of(dictionary, node_id):
        pdo = slot.pdo
        mapping_count = number_in(dictionary, communication_index(*pdo.place) + 0x200, 0, node_id) or 0
        can_id = pdo.cob_id & 0x1FFF_FFFF
        if not pdo.is_valid:
            reason = "it is not valid (bit 31 of its COB-ID)"
        elif mapping_count in _MPDO:
            reason = "it is multiplexed (MPDO): each frame names its object"
        elif not slot.is_described:
            reason = "its mapping is empty, or cannot be"
        elif can_id in taken:
            reason = f"{taken[can_id]} has its CAN-ID 0x{can_id:X}"
        else:
            taken[can_id] = pdo.name
            yield _pdo(dictionary, node_id, pdo, can_id, left_out)
            continue
        left_out.append(LeftOut(pdo.name, reason))


def _pdo(dictionary: ObjectDictionary, node_id: int, pdo: PdoSettings, can_id: int, left_out: list[LeftOut]) -> _DbcMessage:
    mapping = PdoMapping.from_parameters(pdo.entries, dictionary)
    labels = iter(mapping.labels)
    signals, start = [], 0
    for entry in mapping.entries:
        if not entry.is_dummy:
            variable = dictionary.at(entry.index, entry.subindex)
            signals.append(_signal(dictionary, variable, entry, next(labels), start, left_out))
        start += entry.bit_length
    timer = number_in(dictionary, communication_index(*pdo.place), EVENT_TIMER, node_id) or 0
    is_sent = pdo.direction is Direction.TPDO
    comment = f"{pdo.name} of node {node_id}, transmission type {pdo.transmission_type}"
    number = can_id | (_EXTENDED if pdo.cob_id & COB_ID_EXTENDED else 0)
    name = f"{pdo.name.replace(' ', '')}_{node_id}"
    return _DbcMessage(name, number, mapping.byte_length, is_sent, tuple(signals), comment, timer if is_sent else 0)


def _signal(
    dictionary: ObjectDictionary, variable: Variable, entry: MappedEntry, label: str, start: int, left_out: list[LeftOut]
) -> _Signal:
    kind = {DataType.REAL32: 1, DataType.REAL64: 2}.get(entry.data_type, 0)
    if not is_number(entry.data_type) and entry.data_type is not DataType.BOOLEAN:
        left_out.append(LeftOut(variable.label, f"its type {entry.data_type.name}: it stands there as a whole number"))
    whole = (1 << entry.bit_length) - 1
    constants = dictionary.constants_of(variable)
    values = {
        _as_signed(each.value, entry.bit_length, is_signed(entry.data_type)): each.name
        for each in constants
        if each.mask & whole == whole
    }
    bits = [f"{each.name} (0x{each.mask:X})" for each in constants if each.mask & whole != whole]
    if bits:
        left_out.append(LeftOut(variable.label, f"its {len(bits)} named bits: a DBC names values of whole signals"))
    comment = "; ".join([f"{mux_text(variable.mux)} {variable.name}", *([f"bits: {', '.join(bits)}"] if bits else [])])
    holder = dictionary.objects.get(variable.index)
    name = label if holder is None or len(holder.variables) == 1 or ":" in label else f"{holder.name}_{label}"
    return _Signal(
        name,
        start,
        entry.bit_length,
        is_signed(entry.data_type),
        variable.factor,
        _number(variable.low_limit),
        _number(variable.high_limit),
        variable.unit,
        values,
        comment,
        kind,
    )


def _others(dictionary: ObjectDictionary, node_id: int) -> Iterator[_DbcMessage]:
    """Yield what a device says beside its PDOs, as far as it has the objects of it."""
    if dictionary.get(indices.PRODUCER_HEARTBEAT_TIME, 0) is not None:
        period = number_in(dictionary, indices.PRODUCER_HEARTBEAT_TIME, 0, node_id) or 0
        state = _Signal("state", 0, 7, values=_STATES, comment="the NMT state; boot-up is 0 (initialising)")
        name = f"heartbeat_{node_id}"
        yield _DbcMessage(name, ERROR_CONTROL + node_id, 1, True, (state,), f"heartbeat and boot-up of node {node_id}", period)
    if dictionary.get(indices.COB_ID_EMERGENCY, 0) is not None:
        cob_id = number_in(dictionary, indices.COB_ID_EMERGENCY, 0, node_id)
        cob_id = EMCY + node_id if cob_id is None else cob_id
        if not cob_id & COB_ID_INVALID:
            signals = (
                _Signal("error_code", 0, 16, comment="CiA 301 v4.2.0, table 26; 0: no error any more"),
                _Signal("error_register", 16, 8, comment="0x1001"),
                _Signal("manufacturer_specific", 24, 40),
            )
            can_id = cob_id & 0x1FFF_FFFF | (_EXTENDED if cob_id & COB_ID_EXTENDED else 0)
            yield _DbcMessage(f"emergency_{node_id}", can_id, 8, True, signals, f"emergencies of node {node_id}")


def _lines(node: str, messages: list[_DbcMessage], left_out: list[LeftOut]) -> Iterator[str]:
    yield _HEAD.format(node=node)
    comments, cycles, values, kinds = [], [], [], []
    names = _Names()
    for message in messages:
        name, is_cut = names.take(message.name)
        own = _Names()
        sender, receiver = (node, NOBODY) if message.is_sent else (NOBODY, node)
        yield f"BO_ {message.can_id} {name}: {message.size} {sender}\n"
        comments.append(f'CM_ BO_ {message.can_id} "{_text(message.comment)}";\n')
        if is_cut:
            cycles.append(f'BA_ "SystemMessageLongSymbol" BO_ {message.can_id} "{_text(message.name)}";\n')
        if message.cycle:
            cycles.append(f'BA_ "GenMsgCycleTime" BO_ {message.can_id} {message.cycle};\n')
        for each in message.signals:
            signal, is_cut = own.take(each.name)
            yield f" SG_ {signal} : {each.start}|{each.bits}@1{'-' if each.signed or each.kind else '+'} ({each.factor:.17g},0) "
            yield f'[{_limit(each, each.least)}|{_limit(each, each.most)}] "{_text(each.unit)}" {receiver}\n'
            if each.comment:
                comments.append(f'CM_ SG_ {message.can_id} {signal} "{_text(each.comment)}";\n')
            if is_cut:
                long = re.sub(r"\W", "_", each.name, flags=re.ASCII)
                cycles.append(f'BA_ "SystemSignalLongSymbol" SG_ {message.can_id} {signal} "{long}";\n')
            if each.values:
                pairs = " ".join(f'{number} "{_text(word)}"' for number, word in sorted(each.values.items()))
                values.append(f"VAL_ {message.can_id} {signal} {pairs} ;\n")
            if each.kind:
                kinds.append(f"SIG_VALTYPE_ {message.can_id} {signal} : {each.kind};\n")
            if each.unit != _text(each.unit):
                left_out.append(LeftOut(f"the unit of {each.name}", "characters that a DBC cannot have"))
        yield "\n"
    yield from (*comments, _ATTRIBUTES, *cycles, *values, *kinds)


class _Names:
    """Names that a DBC can have, each once: letters, digits and underscores, no longer than MAX_NAME."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def take(self, name: str) -> tuple[str, bool]:
        """Return the name in the DBC for that of an object or a PDO, and whether it was cut."""
        whole = re.sub(r"\W", "_", name, flags=re.ASCII) or "_"
        if whole[0].isdigit() or whole in _WORDS:
            whole = f"_{whole}"
        made, number = whole[:MAX_NAME], 1
        while made in self._taken:
            number += 1
            made = f"{whole[: MAX_NAME - len(str(number)) - 1]}_{number}"
        self._taken.add(made)
        return made, len(whole) > MAX_NAME


def _as_signed(value: int, bits: int, signed: bool) -> int:
    value &= (1 << bits) - 1
    return value - (1 << bits) if signed and value >> bits - 1 else value


def _number(value: object) -> float | None:
    return value if isinstance(value, int | float) else None


def _limit(signal: _Signal, value: float | None) -> str:
    """Return a limit in the unit of the signal. Both are 0 where none is known: [0|0] says so."""
    if signal.least is None or signal.most is None or value is None:
        return "0"
    return f"{value * signal.factor:.17g}"


def _text(text: str) -> str:
    """Return a text that may stand between quotes: in the file's encoding, in one line."""
    shown = "".join(each if each.isprintable() else " " for each in text).replace('"', "'").replace("\\", "/")
    return shown.encode(ENCODING, "replace").decode(ENCODING)
