"""The order in which a tool writes a device's settings, and the objects that it never writes.

A configuration tool downloads the settings of a DCF, a backup or a concise DCF (CiA 302-3) into a device that is pre-operational.
The order matters: some objects may change only while a service does not exist, and a service must not run on half a setting.
`download_order` gives the writes, in five parts:

1. switch off    the objects of the table `SWITCHES` that are set, or on which another object that is set depends: PDOs first
2. communication the objects 0x1000 to 0x1FFF by index. A PDO's two records stand together, at its communication parameter, in the
                 order mapping count 0, transmission type and times, entries, count. (The type comes before the count because a
                 multiplexed PDO in source address mode allows only an event-driven type.)
3. application   all other objects, by index and subindex
4. switch on     the switches that are to be on, by index: PDOs exist again when everything else is set
5. date          0x1020, date and time of the configuration: a device clears it when a setting is changed

So a download that is broken off leaves PDOs destroyed, never half mapped. A switch may have to be off although the values do not
set it: the COB-ID of a PDO whose mapping is set. It gets back the device's present value if that is known, else its initial value
in the dictionary. If the dictionary has none either, the switch is left alone, and a strict device refuses the write that depends
on it.

Left out, each with its reason: objects that are not writable or have flag 0 of ObjFlags (CiA 306-1); commands, histories and the
SDO channel in use (`NOT_SETTINGS`); mapping entries beyond the mapping count; subindex 4 of a PDO communication parameter, which
is reserved.

Source: CiA 301 v4.2.0, 7.5.2.5, .6, .15, .17, .19, .22, .31 and 7.5.2.33 to 7.5.2.38; CiA 302-3 for the purpose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

from canopen_proto import indices
from canopen_proto.cob_id import CONSUMES, PRODUCES
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.model import Object, ObjectDictionary, Variable
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.multiplexer import Mux, mux, split_mux

NO_DOWNLOAD: Final = 1
"""ObjFlags, bit 0: a download must not write the object. CiA 306-1."""

_RPDO, _TPDO = indices.RPDO1_COMMUNICATION_PARAMETER, indices.TPDO1_COMMUNICATION_PARAMETER  # first communication parameters
_TO_MAPPING: Final = 0x200
_RESERVED_SUBINDEX: Final = 4
MPDO_COUNTS: Final = (0xFE, 0xFF)
"""Mapping counts of a multiplexed PDO, which has one entry. CiA 301 v4.2.0, 7.5.2.36 and 7.5.2.38."""

NOT_SETTINGS: Final = {
    indices.PREDEFINED_ERROR_FIELD: "a history",
    indices.STORE_PARAMETERS: "a command: store",
    indices.RESTORE_DEFAULT_PARAMETERS: "a command: restore",
    indices.OS_COMMAND: "a command to the device's operating system",
    indices.OS_COMMAND_MODE: "a command to the device's operating system",
    indices.OS_DEBUGGER_INTERFACE: "a command to the device's operating system",
    indices.OS_PROMPT: "a dialogue with the device's operating system",
    indices.SDO_SERVER_PARAMETER: "the SDO channel of this very download",
    indices.PROGRAM_DATA: "a program, which is downloaded on purpose only",
    indices.PROGRAM_CONTROL: "a command: program control",
    indices.REQUEST_NMT: "a command: request NMT",
    indices.REQUEST_GUARDING: "a command: request guarding",
    **{0x6040 + 0x800 * axis: "a command: control word" for axis in range(8)},
}
"""Writable objects that are no settings; the control word would move a drive. CiA 301 v4.2.0, 7.5.2; CiA 302; CiA 402-2."""


Write: TypeAlias = tuple[int, int, bytes]
"""One download: index, subindex, data as SDO carries it."""


@dataclass(frozen=True, slots=True)
class DownloadOrder:
    """The result of `download_order`. writes: in order. left_out: why a value is not written, by mux."""

    writes: tuple[Write, ...]
    left_out: Mapping[Mux, str]


class Switch(NamedTuple):
    """An object that starts and ends a service. off: makes its value into one with the service off."""

    indices: range
    subindices: range
    off: Callable[[int], int]


def _invalid(value: int) -> int:
    return value | COB_ID_INVALID


def _zero(value: int) -> int:
    return 0


SWITCHES: Final = (
    Switch(indices.RPDO_COMMUNICATION, range(1, 2), _invalid),
    Switch(range(_TPDO, _TPDO + _TO_MAPPING), range(1, 2), _invalid),
    Switch(range(0x1005, 0x1006), range(1), lambda value: value & ~PRODUCES),
    Switch(range(0x1006, 0x1007), range(1), _zero),  # 0x1019 may change only while it is 0
    Switch(range(0x1012, 0x1013), range(1), lambda value: value & ~(PRODUCES | CONSUMES)),
    Switch(range(0x1014, 0x1015), range(1), _invalid),
    Switch(range(0x1016, 0x1017), range(1, 0x80), _zero),  # no node may be in two entries, not even for a moment
    Switch(range(0x1028, 0x1029), range(1, 0x80), _invalid),
    Switch(range(0x1201, 0x1300), range(1, 3), _invalid),
)
"""The switches, in the order in which they are switched off."""


def settings_of(dictionary: ObjectDictionary, node_id: int, *, defaults: bool = False) -> dict[Mux, Value]:
    """Return the values that a DCF configures for the device with this node-ID, by mux.

    defaults: add the defaults of all other objects, except those that a backup could not read.
    """
    return {
        variable.mux: variable.initial_of(node_id)
        for variable in dictionary
        if variable.configured is not None or (defaults and variable.default is not None and not variable.not_read)
    }


def download_order(
    dictionary: ObjectDictionary,
    values: Mapping[Mux, Value],
    node_id: int,
    *,
    present: Mapping[Mux, Value] | None = None,
) -> DownloadOrder:
    """Return the writes that set a device to these values, as this module's text describes.

    values: by mux. present: the device's present values, as far as they are known; strict devices want the CAN-ID unchanged in
    the write that destroys a PDO. Raises ObjectNotFoundError for a mux that the dictionary does not have, and ValueRangeError if
    an object's type cannot hold its value; limits of objects are not checked.
    """
    order = _Order(dictionary, node_id, present or {})
    for key, value in values.items():
        order.add(key, value)
    return order.result()


class _Order:
    """One `download_order` at work."""

    def __init__(self, dictionary: ObjectDictionary, node_id: int, present: Mapping[Mux, Value]) -> None:
        self.dictionary = dictionary
        self.node_id = node_id
        self.present = present
        self.values: dict[Mux, Value] = {}
        self.left_out: dict[Mux, str] = {}

    def add(self, key: Mux, value: Value) -> None:
        variable = self.dictionary.variable(split_mux(key))
        reason = reason_to_leave_out(self.dictionary.objects[variable.index], variable)
        if reason:
            self.left_out[key] = reason
        else:
            variable.encode(value)
            self.values[key] = value

    def result(self) -> DownloadOrder:
        self._leave_out_unused_entries()
        for key in list(self.values):
            for needed in switches_of(key):
                self._add_implied(needed)
        off: list[tuple[int, int, int, Write]] = []
        middle: list[tuple[tuple[int, ...], Write]] = []
        last: list[tuple[int, Write]] = []
        date: list[Write] = []
        for key, value in self.values.items():
            rank, switch = _switch_at(key)
            write = self._write(key, value)
            if write[0] == indices.VERIFY_CONFIGURATION:
                date.append(write)
                continue
            idle = None if switch is None else self._switched_off(write, switch)
            if switch is None or idle is None:
                middle += self._settings(key, value)
                continue
            if key in self.present:
                before = self._write(key, self.present[key])
                off.append((rank, key, 0, self._switched_off(before, switch) or before))
            else:
                off.append((rank, key, 0, idle))
            if idle != write:
                last.append((key, write))
            elif off[-1][-1] != write:
                off.append((rank, key, 1, write))
        writes = (
            *(each[-1] for each in sorted(off)),
            *(each[-1] for each in sorted(middle)),
            *(each[-1] for each in sorted(last)),
            *sorted(date),
        )
        return DownloadOrder(writes, self.left_out)

    @staticmethod
    def _switched_off(write: Write, switch: Switch) -> Write | None:
        """Return the write that ends the service by this object; None if the object's type is too small for that value."""
        index, subindex, data = write
        try:
            return index, subindex, switch.off(int.from_bytes(data, "little")).to_bytes(len(data), "little")
        except OverflowError:
            return None

    def _settings(self, key: Mux, value: Value) -> Iterator[tuple[tuple[int, ...], Write]]:
        """Return the writes of an object that is no switch, each with a key that sorts it among all writes."""
        index, subindex = split_mux(key)
        area = 0 if index in indices.COMMUNICATION_AREA else 1
        if index not in indices.PDO_RECORDS:
            yield (area, index, subindex), self._write(key, value)
        elif not index & _TO_MAPPING:
            yield (area, index, 1, subindex), self._write(key, value)
        elif subindex:
            yield (area, index - _TO_MAPPING, 2, subindex), self._write(key, value)
        else:
            write = self._write(key, value)
            nothing = (index, subindex, bytes(len(write[2])))
            yield (area, index - _TO_MAPPING, 0), nothing
            if write != nothing:
                yield (area, index - _TO_MAPPING, 3), write

    def _leave_out_unused_entries(self) -> None:
        """Leave out mapping entries beyond the count: devices refuse the 0 in them. A missing count is added."""
        counts: dict[int, int] = {}
        for key in sorted(self.values):
            index, subindex = split_mux(key)
            if index not in indices.PDO_RECORDS or not index & _TO_MAPPING or not subindex:
                continue
            if index not in counts:
                self._add_implied(mux(index))
                counts[index] = _entries_used(self.values.get(mux(index), self._known(mux(index))))
            if subindex > counts[index]:
                del self.values[key]
                self.left_out[key] = "beyond the number of mapped objects"

    def _add_implied(self, key: Mux) -> None:
        """Add an object that another one depends on, with the value that the device has, if it is not in `values`."""
        variable = self.dictionary.get(*split_mux(key))
        value = self._known(key)
        if key in self.values or variable is None or value is None:
            return
        if not reason_to_leave_out(self.dictionary.objects[variable.index], variable):
            self.values[key] = value

    def _known(self, key: Mux) -> Value | None:
        variable = self.dictionary.get(*split_mux(key))
        if key in self.present:
            return self.present[key]
        if variable is None or (variable.default is None and variable.configured is None):
            return None
        return variable.initial_of(self.node_id)

    def _write(self, key: Mux, value: Value) -> Write:
        variable = self.dictionary.variable(split_mux(key))
        return variable.index, variable.subindex, variable.encode(value)


def reason_to_leave_out(parent: Object, variable: Variable) -> str:
    """Return why a download never writes this object; "" if it may."""
    if not variable.access.writable:
        return "read-only"
    if (variable.object_flags | parent.object_flags) & NO_DOWNLOAD:
        return "its ObjFlags forbid a download"
    if variable.index in indices.PDO_RECORDS and not variable.index & _TO_MAPPING and variable.subindex == _RESERVED_SUBINDEX:
        return "reserved"
    return NOT_SETTINGS.get(variable.index, "")


def _entries_used(count: Value | None) -> int:
    """Return how many mapping entries are in use; 255 if the count is not known."""
    if not isinstance(count, int):
        return 0xFF
    return 1 if count in MPDO_COUNTS else count


def _switch_at(key: Mux) -> tuple[int, Switch | None]:
    index, subindex = split_mux(key)
    for rank, switch in enumerate(SWITCHES):
        if index in switch.indices and subindex in switch.subindices:
            return rank, switch
    return len(SWITCHES), None


def switches_of(key: Mux) -> tuple[Mux, ...]:
    """Return the switches that must be off while this object is written."""
    index, subindex = split_mux(key)
    if index in indices.PDO_RECORDS:
        return (mux(index & ~_TO_MAPPING, 1),)
    if index == indices.SYNCHRONOUS_COUNTER_OVERFLOW_VALUE:
        return (mux(indices.COMMUNICATION_CYCLE_PERIOD),)
    if 0x1201 <= index < 0x1300 and subindex == 3:  # the node-ID at the other end
        return (mux(index, 1), mux(index, 2))
    return ()
