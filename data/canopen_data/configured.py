"""From the description of a type of device (EDS, XDD) to that of one device with its settings (DCF, XDC), and back.

`with_configured` does what a configuration tool does: it records the node-ID, the bit rate and the values to be set in the
device. `without_configured` removes all of that again. `moved_to` turns the settings of one node into those of another. Each
returns a new description; the old one stays unchanged.

Source: CiA 306-1 v1.4.0, 5 (device configuration file); CiA 301 v4.2.0, 7.3.3 (predefined connection set).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_proto import indices
from canopen_proto.datatypes import Value
from canopen_proto.dictionary.model import ObjectDictionary
from canopen_proto.dictionary.objects import Object, Variable
from canopen_proto.frame import COB_ID_EXTENDED, EMCY, RPDO1, RPDO2, RPDO3, RPDO4, TPDO1, TPDO2, TPDO3, TPDO4
from canopen_proto.machine import LocalProtocolError, check_node_id
from canopen_proto.multiplexer import Mux, split_mux

if TYPE_CHECKING:
    from canopen_data.description import Commissioning, DeviceDescription, FileInfo

_CAN_ID: Final = 0x7FF
_PDO_RECORDS: Final = (indices.RPDO_COMMUNICATION, indices.TPDO_COMMUNICATION)
_PDO_BASES: Final = (TPDO1, RPDO1, TPDO2, RPDO2, TPDO3, RPDO3, TPDO4, RPDO4)


def with_configured(
    description: DeviceDescription,
    values: Mapping[Mux, Value],
    commissioning: Commissioning | None = None,
    *,
    file_info: FileInfo | None = None,
) -> DeviceDescription:
    """Return the description of a DCF that sets these values, by mux, besides those that are configured already.

    commissioning: node-ID, bit rate and so on; None: those of the description. A value that is already configured relative to
    $NODEID stays so. file_info: for the new file (its name, its author and date: the core has no clock); None: that of the old
    file. A DCF made of an EDS names that EDS in LastEDS.

    Raises ObjectNotFoundError for a mux that the dictionary does not have, ValueRangeError where a value does not fit its object,
    and LocalProtocolError if neither argument nor description has a node-ID. Limits are not checked: a device may hold a value
    that its EDS does not allow.
    """
    from canopen_data.description import FileKind  # only here: a simulated drive needs none of it

    commissioning = commissioning or description.commissioning
    if commissioning is None or commissioning.node_id is None:
        raise LocalProtocolError("a DCF is of one device: its commissioning needs a node-ID")
    check_node_id(commissioning.node_id)
    if file_info is None:
        file_info = description.file_info
        if description.kind not in (FileKind.DCF, FileKind.XDC):
            file_info = replace(file_info, last_eds=file_info.file_name)
    return replace(
        description,
        dictionary=configure(description.dictionary, values, commissioning.node_id),
        kind=FileKind.DCF,
        file_info=file_info,
        commissioning=commissioning,
    )


def configure(dictionary: ObjectDictionary, values: Mapping[Mux, Value], node_id: int) -> ObjectDictionary:
    """Return the dictionary with these values, by mux, as its configured values. Raises ObjectNotFoundError, ValueRangeError."""
    changed: dict[int, dict[int, Variable]] = {}
    for key, value in values.items():
        variable = dictionary.variable(split_mux(key))
        variable.encode(value)
        if not variable.configured_adds_node_id or variable.initial_of(node_id) != value:
            new = replace(variable, configured=value, configured_adds_node_id=False, not_read="")
            changed.setdefault(variable.index, {})[variable.subindex] = new
    return _with_variables(dictionary, changed)


def moved_to(dictionary: ObjectDictionary, old: int, new: int) -> ObjectDictionary:
    """Return the dictionary of a DCF of node `old`, configured for node `new`.

    The COB-IDs of PDOs and of EMCY that are `old`'s in the predefined connection set become `new`'s, with their flag bits. All
    others stay: the whole network has agreed on them. Values relative to $NODEID need no change. Raises LocalProtocolError for a
    node-ID outside 1..127. Source: CiA 301 v4.2.0, 7.3.3.
    """
    check_node_id(old)
    check_node_id(new)
    values: dict[Mux, Value] = {}
    for variable in dictionary:
        cob_id = variable.configured
        if not isinstance(cob_id, int) or variable.configured_adds_node_id or cob_id & COB_ID_EXTENDED:
            continue
        if (cob_id & _CAN_ID) - old in _own_bases(variable):
            values[variable.mux] = cob_id - old + new
    return configure(dictionary, values, new)


def _own_bases(variable: Variable) -> tuple[int, ...]:
    """Return the base CAN-IDs that the predefined connection set allows this object; none if it is not a COB-ID of a node."""
    if variable.index == indices.COB_ID_EMERGENCY and variable.subindex == 0:
        return (EMCY,)
    is_pdo = variable.subindex == 1 and any(variable.index in each for each in _PDO_RECORDS)
    return _PDO_BASES if is_pdo else ()


def without_configured(description: DeviceDescription) -> DeviceDescription:
    """Return the description of an EDS: the facts that are the same for all devices of this type.

    Configured values, commissioning, connected modules, denotations, the files of DOMAINs and LastEDS are removed.
    """
    from canopen_data.description import FileKind

    return replace(
        description,
        dictionary=without_configured_values(description.dictionary),
        kind=FileKind.EDS,
        file_info=replace(description.file_info, last_eds=""),
        commissioning=None,
        connected_modules=(),
    )


def without_configured_values(dictionary: ObjectDictionary) -> ObjectDictionary:
    """Return the dictionary as an EDS has it: a device made of it has its defaults."""
    changed: dict[int, dict[int, Variable]] = {}
    for variable in dictionary:
        plain = replace(
            variable,
            configured=None,
            configured_adds_node_id=False,
            denotation="",
            upload_file="",
            download_file="",
            not_read="",
        )
        if plain != variable:
            changed.setdefault(variable.index, {})[variable.subindex] = plain
    denoted = (each for each in dictionary.objects.values() if each.denotation)
    return _with_variables(dictionary.with_objects(replace(each, denotation="") for each in denoted), changed)


def _with_variables(dictionary: ObjectDictionary, changed: Mapping[int, Mapping[int, Variable]]) -> ObjectDictionary:
    """Return the dictionary with these variables, by index and subindex, replaced."""

    def renewed(index: int) -> Object:
        each = dictionary.objects[index]
        return replace(each, variables=MappingProxyType({**each.variables, **changed[index]}))

    return dictionary.with_objects(map(renewed, changed)) if changed else dictionary
