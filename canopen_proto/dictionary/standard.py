"""The objects that the standards define: communication objects of CiA 301 and CiA 302, and drive objects of CiA 402.

Two tables give each object its name, type and access. They are text because they are read more often than changed. Their users:

- code that builds a device, such as the simulated drive, calls `standard_object` and `standard_variable`;
- the CSV loader, whose files give the length of an object but not whether it is signed;
- the linter, which finds a wrong `rw`.

Columns: index (or a range of indices with the same fields), subindex (or a range), type, access, name, default. In a name, `{n}`
counts the indices of a range from 1, `{m}` from 2, and `{s}` is the subindex; `|` separates further names. `ro+` means that a
TPDO may carry the object, `rww` that an RPDO may. If subindex 0 of a record has no row, it is the constant "highest sub-index
supported". A device may have eight axes; each one has the CiA 402 objects 0x800 above those of the axis before.

Sources: CiA 301 v4.2.0, 7.5.2. CiA 302-2 and 302-3 v4.1.0: boot-up, configuration and program download, as Lely core has them.
CiA 402: a majority of seven drives' dictionaries and CiA's own sample. They differ in two objects: 6060 is `wo` in the sample and
readable in every drive; 60B2 has 32 bits in one drive and 16, like all torques, in the others. 60D5 to 60D8, 60E3 and 60E4 are of
the newer edition, as two makers have them. Left out: other objects that only newer profile versions have, and the rest of CiA
302.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from canopen_proto import indices
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary.model import Access, Object, ObjectNotFoundError, ObjectType, Variable
from canopen_proto.multiplexer import AXIS_STEP

_COMMUNICATION: Final = """
1000      00    U32  ro    device_type
1001      00    U8   ro+   error_register
1002      00    U32  ro+   manufacturer_status_register
1003      00    U8   rw    predefined_error_field:number_of_errors
1003      01-FE U32  ro    predefined_error_field:standard_error_field_{s}
1005      00    U32  rw    cob_id_sync = 0x80
1006      00    U32  rw    communication_cycle_period
1007      00    U32  rw    synchronous_window_length
1008      00    VIS  const manufacturer_device_name
1009      00    VIS  const manufacturer_hardware_version
100A      00    VIS  const manufacturer_software_version
100C      00    U16  rw    guard_time
100D      00    U8   rw    life_time_factor
1010      01    U32  rw    store_parameters:save_all_parameters
1010      02    U32  rw    store_parameters:save_communication_parameters
1010      03    U32  rw    store_parameters:save_application_parameters
1010      04-7F U32  rw    store_parameters:save_manufacturer_parameters_{s}
1011      01    U32  rw    restore_default_parameters:restore_all_default_parameters
1011      02    U32  rw    restore_default_parameters:restore_communication_default_parameters
1011      03    U32  rw    restore_default_parameters:restore_application_default_parameters
1011      04-7F U32  rw    restore_default_parameters:restore_manufacturer_default_parameters_{s}
1012      00    U32  rw    cob_id_time_stamp = 0x100
1013      00    U32  rww   high_resolution_time_stamp
1014      00    U32  rw    cob_id_emergency = 0x80 + node
1015      00    U16  rw    inhibit_time_emergency
1016      01-7F U32  rw    consumer_heartbeat_time:consumer_{s}
1017      00    U16  rw    producer_heartbeat_time
1018      01    U32  ro    identity_object:vendor_id
1018      02    U32  ro    identity_object:product_code
1018      03    U32  ro    identity_object:revision_number
1018      04    U32  ro    identity_object:serial_number
1019      00    U8   rw    synchronous_counter_overflow_value
1020      01    U32  rw    verify_configuration:configuration_date
1020      02    U32  rw    verify_configuration:configuration_time
1021      00    DOM  ro    store_eds
1022      00    U16  ro    store_format
1023      01    OCT  rw    os_command:command
1023      02    U8   ro    os_command:status
1023      03    OCT  ro    os_command:reply
1024      00    U8   wo    os_command_mode
1025      01    OCT  rw    os_debugger_interface:command
1025      02    U8   ro    os_debugger_interface:status
1025      03    OCT  ro    os_debugger_interface:reply
1026      01    U8   wo    os_prompt:std_in
1026      02    U8   ro+   os_prompt:std_out
1026      03    U8   ro+   os_prompt:std_err
1027      01-FE U16  ro    module_list:module_{s}
1028      01-7F U32  rw    emergency_consumer:consumer_{s} = 0x80000000
1029      01    U8   rw    error_behavior:communication_error
1029      02-FE U8   rw    error_behavior:specific_error_{s}
1200      01    U32  ro    sdo_server_parameter:cob_id_client_to_server = 0x600 + node
1200      02    U32  ro    sdo_server_parameter:cob_id_server_to_client = 0x580 + node
1201-127F 01    U32  rw    sdo_server_{m}_parameter:cob_id_client_to_server = 0x80000000
1201-127F 02    U32  rw    sdo_server_{m}_parameter:cob_id_server_to_client = 0x80000000
1201-127F 03    U8   rw    sdo_server_{m}_parameter:node_id_of_client
1280-12FF 01    U32  rw    sdo_client_{n}_parameter:cob_id_client_to_server = 0x80000000
1280-12FF 02    U32  rw    sdo_client_{n}_parameter:cob_id_server_to_client = 0x80000000
1280-12FF 03    U8   rw    sdo_client_{n}_parameter:node_id_of_server
1400-15FF 01    U32  rw    rpdo{n}_communication_parameter:cob_id = 0x80000000
1400-15FF 02    U8   rw    rpdo{n}_communication_parameter:transmission_type = 0xFF
1400-15FF 03    U16  rw    rpdo{n}_communication_parameter:inhibit_time
1400-15FF 04    U8   rw    rpdo{n}_communication_parameter:compatibility_entry
1400-15FF 05    U16  rw    rpdo{n}_communication_parameter:event_timer
1400-15FF 06    U8   rw    rpdo{n}_communication_parameter:sync_start_value
1600-17FF 00    U8   rw    rpdo{n}_mapping_parameter:number_of_mapped_objects
1600-17FF 01-40 U32  rw    rpdo{n}_mapping_parameter:object_{s}
1800-19FF 01    U32  rw    tpdo{n}_communication_parameter:cob_id = 0x80000000
1800-19FF 02    U8   rw    tpdo{n}_communication_parameter:transmission_type = 0xFF
1800-19FF 03    U16  rw    tpdo{n}_communication_parameter:inhibit_time
1800-19FF 04    U8   rw    tpdo{n}_communication_parameter:reserved
1800-19FF 05    U16  rw    tpdo{n}_communication_parameter:event_timer
1800-19FF 06    U8   rw    tpdo{n}_communication_parameter:sync_start_value
1A00-1BFF 00    U8   rw    tpdo{n}_mapping_parameter:number_of_mapped_objects
1A00-1BFF 01-40 U32  rw    tpdo{n}_mapping_parameter:object_{s}
1F22      01-7F DOM  rw    concise_dcf:node_{s}
1F26      01-7F U32  rw    expected_configuration_date:node_{s}
1F27      01-7F U32  rw    expected_configuration_time:node_{s}
1F50      01-FE DOM  wo    program_data:program_{s}
1F51      01-FE U8   rw    program_control:program_{s}
1F55      01-7F U32  rw    expected_software_identification:node_{s}
1F56      01-FE U32  ro    program_software_identification:program_{s}
1F57      01-FE U32  ro    flash_status_identification:program_{s}
1F80      00    U32  rw    nmt_startup
1F81      01-7F U32  rw    slave_assignment:node_{s}
1F82      01-80 U8   rw    request_nmt:node_{s}
1F83      01-80 U8   rw    request_guarding:node_{s}
1F84      01-7F U32  rw    device_type_identification:node_{s}
1F85      01-7F U32  rw    vendor_identification:node_{s}
1F86      01-7F U32  rw    product_code:node_{s}
1F87      01-7F U32  rw    revision_number:node_{s}
1F88      01-7F U32  rw    serial_number:node_{s}
1F89      00    U32  rw    boot_time
1F8A      01-7F U8   rw    restore_configuration:node_{s}
1FA0-1FCF 01-FE U32  rw    object_scanner_list_{n}:scan_{s}
1FD0-1FFF 01-FE U64  rw    object_dispatching_list_{n}:dispatch_{s}
"""

_DRIVE: Final = """
6007      00    I16  rww   abort_connection_option_code
603F      00    U16  ro+   error_code
6040      00    U16  rww   controlword
6041      00    U16  ro+   statusword
6042      00    I16  rww   vl_target_velocity
6043      00    I16  ro+   vl_velocity_demand
6044      00    I16  ro+   vl_velocity_actual_value
6046      01    U32  rww   vl_velocity_min_max_amount:min_amount
6046      02    U32  rww   vl_velocity_min_max_amount:max_amount
6048      01    U32  rww   vl_velocity_acceleration:delta_speed
6048      02    U16  rww   vl_velocity_acceleration:delta_time
6049      01    U32  rww   vl_velocity_deceleration:delta_speed
6049      02    U16  rww   vl_velocity_deceleration:delta_time
604A      01    U32  rw    vl_velocity_quick_stop:delta_speed
604A      02    U16  rw    vl_velocity_quick_stop:delta_time
604B      01    I16  rw    vl_set_point_factor:numerator = 1
604B      02    I16  rw    vl_set_point_factor:denominator = 1
604C      01    I32  rw    vl_dimension_factor:numerator = 1
604C      02    I32  rw    vl_dimension_factor:denominator = 1
605A      00    I16  rw    quick_stop_option_code = 2
605B      00    I16  rw    shutdown_option_code
605C      00    I16  rw    disable_operation_option_code = 1
605D      00    I16  rw    halt_option_code = 1
605E      00    I16  rw    fault_reaction_option_code = 2
6060      00    I8   rww   modes_of_operation
6061      00    I8   ro+   modes_of_operation_display
6062      00    I32  ro+   position_demand_value
6063      00    I32  ro+   position_actual_internal_value
6064      00    I32  ro+   position_actual_value
6065      00    U32  rww   following_error_window
6066      00    U16  rww   following_error_time_out
6067      00    U32  rww   position_window
6068      00    U16  rww   position_window_time
6069      00    I32  ro+   velocity_sensor_actual_value
606A      00    I16  rw    sensor_selection_code
606B      00    I32  ro+   velocity_demand_value
606C      00    I32  ro+   velocity_actual_value
606D      00    U16  rww   velocity_window
606E      00    U16  rww   velocity_window_time
606F      00    U16  rww   velocity_threshold
6070      00    U16  rww   velocity_threshold_time
6071      00    I16  rww   target_torque
6072      00    U16  rww   max_torque
6073      00    U16  rww   max_current
6074      00    I16  ro+   torque_demand_value
6075      00    U32  rww   motor_rated_current
6076      00    U32  rww   motor_rated_torque
6077      00    I16  ro+   torque_actual_value
6078      00    I16  ro+   current_actual_value
6079      00    U32  ro+   dc_link_circuit_voltage
607A      00    I32  rww   target_position
607B      01    I32  rww   position_range_limit:min = -2147483648
607B      02    I32  rww   position_range_limit:max = 2147483647
607C      00    I32  rww   home_offset
607D      01    I32  rww   software_position_limit:min = -2147483648
607D      02    I32  rww   software_position_limit:max = 2147483647
607E      00    U8   rww   polarity
607F      00    U32  rww   max_profile_velocity
6080      00    U32  rww   max_motor_speed
6081      00    U32  rww   profile_velocity
6082      00    U32  rw    end_velocity
6083      00    U32  rww   profile_acceleration
6084      00    U32  rww   profile_deceleration
6085      00    U32  rww   quick_stop_deceleration
6086      00    I16  rww   motion_profile_type
6087      00    U32  rww   torque_slope
6088      00    I16  rww   torque_profile_type
608B      00    I8   rw    velocity_notation_index
608C      00    U8   rw    velocity_dimension_index
608F      01    U32  rww   position_encoder_resolution:encoder_increments = 1
608F      02    U32  rww   position_encoder_resolution:motor_revolutions = 1
6090      01    U32  rww   velocity_encoder_resolution:encoder_increments_per_second = 1
6090      02    U32  rww   velocity_encoder_resolution:motor_revolutions_per_second = 1
6091      01    U32  rww   gear_ratio:motor_revolutions = 1
6091      02    U32  rww   gear_ratio:shaft_revolutions = 1
6092      01    U32  rww   feed_constant:feed = 1
6092      02    U32  rww   feed_constant:shaft_revolutions = 1
6096      01    U32  rww   velocity_factor:numerator = 1
6096      02    U32  rww   velocity_factor:divisor = 1
6097      01    U32  rww   acceleration_factor:numerator = 1
6097      02    U32  rww   acceleration_factor:divisor = 1
6098      00    I8   rww   homing_method
6099      01    U32  rww   homing_speeds:search_switch
6099      02    U32  rww   homing_speeds:search_zero
609A      00    U32  rww   homing_acceleration
60A3      00    U8   rww   profile_jerk_use = 1
60A4      01    U32  rww   profile_jerk:profile_jerk_1
60A4      02    U32  rww   profile_jerk:profile_jerk_2
60A8      00    U32  rw    si_unit_position
60A9      00    U32  rw    si_unit_velocity
60AA      00    U32  rw    si_unit_acceleration
60B0      00    I32  rww   position_offset
60B1      00    I32  rww   velocity_offset
60B2      00    I16  rww   torque_offset
60B8      00    U16  rww   touch_probe_function
60B9      00    U16  ro+   touch_probe_status
60BA      00    I32  ro+   touch_probe_1_positive_edge
60BB      00    I32  ro+   touch_probe_1_negative_edge
60BC      00    I32  ro+   touch_probe_2_positive_edge
60BD      00    I32  ro+   touch_probe_2_negative_edge
60C0      00    I16  rww   interpolation_sub_mode_select
60C1      01    I32  rww   interpolation_data_record:ip_data_position
60C1      02    I32  rww   interpolation_data_record:ip_data_velocity
60C2      01    U8   rww   interpolation_time_period:ip_time_units|ip_time_units = 1
60C2      02    I8   rww   interpolation_time_period:ip_time_index|ip_time_index = -3
60C3      01    U8   rw    interpolation_sync_definition:synchronize_on_group
60C3      02    U8   rw    interpolation_sync_definition:ip_sync_every_n_event = 1
60C4      01    U32  ro    interpolation_data_configuration:maximum_buffer_size = 1
60C4      02    U32  rw    interpolation_data_configuration:actual_buffer_size
60C4      03    U8   rw    interpolation_data_configuration:buffer_organization
60C4      04    U16  rw    interpolation_data_configuration:buffer_position
60C4      05    U8   wo    interpolation_data_configuration:size_of_data_record = 1
60C4      06    U8   wo    interpolation_data_configuration:buffer_clear
60C5      00    U32  rww   max_acceleration
60C6      00    U32  rww   max_deceleration
60D5      00    U16  ro+   touch_probe_1_positive_edge_counter
60D6      00    U16  ro+   touch_probe_1_negative_edge_counter
60D7      00    U16  ro+   touch_probe_2_positive_edge_counter
60D8      00    U16  ro+   touch_probe_2_negative_edge_counter
60E0      00    I16  rww   positive_torque_limit_value
60E1      00    I16  rww   negative_torque_limit_value
60E3      01-FE I8   ro    supported_homing_methods:homing_method_{s}
60E4      01-FE I32  ro+   additional_position_actual_value:position_{s}
60F2      00    U16  rww   positioning_option_code
60F4      00    I32  ro+   following_error_actual_value
60F8      00    I32  rww   max_slippage
60FC      00    I32  ro+   position_demand_internal_value
60FD      00    U32  ro+   digital_inputs
60FE      01    U32  rww   digital_outputs:physical_outputs
60FE      02    U32  rww   digital_outputs:bit_mask
60FF      00    I32  rww   target_velocity
6402      00    U16  rww   motor_type
6502      00    U32  ro+   supported_drive_modes
67FF      00    U32  ro    single_device_type
"""

_TYPES: Final[dict[str, DataType]] = {
    "I8": DataType.INTEGER8,
    "I16": DataType.INTEGER16,
    "I32": DataType.INTEGER32,
    "U8": DataType.UNSIGNED8,
    "U16": DataType.UNSIGNED16,
    "U32": DataType.UNSIGNED32,
    "U64": DataType.UNSIGNED64,
    "VIS": DataType.VISIBLE_STRING,
    "OCT": DataType.OCTET_STRING,
    "DOM": DataType.DOMAIN,
}
_ROW: Final = re.compile(
    r"(\w{4})(?:-(\w{4}))? +(\w\w)(?:-(\w\w))? +(\w+) +(\w+)(\+?) +([\w{}:|]+)(?: = (-?\w+)( \+ node)?)?", re.ASCII
)
_RECORDS: Final = (range(0x1018, 0x1019), indices.RPDO_MAPPINGS, indices.TPDO_MAPPINGS)
"""Objects whose fields are all of one type and which are records all the same."""


class Row(NamedTuple):
    """One line of a table. names: with their `{n}`, `{m}` and `{s}`. pattern: the first object of the line, but for its names."""

    indices: range
    subindices: range
    names: tuple[str, ...]
    pattern: Variable

    def variable(self, index: int, subindex: int) -> Variable:
        number = index - self.indices.start + 1
        name, *aliases = (each.format(n=number, m=number + 1, s=subindex) for each in self.names)
        return replace(self.pattern, index=index, subindex=subindex, name=name, aliases=tuple(aliases))

    @property
    def is_field(self) -> bool:
        """A row of one subindex, not of a range of them."""
        return len(self.subindices) == 1


def _rows(table: str) -> Iterator[Row]:
    for line in table.strip().splitlines():
        match = _ROW.fullmatch(line)
        assert match is not None, line
        first, last, low, high, type_code, access, mappable, names, default, node = match.groups()
        indices = range(int(first, 16), int(last or first, 16) + 1)
        subindices = range(int(low, 16), int(high or low, 16) + 1)
        pattern = Variable(
            indices.start,
            subindices.start,
            names,
            _TYPES[type_code],
            Access(access),
            default=None if default is None else int(default, 0),
            pdo_mappable=bool(mappable) or access == Access.RWW,
            adds_node_id=node is not None,
        )
        yield Row(indices, subindices, tuple(names.split("|")), pattern)


ROWS: Final = (*_rows(_COMMUNICATION), *_rows(_DRIVE))
"""Both tables, line by line."""
_RANGES: Final = tuple(row for row in ROWS if not row.is_field or len(row.indices) > 1)

STANDARD: Final[Mapping[tuple[int, int], Variable]] = MappingProxyType(
    {
        (row.indices.start, row.subindices.start): row.variable(row.indices.start, row.subindices.start)
        for row in ROWS
        if row not in _RANGES
    }
)
"""Every standard object that stands alone, by (index, subindex). With those of ranges (PDOs, error history): `find_standard`."""


def find_standard(index: int, subindex: int = 0) -> Variable | None:
    """Return a standard object, or None. Includes ranges of objects and the further axes of CiA 402."""
    return _find_standard(index, subindex)


@lru_cache(maxsize=4096)  # whoever builds many devices asks for the same objects again and again
def _find_standard(index: int, subindex: int) -> Variable | None:
    if index in indices.FURTHER_DEVICES:
        base = STANDARD.get((_home(index), subindex))
        axis = (index - 0x6000) // AXIS_STEP + 1
        if base is None:
            return None
        name, *aliases = (f"axis{axis}_{each}" for each in base.names)
        return replace(base, index=index, name=name, aliases=tuple(aliases))
    found = STANDARD.get((index, subindex))
    if found is None:
        for row in _RANGES:
            if index in row.indices and subindex in row.subindices:
                return row.variable(index, subindex)
    return found


def standard_variable(index: int, subindex: int = 0, **changes: Any) -> Variable:
    """Return a standard object with changes: `standard_variable(0x607A, default=0, low_limit=-180_000)`.

    changes: fields of `Variable` (default, access, low_limit, high_limit, pdo_mappable, name ...). No node-ID is added to a
    default given here. Raises ObjectNotFoundError if no standard has the object, TypeError for an unknown field.
    """
    found = find_standard(index, subindex)
    if found is None:
        raise ObjectNotFoundError(f"0x{index:04X}:{subindex:02X} is no object of CiA 301 or CiA 402")
    if "default" in changes:
        changes.setdefault("adds_node_id", False)
    return replace(found, **changes) if changes else found


def standard_object(
    index: int, default: Value | None = None, *, highest: int | None = None, defaults: Mapping[int, Value] | None = None
) -> Object:
    """Return a whole standard object: `standard_object(0x1017, 100)`, `standard_object(0x1600, highest=8)`.

    default: of subindex 0. defaults: by subindex; they count before `default`. highest: the last subindex; None = the last one
    with a row of its own, at least 1. Raises ObjectNotFoundError if no standard has the index or the highest subindex.
    """
    chosen: dict[int, Value] = {} if default is None else {0: default}
    chosen |= defaults or {}
    count = find_standard(index, 0)
    if count is not None and find_standard(index, 1) is None:
        object_type = ObjectType.DOMAIN if count.data_type is DataType.DOMAIN else ObjectType.VAR
        return Object.of(count.name, [_with_default(count, chosen)], object_type)

    record = standard_variable(index, 1).name.partition(":")[0]
    if highest is None:
        own_rows = (row.subindices.start for row in ROWS if _home(index) in row.indices and row.is_field)
        highest = max((1, *own_rows))
    if count is None:
        count = Variable(index, 0, f"{record}:highest_subindex", DataType.UNSIGNED8, Access.CONST, highest)
    fields = [standard_variable(index, subindex) for subindex in range(1, highest + 1)]
    is_array = len({each.data_type for each in fields}) == 1 and not any(index in each for each in _RECORDS)
    object_type = ObjectType.ARRAY if is_array else ObjectType.RECORD
    return Object.of(record, [_with_default(each, chosen) for each in (count, *fields)], object_type)


def _with_default(variable: Variable, chosen: Mapping[int, Value]) -> Variable:
    if variable.subindex not in chosen:
        return variable
    return replace(variable, default=chosen[variable.subindex], adds_node_id=False)


def _home(index: int) -> int:
    """Return the index of the same object in the first axis."""
    return 0x6000 + (index - 0x6000) % AXIS_STEP if index in indices.FURTHER_DEVICES else index
