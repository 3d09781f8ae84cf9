"""The standard's objects: spot values, ranges, further axes, and the objects that helpers build from them."""

from __future__ import annotations

import pytest

from canopen_proto import indices
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, ObjectDictionary, ObjectNotFoundError, ObjectType
from canopen_proto.dictionary.standard import STANDARD, find_standard, standard_object, standard_variable


@pytest.mark.parametrize(
    ("index", "subindex", "name", "data_type", "access"),
    [
        (0x1000, 0, "device_type", DataType.UNSIGNED32, Access.RO),
        (0x1003, 0, "predefined_error_field:number_of_errors", DataType.UNSIGNED8, Access.RW),
        (0x1003, 254, "predefined_error_field:standard_error_field_254", DataType.UNSIGNED32, Access.RO),
        (0x1008, 0, "manufacturer_device_name", DataType.VISIBLE_STRING, Access.CONST),
        (0x1016, 127, "consumer_heartbeat_time:consumer_127", DataType.UNSIGNED32, Access.RW),
        (0x1200, 1, "sdo_server_parameter:cob_id_client_to_server", DataType.UNSIGNED32, Access.RO),
        (0x1201, 3, "sdo_server_2_parameter:node_id_of_client", DataType.UNSIGNED8, Access.RW),
        (0x127F, 2, "sdo_server_128_parameter:cob_id_server_to_client", DataType.UNSIGNED32, Access.RW),
        (0x1281, 3, "sdo_client_2_parameter:node_id_of_server", DataType.UNSIGNED8, Access.RW),
        (0x1400, 2, "rpdo1_communication_parameter:transmission_type", DataType.UNSIGNED8, Access.RW),
        (0x15FF, 1, "rpdo512_communication_parameter:cob_id", DataType.UNSIGNED32, Access.RW),
        (0x1603, 64, "rpdo4_mapping_parameter:object_64", DataType.UNSIGNED32, Access.RW),
        (0x1802, 5, "tpdo3_communication_parameter:event_timer", DataType.UNSIGNED16, Access.RW),
        (0x1A00, 0, "tpdo1_mapping_parameter:number_of_mapped_objects", DataType.UNSIGNED8, Access.RW),
        (0x1F22, 127, "concise_dcf:node_127", DataType.DOMAIN, Access.RW),
        (0x1F50, 1, "program_data:program_1", DataType.DOMAIN, Access.WO),
        (0x1F51, 1, "program_control:program_1", DataType.UNSIGNED8, Access.RW),
        (0x1F56, 1, "program_software_identification:program_1", DataType.UNSIGNED32, Access.RO),
        (0x1F80, 0, "nmt_startup", DataType.UNSIGNED32, Access.RW),
        (0x1F82, 128, "request_nmt:node_128", DataType.UNSIGNED8, Access.RW),
        (0x1F8A, 5, "restore_configuration:node_5", DataType.UNSIGNED8, Access.RW),
        (0x6040, 0, "controlword", DataType.UNSIGNED16, Access.RWW),
        (0x6060, 0, "modes_of_operation", DataType.INTEGER8, Access.RWW),
        (0x6064, 0, "position_actual_value", DataType.INTEGER32, Access.RO),
        (0x6077, 0, "torque_actual_value", DataType.INTEGER16, Access.RO),
        (0x60C1, 1, "interpolation_data_record:ip_data_position", DataType.INTEGER32, Access.RWW),
        (0x60C4, 6, "interpolation_data_configuration:buffer_clear", DataType.UNSIGNED8, Access.WO),
        (0x6502, 0, "supported_drive_modes", DataType.UNSIGNED32, Access.RO),
    ],
)
def test_spot_values(index: int, subindex: int, name: str, data_type: DataType, access: Access) -> None:
    found = find_standard(index, subindex)
    assert found is not None
    assert (found.index, found.subindex, found.name, found.data_type, found.access) == (index, subindex, name, data_type, access)


@pytest.mark.parametrize(
    "where",
    [(0x1003, 255), (0x1004, 0), (0x1018, 5), (0x1200, 3), (0x1400, 7), (0x1600, 65), (0x1300, 1), (0x2000, 0), (0x6041, 1)],
)
def test_what_no_standard_knows(where: tuple[int, int]) -> None:
    assert find_standard(*where) is None
    with pytest.raises(ObjectNotFoundError, match="is no object of CiA 301 or CiA 402"):
        standard_variable(*where)


def test_only_what_a_pdo_may_carry_is_mappable() -> None:
    mappable = {key for key, each in STANDARD.items() if each.pdo_mappable}
    assert {(0x1001, 0), (0x6040, 0), (0x6041, 0), (0x60C1, 1), (0x6060, 0), (0x6077, 0)} <= mappable
    assert not {(0x1017, 0), (0x605A, 0), (0x60C4, 6)} & mappable
    assert all(each.access is not Access.RW for each in STANDARD.values() if each.pdo_mappable)


def test_names_are_unique() -> None:
    names = [name for each in STANDARD.values() for name in each.names]
    assert len(names) == len(set(names))
    assert find_standard(0x60C2, 2).names == ("interpolation_time_period:ip_time_index", "ip_time_index")  # type: ignore[union-attr]


def test_a_second_axis_is_0x800_further_on() -> None:
    second = find_standard(0x6864)
    assert second is not None
    assert (second.name, second.index, second.data_type) == ("axis2_position_actual_value", 0x6864, DataType.INTEGER32)
    assert find_standard(0x60C2 + 0x800, 1).names == (  # type: ignore[union-attr]
        "axis2_interpolation_time_period:ip_time_units", "axis2_ip_time_units",
    )  # fmt: skip
    assert find_standard(0x9FFF) is not None  # single device type of the eighth
    assert find_standard(0xA064) is None
    assert find_standard(0x6865, 1) is None
    limits = standard_object(0x687D)
    assert limits.variables[1].name == "axis2_software_position_limit:min"


def test_a_variable_with_changes() -> None:
    position = standard_variable(0x607A, default=5, low_limit=-10, high_limit=10, access=Access.RW)
    assert (position.default, position.low_limit, position.high_limit, position.access) == (5, -10, 10, Access.RW)
    assert standard_variable(0x1014).default_of(12) == 0x8C
    assert standard_variable(0x1014, default=0x80000000).default_of(12) == 0x80000000
    assert standard_variable(0x60C2, 2).default == -3
    with pytest.raises(TypeError):
        standard_variable(0x607A, colour="red")


def test_a_plain_object() -> None:
    heartbeat = standard_object(0x1017, 100)
    assert (heartbeat.name, heartbeat.object_type) == ("producer_heartbeat_time", ObjectType.VAR)
    assert heartbeat.variables[0].default == 100
    assert standard_object(0x1017).variables[0].default is None
    assert standard_object(0x1021).object_type is ObjectType.DOMAIN


def test_a_record_has_its_highest_subindex() -> None:
    identity = standard_object(0x1018, defaults={1: 0x2A, 4: 7})
    assert (identity.name, identity.object_type) == ("identity_object", ObjectType.RECORD)
    assert [identity.variables[sub].default for sub in range(5)] == [4, 0x2A, None, None, 7]
    assert identity.variables[0].access is Access.CONST
    assert identity.variables[0].name == "identity_object:highest_subindex"
    assert standard_object(0x1018, highest=1).variables[0].default == 1


def test_arrays_and_open_ends() -> None:
    history = standard_object(0x1003, 0, highest=8)
    assert (history.object_type, list(history.variables)) == (ObjectType.ARRAY, list(range(9)))
    assert (history.variables[0].access, history.variables[0].default) == (Access.RW, 0)
    assert list(standard_object(0x1003).variables) == [0, 1]
    assert list(standard_object(0x1010).variables) == [0, 1, 2, 3]
    assert standard_object(0x60C2).object_type is ObjectType.RECORD  # its fields are of two types
    assert standard_object(0x6099).object_type is ObjectType.ARRAY
    assert standard_object(0x1016, highest=3).variables[0].default == 3
    assert list(standard_object(0x1016, highest=0).variables) == [0]


def test_pdo_parameters() -> None:
    mapping = standard_object(0x1600, 2, highest=8, defaults={1: 0x60400010, 2: 0x60C10120})
    assert (mapping.name, mapping.object_type) == ("rpdo1_mapping_parameter", ObjectType.RECORD)
    assert [mapping.variables[sub].default for sub in (0, 1, 2, 3)] == [2, 0x60400010, 0x60C10120, None]
    communication = standard_object(0x1800, defaults={1: 0x181, 2: 1})
    assert [communication.variables[sub].default for sub in range(7)] == [6, 0x181, 1, None, None, None, None]


def test_what_cannot_be_built() -> None:
    for index, highest in ((0x2000, None), (0x1018, 5), (0x1600, 65)):
        with pytest.raises(ObjectNotFoundError):
            standard_object(index, highest=highest)


def test_a_dictionary_of_all_of_it() -> None:
    dictionary = ObjectDictionary(standard_object(index) for index in sorted({index for index, _ in STANDARD}))
    assert dictionary.variable("statusword").data_type is DataType.UNSIGNED16
    assert dictionary.variable("ip_time_index").subindex == 2


def test_the_indices_are_called_as_the_standard_calls_them() -> None:
    named = {
        name: index
        for name, index in vars(indices).items()
        if name.isupper() and isinstance(index, int) and index < indices.STORE_DCF
    }
    assert len(named) > 30
    assert {name.lower(): index for name, index in named.items()} == {standard_object(each).name: each for each in named.values()}
