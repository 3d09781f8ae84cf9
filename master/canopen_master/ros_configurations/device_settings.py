"""The values that a configuration sets in its devices, as a DCF for each of them: the device's own file with these values.

ros_canopen and ros2_canopen write such values at each start. Here `canopen restore NODE FILE.dcf` writes those that the device
does not have yet, once, and can have it store them; a simulated device has them from the start.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from canopen_data.configured import with_configured
from canopen_data.description import Commissioning, DeviceDescription, FileKind
from canopen_data.eds.numbers import read_value
from canopen_data.eds.writer import encode_eds, write_eds
from canopen_master.ros_configurations.draft import Setting
from canopen_master.ros_configurations.report import ImportReport
from canopen_proto.datatypes import Value, ValueRangeError
from canopen_proto.dictionary.model import ObjectDictionary
from canopen_proto.multiplexer import Mux, index_of, mapping_entry, mux_text, split_mux, subindex_of


def configured_file(description: DeviceDescription, node_id: int, settings: list[Setting], report: ImportReport) -> bytes | None:
    """Return the DCF of a node with these settings; None if there are none, or none of them can be made.

    description: the device's own file.
    """
    if not settings:
        return None
    values: dict[Mux, Value] = {}
    for setting in settings:
        value = _value(description.dictionary, setting, node_id)
        if isinstance(value, _Refused):
            report.left_out(setting.value, value.reason)
        else:
            values[setting.mux] = value
            report.taken(setting.value, f"{mux_text(setting.mux)} = {_shown(value, setting)} in the node's DCF")
    if not values:
        return None
    commissioning = replace(description.commissioning or Commissioning(), node_id=node_id)
    configured = with_configured(description, values, commissioning)
    return encode_eds(write_eds(configured, FileKind.DCF), description.encoding)


def _shown(value: Value, setting: Setting) -> str:
    """Return a value for people: COB-IDs and mappings in hexadecimal."""
    if isinstance(value, int) and index_of(setting.mux) in _PDO_PARAMETERS and subindex_of(setting.mux):
        return f"0x{value:X}"
    return repr(value)


_PDO_PARAMETERS: Final = range(0x1400, 0x1C00)


class _Refused:
    """A setting that cannot be made, and the reason."""

    def __init__(self, reason: str) -> None:
        self.reason = reason


def _value(dictionary: ObjectDictionary, setting: Setting, node_id: int) -> Value | _Refused:
    """Return the value of a setting in its object's type."""
    place = mux_text(setting.mux)
    variable = dictionary.get(*split_mux(setting.mux))
    if variable is None:
        return _Refused(f"the device's file has no object {place}")
    if not variable.access.writable:
        return _Refused(f"{place} is {variable.access} by the device's file")
    value: Value | None
    if setting.maps is not None:
        mapped = dictionary.get(*split_mux(setting.maps))
        bits = None if mapped is None else mapped.bit_length
        if bits is None:
            return _Refused(f"the device's file has no object {mux_text(setting.maps)} that could be mapped")
        value = mapping_entry(setting.maps, bits)
    else:
        value, adds_node_id, remark, _ = read_value(setting.text, variable.data_type)
        if value is None:
            return _Refused(
                f"{setting.text!r} is no value of {place} ({variable.data_type.name}){': ' if remark else ''}{remark}"
            )
        if adds_node_id and isinstance(value, int):
            value += node_id
    try:
        variable.encode(value)
    except ValueRangeError as error:
        return _Refused(str(error))
    return value
