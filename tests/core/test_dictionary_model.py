"""The object dictionary: look-ups by every kind of key, constants, PDO descriptions, dictionaries made out of others."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.datatypes import DataType, ValueRangeError
from canopen_proto.dictionary import (
    Access,
    Constant,
    ConstantNotFoundError,
    Direction,
    Filler,
    Key,
    Message,
    NotInDictionaryError,
    Object,
    ObjectDictionary,
    ObjectNotFoundError,
    ObjectType,
    PdoDescription,
    PdoNotFoundError,
    Variable,
)
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import mux

NMT = Variable(0x0000, 0, "NMT", DataType.UNSIGNED8, Access.WO)
NAME = Variable(0x1008, 0, "manufacturer_device_name", DataType.VISIBLE_STRING, Access.CONST, "drive")
EMCY = Variable(0x1014, 0, "cob_id_emergency", DataType.UNSIGNED32, default=0x80, adds_node_id=True)
CONTROLWORD = Variable(0x6040, 0, "controlword", DataType.UNSIGNED16, Access.RWW, pdo_mappable=True)
STATUSWORD = Variable(0x6041, 0, "statusword", DataType.UNSIGNED16, Access.RO, pdo_mappable=True)
IP_POSITION = Variable(0x60C1, 1, "interpolation_data_record:ip_data_position", DataType.INTEGER32, pdo_mappable=True)
TIME_UNITS = Variable(0x60C2, 1, "ip_time_units", DataType.UNSIGNED8)
TIME_INDEX = Variable(0x60C2, 2, "ip_time_index", DataType.INTEGER8, low_limit=-6, high_limit=0)
TORQUE = Variable(0x6077, 0, "torque_actual_value", DataType.INTEGER16, Access.RO, pdo_mappable=True)
FILLER = Filler("notused16", 16)
RPDO = PdoDescription("schunk_default_rPDO", 0x200, Direction.RPDO, 1, (CONTROLWORD, FILLER, IP_POSITION))

CONSTANTS = {
    NMT.mux: [Constant("start_remote_node", 0xFF, 0x01)],
    CONTROLWORD.mux: [
        Constant("sm_shutdown", 0xFFFF, 0x06),
        Constant("start_homing", 0xFFFF, 0x1F),
        Constant("enable_ip_mode", 0xFFFF, 0x1F),
    ],
    STATUSWORD.mux: [
        Constant("operation_enable", 0x6F, 0x27),
        Constant("homing_attained", 0x1000, 0x1000),
        Constant("set_point_acknowledge/speed_0/homing_attained/ip_mode_active", 0x1000, 0x1000),
    ],
    TIME_INDEX.mux: [Constant("milliseconds", 0xFF, 0xFD)],
}


@pytest.fixture
def dictionary() -> ObjectDictionary:
    objects = [Object.of(each.name, [each]) for each in (NMT, CONTROLWORD, STATUSWORD, TORQUE, NAME, EMCY)]
    objects.append(Object.of("interpolation_data_record", [IP_POSITION]))
    objects.append(Object.of("interpolation_time_period", [TIME_UNITS, TIME_INDEX]))
    return ObjectDictionary(objects, constants=CONSTANTS, pdos=[RPDO], fillers=[FILLER], source="indices.csv")


@pytest.mark.parametrize(
    ("key", "variable"),
    [
        ("statusword", STATUSWORD),
        ("Statusword", STATUSWORD),
        ("interpolation_data_record:ip_data_position", IP_POSITION),
        ("Interpolation data-record:IP data position", IP_POSITION),
        ("6041", STATUSWORD),
        ("0x6041", STATUSWORD),
        ("0X6041:00", STATUSWORD),
        ("6041.0", STATUSWORD),
        (" 60c2:0x2 ", TIME_INDEX),
        (0x6041, STATUSWORD),
        ((0x60C1, 1), IP_POSITION),
        (mux(0x60C1, 1), IP_POSITION),
        (mux(0x6041), STATUSWORD),
        (CONTROLWORD, CONTROLWORD),
        ("NMT", NMT),
    ],
)
def test_every_kind_of_key(dictionary: ObjectDictionary, key: Key, variable: Variable) -> None:
    assert dictionary.variable(key) is variable
    assert key in dictionary


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("statuswrod", "object 'statuswrod' is not in the dictionary (indices.csv); did you mean statusword?"),
        ("ip_data_positon", f"object 'ip_data_positon' is not in the dictionary (indices.csv); did you mean {IP_POSITION.name}?"),
        ("qqq", "object 'qqq' is not in the dictionary (indices.csv)"),
        ("notused16", "'notused16' is a filler of PDOs; it has no value"),
        (0x60C2, "object 0x60C2:00 is not in the dictionary (indices.csv); interpolation_time_period has subindex 1, 2"),
        ("60C2:03", "object 0x60C2:03 is not in the dictionary (indices.csv); interpolation_time_period has subindex 1, 2"),
        (0x7000, "object 0x7000:00 is not in the dictionary (indices.csv)"),
        ((0x6040, 0x100), "object 0x6040:100 is not in the dictionary (indices.csv); controlword has subindex 0"),
        (0, "object 0x0000:00 is not in the dictionary (indices.csv)"),
        (mux(0x60C1, 3), "object 0x60C1:03 is not in the dictionary (indices.csv); interpolation_data_record has subindex 1"),
        (0x60410, "object 0x60410:00 is not in the dictionary (indices.csv)"),
    ],
)
def test_a_key_that_is_not_there(dictionary: ObjectDictionary, key: Key, text: str) -> None:
    with pytest.raises(ObjectNotFoundError) as caught:
        dictionary.variable(key)
    assert str(caught.value).partition("; there are")[0] == text
    assert key not in dictionary
    assert isinstance(caught.value, LocalProtocolError)
    assert isinstance(caught.value, KeyError)


@given(st.one_of(st.text(), st.integers(), st.tuples(st.integers(), st.integers()), st.just("statusword" * 10**5)))
def test_any_key_gives_a_variable_or_object_not_found(key: Key) -> None:
    dictionary = ObjectDictionary([Object.of("statusword", [STATUSWORD])])
    try:
        assert dictionary.variable(key) is STATUSWORD
    except ObjectNotFoundError:
        assert key not in dictionary


def test_look_up_by_number(dictionary: ObjectDictionary) -> None:
    assert dictionary.get(0x6041) is STATUSWORD
    assert dictionary.get(0x60C2, 2) is TIME_INDEX
    assert dictionary.get(0x60C2, 3) is None
    assert dictionary.has_index(0x60C2)
    assert not dictionary.has_index(0x60C3)
    assert mux(0x60C2, 2) == TIME_INDEX.mux == 0x60C202


def test_a_pseudo_object_is_found_by_name_only(dictionary: ObjectDictionary) -> None:
    assert dictionary.get(0, 0) is None
    assert not dictionary.has_index(0)
    assert NMT not in list(dictionary)
    assert dictionary.constant_value("NMT", "start_remote_node") == 1


def test_iteration_is_by_index_and_subindex(dictionary: ObjectDictionary) -> None:
    muxes = [variable.mux for variable in dictionary]
    assert muxes == sorted(muxes)
    assert len(dictionary) == len(muxes) == 8
    assert list(dictionary.objects) == [0x1008, 0x1014, 0x6040, 0x6041, 0x6077, 0x60C1, 0x60C2]
    assert ObjectDictionary([])  # an empty dictionary is one, too
    assert 5.5 not in dictionary


def test_a_name_counts_before_a_number_and_an_exact_name_before_a_near_one() -> None:
    number = Variable(0x2000, 0, "6041", DataType.UNSIGNED8)
    upper = Variable(0x2001, 0, "STATUSWORD", DataType.UNSIGNED8)
    dictionary = ObjectDictionary([Object.of(each.name, [each]) for each in (STATUSWORD, number, upper)])
    assert dictionary.variable("6041") is number
    assert dictionary.variable("0x6041") is STATUSWORD
    assert dictionary.variable("statusword") is STATUSWORD
    assert dictionary.variable("STATUSWORD") is upper


# ---- constants ----


def test_matches_is_value_and_mask_equal_constant(dictionary: ObjectDictionary) -> None:
    assert dictionary.matches("statusword", "operation_enable", 0x1637)
    assert not dictionary.matches("statusword", "operation_enable", 0x1633)
    assert not dictionary.matches("statusword", "operation_enable", "x")
    assert dictionary.matches("ip_time_index", "milliseconds", -3)  # negative values count as two's complement


def test_a_value_bears_all_its_constants_in_the_order_of_the_file(dictionary: ObjectDictionary) -> None:
    assert dictionary.names_of("statusword", 0x1637) == (
        "operation_enable", "homing_attained", "set_point_acknowledge/speed_0/homing_attained/ip_mode_active",
    )  # fmt: skip
    assert dictionary.names_of("controlword", 0x1F) == ("start_homing", "enable_ip_mode")
    assert dictionary.names_of("manufacturer_device_name", "x") == ()
    assert dictionary.constants_of("torque_actual_value") == ()
    assert [each.name for each in dictionary.constants_of(CONTROLWORD)] == ["sm_shutdown", "start_homing", "enable_ip_mode"]


def test_a_constant_of_a_signed_object_is_written_as_a_negative_number(dictionary: ObjectDictionary) -> None:
    assert dictionary.constant_value("ip_time_index", "milliseconds") == -3
    assert dictionary.constant_value("controlword", "sm_shutdown") == 6


def test_what_a_caller_means(dictionary: ObjectDictionary) -> None:
    assert dictionary.value_from("controlword", "sm_shutdown") == 6
    assert dictionary.value_from("controlword", 7) == 7
    assert dictionary.value_from("manufacturer_device_name", "sm_shutdown") == "sm_shutdown"
    with pytest.raises(ConstantNotFoundError, match=r"^controlword \(0x6040:00\) has no constant 'sm_shutdwn'; did you mean sm_"):
        dictionary.value_from("controlword", "sm_shutdwn")
    with pytest.raises(ConstantNotFoundError, match=r"no constant 'zzz'; there are sm_shutdown, start_homing, enable_ip_mode$"):
        dictionary.matches("controlword", "zzz", 6)
    with pytest.raises(ConstantNotFoundError, match=r"torque_actual_value \(0x6077:00\) has no constant 'x'$"):
        dictionary.constant_value("torque_actual_value", "x")


@pytest.mark.parametrize(("text", "number"), [("5", 5), ("0x1F4", 500), ("-3", -3), ("007", 7)])
def test_a_number_given_as_text_is_no_constant_and_the_error_says_which_number_may_be_meant(
    dictionary: ObjectDictionary, text: str, number: int
) -> None:
    with pytest.raises(ConstantNotFoundError, match=rf"no constant '{text}': a number is expected; is {number} meant\?$"):
        dictionary.value_from("controlword", text)


@pytest.mark.parametrize("text", ["", "1.5", "nan", "\u00b2", "zzz", "controlword", "9" * 200, "0x" + "F" * 10_000])
def test_a_text_that_is_no_number_of_the_object_is_a_constant_that_it_has_not(dictionary: ObjectDictionary, text: str) -> None:
    with pytest.raises(ConstantNotFoundError, match=r"no constant '[^']*'(; there are .*)?$"):
        dictionary.value_from("controlword", text)


def test_a_message_shows_value_and_constants(dictionary: ObjectDictionary) -> None:
    message = dictionary.message(12, 0x6040, 0x1F, 77)
    assert message == Message(12, "controlword", 0x1F, ("start_homing", "enable_ip_mode"), 77)
    assert str(message) == "node 12 controlword = 31 (0x1F) [start_homing, enable_ip_mode]"
    assert str(dictionary.message(3, 0x1008, "drive")) == "node 3 manufacturer_device_name = 'drive'"
    assert str(dictionary.message(3, "ip_time_index", -3)) == "node 3 ip_time_index = -3 [milliseconds]"


# ---- variables ----


def test_access() -> None:
    assert [each for each in Access if not each.readable] == [Access.WO]
    assert [each for each in Access if not each.writable] == [Access.RO, Access.CONST]
    assert Access("rww") is Access.RWW


def test_a_variable_knows_its_lengths_and_names() -> None:
    assert (IP_POSITION.size, IP_POSITION.bit_length) == (4, 32)
    assert (NAME.size, NAME.bit_length) == (None, None)
    assert Variable(0x2000, 1, "switch", DataType.BOOLEAN).bit_length == 1
    assert str(TIME_INDEX) == TIME_INDEX.label == "ip_time_index (0x60C2:02)"
    assert Variable(0x2000, 0, "a", DataType.BOOLEAN, aliases=("b", "c")).names == ("a", "b", "c")


def test_encoding_names_the_object() -> None:
    assert TORQUE.decode(TORQUE.encode(-5)) == -5
    with pytest.raises(ValueRangeError, match=r"^torque_actual_value \(0x6077:00\): 40000 is outside -32768\.\.32767"):
        TORQUE.encode(40_000)
    with pytest.raises(ValueRangeError, match=r"^torque_actual_value \(0x6077:00\): INTEGER16 has 2 bytes, not 4"):
        TORQUE.decode(bytes(4))


def test_limits() -> None:
    for value in (-6, -3, 0):
        TIME_INDEX.check_limits(value)
    for value in (-7, 1):
        with pytest.raises(ValueRangeError, match=rf"ip_time_index \(0x60C2:02\): {value} is outside -6\.\.0 \(limits"):
            TIME_INDEX.check_limits(value)
    only_low = Variable(0x2000, 0, "speed", DataType.REAL32, low_limit=0.5)
    only_low.check_limits(1e9)
    only_low.check_limits("no number, no limits")
    with pytest.raises(ValueRangeError, match=r"0\.25 is outside 0\.5\.\. "):
        only_low.check_limits(0.25)
    with pytest.raises(ValueRangeError, match=r"9 is outside \.\.8 "):
        Variable(0x2000, 0, "speed", DataType.UNSIGNED8, high_limit=8).check_limits(9)


def test_defaults() -> None:
    assert EMCY.default_of(12) == 0x8C
    assert NAME.default_of(12) == "drive"
    assert TORQUE.default_of(12) == 0


def test_objects() -> None:
    assert Object.of("x", [TORQUE]).object_type is ObjectType.VAR
    assert Object.of("x", [TIME_UNITS, TIME_INDEX]).object_type is ObjectType.RECORD
    assert Object.of("x", [TIME_UNITS], ObjectType.ARRAY).object_type is ObjectType.ARRAY


def test_a_description_cannot_be_changed(dictionary: ObjectDictionary) -> None:
    with pytest.raises(TypeError):
        dictionary.objects[1] = dictionary.objects[0x6040]  # type: ignore[index]
    with pytest.raises(TypeError):
        dictionary.objects[0x6040].variables[1] = TORQUE  # type: ignore[index]


def test_a_variable_is_a_value() -> None:
    """Equal by what it says, and usable as a key; its label is made when it is asked for, and is no part of that."""
    twin = replace(STATUSWORD)
    assert STATUSWORD.label == "statusword (0x6041:00)"
    assert (twin, hash(twin), repr(twin)) == (STATUSWORD, hash(STATUSWORD), repr(STATUSWORD))
    assert (twin.mux, twin.size, twin.bit_length, twin.label) == (0x604100, 2, 16, STATUSWORD.label)
    renamed = replace(STATUSWORD, name="x")
    assert renamed != STATUSWORD
    assert renamed.label == "x (0x6041:00)"


def test_variables_come_in_order_whatever_order_they_were_given_in() -> None:
    numbers = (2, 0, 1)
    record = Object.of("r", [Variable(0x2000, subindex, str(subindex), DataType.UNSIGNED8) for subindex in numbers])
    assert [each.subindex for each in ObjectDictionary([record])] == [0, 1, 2]


# ---- names of fields ----


def field_of(index: int, name: str) -> Object:
    count = Variable(index, 0, "Highest sub-index supported", DataType.UNSIGNED8)
    return Object(index, name, ObjectType.RECORD, {0: count, 1: Variable(index, 1, "COB-ID", DataType.UNSIGNED32)})


def test_a_field_is_found_by_its_records_name_and_by_its_own_where_that_is_enough() -> None:
    alone = ObjectDictionary([field_of(0x1800, "TPDO 1")])
    assert alone.variable("COB-ID").mux == alone.variable("tpdo 1:cob-id").mux == 0x180001
    both = ObjectDictionary([field_of(0x1800, "TPDO 1"), field_of(0x1801, "TPDO 2")])
    assert both.variable("TPDO 1:COB-ID").mux == 0x180001
    assert both.variable("TPDO 2:COB-ID").mux == 0x180101
    with pytest.raises(ObjectNotFoundError, match=r"2 objects have a field 'COB-ID'; say which one, as 'TPDO 1:COB-ID'"):
        both.variable("COB-ID")


def test_an_object_goes_before_a_field_of_its_name() -> None:
    objects = [Object.of("COB-ID", [Variable(0x2000, 0, "COB-ID", DataType.UNSIGNED32)]), field_of(0x1800, "TPDO 1")]
    assert ObjectDictionary(objects).variable("COB-ID").mux == 0x200000


# ---- PDOs ----


def test_pdo_descriptions(dictionary: ObjectDictionary) -> None:
    assert dictionary.pdo("schunk_default_rPDO") is RPDO
    assert RPDO.bit_length == 64
    assert RPDO.can_id(12) == 0x20C
    assert dictionary.fillers == {"notused16": FILLER}
    with pytest.raises(PdoNotFoundError, match="PDO 'schunk_default_tPDO' is not .*did you mean schunk_default_rPDO"):
        dictionary.pdo("schunk_default_tPDO")
    assert issubclass(PdoNotFoundError, NotInDictionaryError)


# ---- dictionaries made out of others ----


def test_with_objects_adds_and_replaces(dictionary: ObjectDictionary) -> None:
    wide = Variable(0x6077, 0, "torque", DataType.INTEGER32)
    new = Variable(0x2000, 0, "new", DataType.UNSIGNED8)
    other = dictionary.with_objects([Object.of("torque", [wide]), Object.of("new", [new])], source="mine")
    assert other.get(0x6077) is wide
    assert other.variable("new") is new
    assert other.variable("NMT") is NMT
    assert other.pdo("schunk_default_rPDO") is RPDO
    assert other.constant_value("controlword", "sm_shutdown") == 6
    assert (other.source, other.with_objects([]).source) == ("mine", "mine")
    assert dictionary.get(0x6077) is TORQUE  # the old one is as it was
    assert ObjectDictionary([]).with_objects([Object.of("new", [new])]).variable("new") is new


def test_with_names_of_gives_the_objects_of_an_eds_the_names_of_the_csv_files(dictionary: ObjectDictionary) -> None:
    objects = [
        Variable(0x6040, 0, "Control word", DataType.UNSIGNED16, Access.RWW),
        Variable(0x6041, 0, "statusword", DataType.UNSIGNED16, Access.RO),
        Variable(0x60C1, 1, "ip data", DataType.INTEGER32, Access.RWW),
        Variable(0x2000, 0, "own", DataType.UNSIGNED8),
    ]
    own = {0x600000: (), objects[1].mux: (Constant("own", 0x1, 0x1), Constant("operation_enable", 0xFF, 0x37))}
    eds = ObjectDictionary([Object.of(each.name, [each]) for each in objects], constants=own, source="drive.eds")
    named = eds.with_names_of(dictionary)
    assert named.variable("controlword").access is Access.RWW
    assert named.variable("Control word") is named.variable("controlword")
    assert named.variable("statusword").aliases == ()
    assert named.get(0x6077) is None
    assert named.variable("NMT") is NMT
    assert named.source == "drive.eds"
    assert [each.name for each in named.constants_of("statusword")] == [
        "operation_enable", "homing_attained", "set_point_acknowledge/speed_0/homing_attained/ip_mode_active", "own",
    ]  # fmt: skip
    assert named.matches("statusword", "operation_enable", 0x27)
    assert named.pdo("schunk_default_rPDO").entries == (named.variable(0x6040), FILLER, named.variable((0x60C1, 1)))
    assert eds.pdos == ()


def test_with_names_of_leaves_out_pdos_that_the_device_cannot_have(dictionary: ObjectDictionary) -> None:
    narrow = Variable(0x6040, 0, "cw", DataType.UNSIGNED8)
    bare = ObjectDictionary([Object.of("cw", [narrow])])
    assert bare.with_names_of(dictionary).pdos == ()
    assert bare.with_names_of(bare).variable("cw").name == "cw"


def test_a_number_is_a_multiplexer_only_if_it_has_six_digits() -> None:
    """The mux of the data type at 0x0010 is 0x1000, which as a number means the device type."""
    objects = [
        Object.of(name, [Variable(index, 0, name, DataType.UNSIGNED32)])
        for index, name in ((0x10, "INTEGER24"), (0x1000, "type"))
    ]
    dictionary = ObjectDictionary(objects)
    assert dictionary.variable(0x1000).name == dictionary.variable(0x1000_00).name == "type"
    with pytest.raises(ObjectNotFoundError, match="0x2000:01 is not"):
        dictionary.variable(0x2000_01)
