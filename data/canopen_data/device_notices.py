"""Tell which parts of a device's description do not work in its `LocalNode`, and why: for a user with somebody else's file.

Any dictionary makes a device that boots and answers. A fault in it disables just the service that it concerns. The bus shows
nothing of this, since a peer could not help; `notices_of` reports it. It looks at the description and at the present values
(before `boot`: those at power-on), and names

    values        a default that its type cannot hold, and the value used instead
    types         a communication object whose type is not the standard's: it may be too small (a COB-ID of 16 bits), or be
of no use to the service (text)
    COB-IDs       a CAN-ID that its service must not use; two services of the device on one CAN-ID
    PDOs          a record without COB-ID, a mapping that is impossible or empty, a reserved transmission type
    SDO           a record of a further channel (0x1201 and on) with CAN-IDs that it must not use
    storage       0x1010 and 0x1011 without a subindex that stores

Mere bad style (names, mandatory objects, limits) is left to the linter.

Source: CiA 301 v4.2.0, 7.3.5 and 7.5.2.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import Final

from canopen_proto import indices
from canopen_proto.cob_id import check_can_id, is_valid
from canopen_proto.datatypes import DataType, Value, is_integer, is_signed, size_of
from canopen_proto.dictionary import Direction, Values, Variable
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.dictionary.values import nearest
from canopen_proto.frame import COB_ID_INVALID, EMCY, KEY_EXTENDED, SYNC, key_of_cob_id
from canopen_proto.local_node import LocalNode
from canopen_proto.multiplexer import mux
from canopen_proto.pdo.consumer import LAST_SYNCHRONOUS
from canopen_proto.pdo.mapping import number_at
from canopen_proto.pdo.parameters import DevicePdos
from canopen_proto.pdo.producer import FIRST_EVENT_DRIVEN, SYNCHRONOUS_ON_REQUEST
from canopen_proto.pdo.settings import COB_ID, TRANSMISSION_TYPE, communication_index, mapping_index, place_of
from canopen_proto.sdo.channels import TO_CLIENT, TO_SERVER, SdoChannels, channel_of

__all__ = ["Notice", "notices_of"]

MAX_NOTICES: Final = 100
"""More than anybody reads. A file that is not an EDS at all could have one for each of its thousands of objects."""

_EFFECTIVE: Final = frozenset({
    indices.ERROR_REGISTER, indices.PREDEFINED_ERROR_FIELD, indices.COB_ID_SYNC, indices.COMMUNICATION_CYCLE_PERIOD,
    indices.SYNCHRONOUS_WINDOW_LENGTH, indices.GUARD_TIME, indices.LIFE_TIME_FACTOR, indices.STORE_PARAMETERS,
    indices.RESTORE_DEFAULT_PARAMETERS, indices.COB_ID_TIME_STAMP, indices.COB_ID_EMERGENCY,
    indices.INHIBIT_TIME_EMERGENCY, indices.CONSUMER_HEARTBEAT_TIME, indices.PRODUCER_HEARTBEAT_TIME,
    indices.SYNCHRONOUS_COUNTER_OVERFLOW_VALUE, indices.EMERGENCY_CONSUMER, indices.ERROR_BEHAVIOR,
})  # fmt: skip
"""The communication objects that a LocalNode obeys, besides those of PDOs and SDO channels."""

_COB_ID_SYNC: Final = mux(indices.COB_ID_SYNC)
_COB_ID_TIME: Final = mux(indices.COB_ID_TIME_STAMP)
_COB_ID_EMCY: Final = mux(indices.COB_ID_EMERGENCY)
_TIME_IN_USE: Final = 0xC000_0000


@dataclass(frozen=True, slots=True)
class Notice:
    """One thing that does not work. index, subindex: of the object concerned; subindex None: the whole object."""

    index: int
    subindex: int | None
    text: str

    def __str__(self) -> str:
        where = f"0x{self.index:04X}" if self.subindex is None else f"0x{self.index:04X}:{self.subindex:02X}"
        return f"{where}: {self.text}"


def notices_of(node: LocalNode) -> tuple[Notice, ...]:
    """Return what does not work in a device with its present values: by index, MAX_NOTICES at most."""
    checks: tuple[Callable[[int, Values, DevicePdos], Iterator[Notice]], ...] = (
        _values,
        _types,
        _cob_ids,
        _pdos,
        _channels,
        _storage,
    )
    found = [notice for check in checks for notice in islice(check(node.values.node_id, node.values, node.pdos), MAX_NOTICES)]
    return tuple(sorted(found, key=lambda each: (each.index, each.subindex or 0))[:MAX_NOTICES])


def _values(node_id: int, values: Values, pdos: DevicePdos) -> Iterator[Notice]:
    for variable in values.unfit:
        value = variable.initial_of(node_id)
        is_text = isinstance(nearest(variable, value), str) and isinstance(value, str)
        instead = "its UTF-8 bytes are used instead" if is_text else "it is zero instead"
        yield _about(variable, f"{variable.data_type.name} cannot hold {_show(value)}, its value at power-on: {instead}")


def _show(value: Value) -> str:
    """Return a value as short text: texts and numbers of a file may be long."""
    if isinstance(value, int):
        return f"{value:#x}" if value.bit_length() <= 64 else f"an integer of {value.bit_length()} bits"
    return repr(value)[:40]


def _types(node_id: int, values: Values, pdos: DevicePdos) -> Iterator[Notice]:
    for variable in values.dictionary:
        index = variable.index
        if index not in _EFFECTIVE and place_of(index) is None:
            continue
        standard = find_standard(index, variable.subindex)
        if standard is None or variable.data_type == standard.data_type or not is_integer(standard.data_type):
            continue
        if not is_integer(variable.data_type):
            effect = "it has no effect"
        elif _size(variable.data_type) < _size(standard.data_type) or is_signed(variable.data_type):
            effect = "it has no room for every value"
        else:
            continue  # wider: every value fits, and a service takes what it can
        yield _about(variable, f"{variable.data_type.name}, not {standard.data_type.name} as in CiA 301: {effect}")


def _size(data_type: DataType) -> int:
    return size_of(data_type) or 0


def _cob_ids(node_id: int, values: Values, pdos: DevicePdos) -> Iterator[Notice]:
    """Yield a notice for each CAN-ID that its service must not use, or that two services share."""
    store = values.store
    used: dict[int, tuple[str, bool]] = {}

    def take(index: int, key: int, user: str, sends: bool) -> Iterator[Notice]:
        other = used.setdefault(key, (user, sends))
        if other[0] != user and (sends or other[1]):
            can_id = key & ~KEY_EXTENDED
            yield Notice(index, None, f"{user} and {other[0]} share the CAN-ID 0x{can_id:X}: their frames cannot be told apart")

    sync, emcy, time = number_at(store, _COB_ID_SYNC, SYNC), number_at(store, _COB_ID_EMCY, EMCY + node_id), 0
    if _COB_ID_TIME in store:
        time = number_at(store, _COB_ID_TIME)
    for index, name, cob_id, fallback, in_use in (
        (indices.COB_ID_SYNC, "SYNC", sync, SYNC, True),
        (indices.COB_ID_TIME_STAMP, "TIME", time, None, bool(time & _TIME_IN_USE)),
        (indices.COB_ID_EMERGENCY, "EMCY", emcy, EMCY + node_id, not emcy & COB_ID_INVALID),
    ):
        if not in_use:
            continue
        key: int | None = key_of_cob_id(cob_id)
        if check_can_id(cob_id & ~_TIME_IN_USE) is not None:
            key = fallback
            instead = "it is off" if fallback is None else f"it goes by 0x{fallback:X}"
            yield Notice(index, 0, f"COB-ID 0x{cob_id:X} has a CAN-ID that {name} may not have: {instead}")
        if key is not None:
            yield from take(index, key, name, name == "EMCY")
    for number, producer in pdos.producers.items():
        if producer.key is not None:
            yield from take(communication_index(Direction.TPDO, number), producer.key, f"TPDO {number}", True)
    for number, consumer in pdos.consumers.items():
        if consumer.key is not None:
            yield from take(communication_index(Direction.RPDO, number), consumer.key, f"RPDO {number}", False)


def _pdos(node_id: int, values: Values, pdos: DevicePdos) -> Iterator[Notice]:
    store = values.store
    for index, fault in pdos.faults.items():
        place = place_of(index)
        assert place is not None  # only PDO parameters have faults
        yield Notice(index, None, f"{place.direction} {place.number} is off: {fault}")
    for direction, numbers in ((Direction.RPDO, pdos.consumers), (Direction.TPDO, pdos.producers)):
        for number in numbers:
            index = communication_index(direction, number)
            is_valid = not number_at(store, mux(index, COB_ID), COB_ID_INVALID) & COB_ID_INVALID
            if not is_valid or index in pdos.faults or mapping_index(direction, number) in pdos.faults:
                continue
            if not number_at(store, mux(mapping_index(direction, number))):
                yield Notice(index, None, f"{direction} {number} is off: nothing is mapped to it")
            kind = number_at(store, mux(index, TRANSMISSION_TYPE), FIRST_EVENT_DRIVEN)
            first = FIRST_EVENT_DRIVEN if direction is Direction.RPDO else SYNCHRONOUS_ON_REQUEST
            if LAST_SYNCHRONOUS < kind < first or kind > 0xFF:
                effect = "is taken as 255" if direction is Direction.RPDO or kind > 0xFF else "sends nothing"
                yield Notice(
                    index, TRANSMISSION_TYPE, f"transmission type {kind} of {direction} {number} is reserved: it {effect}"
                )


def _channels(node_id: int, values: Values, pdos: DevicePdos) -> Iterator[Notice]:
    for index in values.dictionary.objects:
        if SdoChannels.owns(index) and channel_of(values, index) is None:
            cob_ids = [number_at(values.store, mux(index, subindex)) for subindex in (TO_SERVER, TO_CLIENT)]
            if all(map(is_valid, cob_ids)):
                text = ", ".join(f"0x{cob_id:X}" for cob_id in cob_ids)
                yield Notice(index, None, f"this SDO channel is off: COB-IDs {text} have a CAN-ID that it may not have")


def _storage(node_id: int, values: Values, pdos: DevicePdos) -> Iterator[Notice]:
    for index, deed in ((indices.STORE_PARAMETERS, "stored"), (indices.RESTORE_DEFAULT_PARAMETERS, "restored")):
        described = values.dictionary.objects.get(index)
        if described is not None and not any(described.variables.keys() - {0}):
            yield Notice(index, None, f"it has no subindex 1: nothing can be {deed}")


def _about(variable: Variable, text: str) -> Notice:
    return Notice(variable.index, variable.subindex, f"{variable.name}: {text}" if variable.name else text)
