"""Check standard objects against the standards: CiA 301, and CiA 402 if 0x1000 says that the device is a drive.

An object that can do less than the standard's (a PDO parameter that cannot be written, a fixed COB-ID) is no fault: CiA 301
allows it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from canopen_data.checks.subject import ERROR, NOTICE, WARNING, Rule, Subject
from canopen_data.findings import Finding
from canopen_proto import indices
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary.model import Access, ObjectType, Variable
from canopen_proto.dictionary.standard import find_standard

DRIVE_PROFILE: Final = 402
CONTROLWORD: Final = 0x6040
STATUSWORD: Final = 0x6041
ERROR_CONTROL: Final = (indices.PRODUCER_HEARTBEAT_TIME, indices.GUARD_TIME)

_BYTES: Final = {DataType.DOMAIN, DataType.OCTET_STRING}
"""The same thing by SDO: in most places CiA 301 lets a device choose."""

_TO_WRITE: Final[dict[int, Access | None]] = {0x1003_00: None, 0x1017_00: Access.CONST}
"""Objects that must be writable, with the other access allowed: writing 0 clears the history, and switches the heartbeat off. CiA
301 v4.2.0, 7.5.2.4 and 7.5.2.20."""
_RESERVED_BITS: Final = {
    indices.COB_ID_EMERGENCY: 0x4000_0000,
    indices.CONSUMER_HEARTBEAT_TIME: 0xFF00_0000,
    indices.EMERGENCY_CONSUMER: 0x4000_0000,
}
"""By index: COB-ID EMCY, heartbeat and EMCY consumers (CiA 301 v4.2.0, 7.5.2.17, 7.5.2.19, 7.5.2.31)."""
_RESERVED_SUBINDEX: Final = 4
_CONSUMER_RANGE: Final = (0, 0x007F_FFFF)
"""The range that an entry must take: "not in use" up to node 127 with the longest time."""

RULES: Final = (
    Rule("standard-type", ERROR, "a communication object of another length than the standard's: masters use it wrongly"),
    Rule("profile-type", WARNING, "an object of the device profile is of another length than the profile's"),
    Rule("standard-sign", WARNING, "a standard object of the right length, but of another type"),
    Rule("standard-access", WARNING, "a standard object that can be written here and only read there, or the other way"),
    Rule("reserved-sub", NOTICE, "sub 4 of a TPDO's communication parameter, which the standard reserves"),
    Rule("reserved-bits", WARNING, "a value with bits that the standard reserves, and that are 0"),
    Rule("consumer-limits", WARNING, "limits of a heartbeat consumer that forbid what it has to take"),
    Rule("standard-object", WARNING, "a VAR where the standard has an ARRAY or RECORD, or the other way"),
    Rule("standard-mappable", NOTICE, "a communication object that no PDO carries is marked as one that a PDO may carry"),
    Rule("drive-objects", WARNING, "a drive without controlword or statusword"),
    Rule("error-control-missing", WARNING, "neither heartbeat nor node guarding: nobody notices when the device is gone"),
    Rule("error-control-twice", WARNING, "heartbeat and node guarding are both on after start-up; only one may be in use"),
    Rule("heartbeat-consumer", WARNING, "a heartbeat consumer that watches no node, or one that is watched already"),
)


def check_standard_objects(subject: Subject) -> Iterator[Finding]:
    """Check data type, access and kind of every object of a standard."""
    is_drive = subject.profile == DRIVE_PROFILE
    for each in subject.dictionary.objects.values():
        if each.index not in indices.COMMUNICATION_AREA and not (is_drive and each.index in indices.PROFILE_AREA):
            continue
        standard_is_one = find_standard(each.index, 1) is None
        if find_standard(each.index, 0 if standard_is_one else 1) is None:
            continue
        is_one = each.object_type not in (ObjectType.ARRAY, ObjectType.RECORD)
        if is_one != standard_is_one:
            kind = "one variable" if standard_is_one else "an ARRAY or a RECORD"
            text = f"it is a {each.object_type.name}; to the standard it is {kind}"
            yield subject.of_object("standard-object", each.index, text, "ObjectType")
            continue
        for variable in each.variables.values():
            standard = find_standard(each.index, variable.subindex)
            if standard is not None:
                yield from _check_against(subject, variable, standard)


def _check_against(subject: Subject, variable: Variable, standard: Variable) -> Iterator[Finding]:
    if variable.data_type is not standard.data_type and {variable.data_type, standard.data_type} != _BYTES:
        code = "standard-type" if variable.index in indices.COMMUNICATION_AREA else "profile-type"
        if variable.size == standard.size:
            code = "standard-sign"
        text = f"it is of type {variable.data_type.name}; {standard.name} is {standard.data_type.name} to the standard"
        yield subject.of_variable(code, variable, text, "DataType")
    is_writable = variable.access.writable
    has_to_be = variable.mux in _TO_WRITE and variable.access is not _TO_WRITE[variable.mux]
    if is_writable is not standard.access.writable and (is_writable or has_to_be):
        text = f"it is {variable.access}; {standard.name} is {standard.access} to the standard"
        yield subject.of_variable("standard-access", variable, text, "AccessType")
    elif variable.access is Access.WO and standard.access.readable:
        text = f"it cannot be read; {standard.name} is {standard.access} to the standard"
        yield subject.of_variable("standard-access", variable, text, "AccessType")
    if variable.pdo_mappable and not standard.pdo_mappable and variable.index in indices.COMMUNICATION_AREA:
        yield subject.of_variable("standard-mappable", variable, "PDOMapping=1; to the standard no PDO carries it", "PDOMapping")


def check_reserved(subject: Subject) -> Iterator[Finding]:
    """Check reserved sub-indices and bits of communication objects, and limits that forbid necessary values."""
    for variable in subject.dictionary:
        index, subindex = variable.index, variable.subindex
        if index in indices.TPDO_COMMUNICATION and subindex == _RESERVED_SUBINDEX:
            text = "the sub-index is reserved, and no device is to have it (CiA 301, 7.5.2.37)"
            yield subject.of_variable("reserved-sub", variable, text)
        number = (
            subject.number(index, subindex)
            if index in _RESERVED_BITS and (subindex or index == indices.COB_ID_EMERGENCY)
            else None
        )
        if number is not None and number.value & _RESERVED_BITS[index]:
            text = f"{number} has bits of 0x{_RESERVED_BITS[index]:08X}, which are reserved"
            yield subject.of_value("reserved-bits", variable, text)
        if index == indices.CONSUMER_HEARTBEAT_TIME and subindex:
            yield from _check_consumer_limits(subject, variable)


def _check_consumer_limits(subject: Subject, variable: Variable) -> Iterator[Finding]:
    least, most = _CONSUMER_RANGE
    low, high = variable.low_limit, variable.high_limit
    if low is not None and low > least:
        text = f"LowLimit {low} forbids 0, by which the entry is not in use"
        yield subject.of_variable("consumer-limits", variable, text, "LowLimit")
    if high is not None and high < most:
        text = f"HighLimit {high} forbids node-IDs and times up to 0x{most:08X} (node-ID << 16 | ms)"
        yield subject.of_variable("consumer-limits", variable, text, "HighLimit")


def check_profile(subject: Subject) -> Iterator[Finding]:
    """Check that a drive has controlword and statusword."""
    objects = subject.dictionary.objects
    if subject.profile == DRIVE_PROFILE:
        for index, name in ((CONTROLWORD, "controlword"), (STATUSWORD, "statusword")):
            if index not in objects and index + 0x800 not in objects:
                text = f"the device type says CiA 402, but there is no {name} (0x{index:04X})"
                yield subject.of_object("drive-objects", indices.DEVICE_TYPE, text, "DefaultValue")


def check_error_control(subject: Subject) -> Iterator[Finding]:
    """Check heartbeat and node guarding (CiA 301 v4.2.0, 7.2.8.2: one of the two is mandatory, both at a time forbidden)."""
    objects = subject.dictionary.objects
    if not any(index in objects for index in ERROR_CONTROL):
        text = "there is neither a producer heartbeat time (0x1017) nor a guard time (0x100C)"
        yield subject.of_entry("error-control-missing", "OptionalObjects", "", text)
    heartbeat, guard_time, factor = (
        subject.number(index) for index in (indices.PRODUCER_HEARTBEAT_TIME, indices.GUARD_TIME, indices.LIFE_TIME_FACTOR)
    )
    if heartbeat and guard_time and factor and heartbeat.value and guard_time.value and factor.value:
        text = f"a heartbeat every {heartbeat.value} ms by default, and node guarding (0x100C, 0x100D) too"
        yield subject.of_value("error-control-twice", subject.dictionary.variable(indices.PRODUCER_HEARTBEAT_TIME), text)
    watched: dict[int, int] = {}
    consumers = objects.get(indices.CONSUMER_HEARTBEAT_TIME)
    for subindex in sorted(consumers.variables) if consumers is not None else ():
        number = subject.number(indices.CONSUMER_HEARTBEAT_TIME, subindex)
        if not subindex or number is None or not number.value & 0xFFFF:
            continue  # not in use
        node_id = number.value >> 16 & 0xFF
        variable = subject.dictionary.variable((indices.CONSUMER_HEARTBEAT_TIME, subindex))
        if not 1 <= node_id <= 127 and not number.adds_node_id:
            yield subject.of_value("heartbeat-consumer", variable, f"node-ID {node_id} is outside 1..127")
        elif watched.setdefault(node_id, subindex) != subindex:
            text = f"node {node_id} is watched by sub {watched[node_id]} already"
            yield subject.of_value("heartbeat-consumer", variable, text)


CHECKS: Final[tuple[Callable[[Subject], Iterator[Finding]], ...]] = (
    check_standard_objects,
    check_reserved,
    check_profile,
    check_error_control,
)
