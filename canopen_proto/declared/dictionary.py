"""The dictionary of a declared device: its own objects, its PDOs, and the communication objects that each device has.

Without saying anything, a device has: error register and history, SYNC, EMCY with inhibit time, storing and restoring of
parameters, four heartbeat consumers, a heartbeat, identity, SYNC counter, error behaviour, one SDO server.

The standard objects are named as CiA 301 writes them: "COB-ID SYNC", "Vendor-ID". `ObjectDictionary.variable` takes the names of
dictionary/standard.py for them as well: case, blanks and hyphens do not count there.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from canopen_proto import indices
from canopen_proto.declared.nameplate import Nameplate
from canopen_proto.declared.objects import HIGHEST_SUBINDEX, Declared, highest_subindex
from canopen_proto.declared.pdos import Rpdo, Tpdo
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.objects import Object, ObjectType, Variable
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.machine import LocalProtocolError

_HISTORY: Final = 8
_CONSUMERS: Final = 4
_ACRONYMS: Final = ("cob", "id", "sync", "sdo", "rpdo", "tpdo", "nmt", "os", "eds", "dcf")


def dictionary_of(
    nameplate: Nameplate,
    declared: Sequence[Declared],
    pdos: Iterable[Rpdo | Tpdo] = (),
    standard: Iterable[Object] = (),
    without: Collection[int] = (),
) -> ObjectDictionary:
    """Return the dictionary of a device.

    standard: further standard objects, or others in place of those that a device has anyway; without: indices of these that it
    does not have. Raises LocalProtocolError if two declarations have the same place.
    """
    records = [each for pdo in pdos for each in pdo.records()]
    named = [_with_names(each) for each in (*_communication(nameplate), *records, *standard) if each.index not in without]
    return ObjectDictionary([*named, *_own(declared)], source=nameplate.product_name)


def _communication(plate: Nameplate) -> list[Object]:
    identity = {1: plate.vendor_id, 2: plate.product_code, 3: plate.revision, 4: plate.serial_number}
    return [
        standard_object(indices.DEVICE_TYPE, plate.device_type),
        standard_object(indices.ERROR_REGISTER),
        standard_object(indices.PREDEFINED_ERROR_FIELD, highest=_HISTORY),
        standard_object(indices.COB_ID_SYNC),
        standard_object(indices.COMMUNICATION_CYCLE_PERIOD, 0),
        standard_object(indices.MANUFACTURER_DEVICE_NAME, plate.product_name),
        standard_object(indices.MANUFACTURER_HARDWARE_VERSION, plate.hardware_version),
        standard_object(indices.MANUFACTURER_SOFTWARE_VERSION, plate.software_version),
        standard_object(indices.STORE_PARAMETERS, highest=3),
        standard_object(indices.RESTORE_DEFAULT_PARAMETERS, highest=3),
        standard_object(indices.COB_ID_EMERGENCY),
        standard_object(indices.INHIBIT_TIME_EMERGENCY, 0),
        standard_object(indices.CONSUMER_HEARTBEAT_TIME, highest=_CONSUMERS),
        standard_object(indices.PRODUCER_HEARTBEAT_TIME, 0),
        standard_object(indices.IDENTITY_OBJECT, highest=4, defaults=identity),
        standard_object(indices.SYNCHRONOUS_COUNTER_OVERFLOW_VALUE, 0),
        standard_object(indices.ERROR_BEHAVIOR, highest=1),
        standard_object(indices.SDO_SERVER_PARAMETER),
    ]


def _own(declared: Iterable[Declared]) -> list[Object]:
    objects: dict[int, Object] = {}
    for each in declared:
        before = objects.get(each.index)
        variables = {variable.subindex: variable for variable in each.variables}
        if before is not None:
            if before.name != each.record or each.object_type is not ObjectType.RECORD or variables.keys() & before.variables:
                raise LocalProtocolError(f"0x{each.index:04X} is {before.name!r} already; {each.record!r} needs another place")
            variables |= before.variables
        if each.object_type is ObjectType.RECORD:
            variables[0] = highest_subindex(each.index, max(variables))
        in_order = MappingProxyType(dict(sorted(variables.items())))
        objects[each.index] = Object(each.index, each.record, each.object_type, in_order)
    return list(objects.values())


def _with_names(each: Object) -> Object:
    """Return a standard object with the names of CiA 301."""

    def named(variable: Variable) -> Variable:
        field = variable.name.rpartition(":")[2]
        return replace(variable, name=HIGHEST_SUBINDEX if field == "highest_subindex" else _spoken(field))

    variables = {subindex: named(variable) for subindex, variable in each.variables.items()}
    return replace(each, name=_spoken(each.name), variables=MappingProxyType(variables))


def _spoken(name: str) -> str:
    """Return a name of dictionary/standard.py as CiA 301 writes it: "cob_id_sync" -> "COB-ID SYNC"."""
    words = [word.upper() if word.rstrip("0123456789") in _ACRONYMS else word for word in name.split("_")]
    text = " ".join(words).replace(" ID", "-ID")
    return text[:1].upper() + text[1:]
