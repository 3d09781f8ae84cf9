"""The manual's three CSV formats: what they mean, and errors that name file, line and column."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_data.csv import load_csv
from canopen_data.findings import MAX_SHOWN, DictionaryError, Finding, Severity
from canopen_data.rows import read_constants, read_indices, read_pdos
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Direction, Filler, ObjectDictionary
from canopen_proto.machine import LocalProtocolError

INDICES = """\
notused16 0xFFFF 0xFF\t2 rw
notused64 0xFFFF 0xFD 8 rw
NMT 0x0000 0x0 1 wo
interpolation_data_record:ip_data_position 0x60C1 0x1 4 rw
sync_timeout_factor 0x200E 0x0 1 rw

# the words
controlword 0x6040 0x0 2 rw
statusword 6041 0 2 ro        # without 0x
modes_of_operation 0x6060 0x0 1 wo
torque_actual_value 0x6077 0x0 2 ro
position_actual_value 0x6064 0x0 4 ro
ip_time_units 0x60C2 0x1 1 rw
ip_time_index 0x60C2 0x2 1 rw
"""
CONSTANTS = """\
NMT start_remote_node 0xFF 0x01
controlword sm_shutdown 0xFFFF 6
controlword start_homing|enable_ip_mode 0xFFFF 0x1F
controlword start_homing FFFF 1F
statusword operation_enable 0x6F 0x27
statusword set_point_acknowledge/speed_0/homing_attained/ip_mode_active 0x1000 0x1000
ip_time_index milliseconds 0xFF 0xFD
modes_of_operation ten 0xFF 0x10
"""
PDOS = """\
schunk_default_rPDO 0x200 controlword notused16 interpolation_data_record:ip_data_position
schunk_default_tPDO 180 statusword torque_actual_value position_actual_value
schunk_debug_rPDO 0x480 notused64
"""


def errors_of(indices: str = INDICES, constants: str = "", pdos: str = "") -> list[str]:
    with pytest.raises(DictionaryError) as caught:
        load_csv(indices, constants, pdos)
    return [caught.value.failed, *caught.value.also]


def load(indices: str = INDICES, constants: str = CONSTANTS, pdos: str = PDOS) -> ObjectDictionary:
    return load_csv(indices, constants, pdos)[0]


# ---- indices.csv ----


def test_objects_of_the_manual() -> None:
    dictionary = load()
    assert len(dictionary) == 9
    statusword = dictionary.variable("statusword")
    assert (statusword.index, statusword.subindex, statusword.size, statusword.access) == (0x6041, 0, 2, Access.RO)
    assert dictionary.variable((0x60C1, 1)).name == "interpolation_data_record:ip_data_position"
    assert dictionary.objects[0x60C1].name == "interpolation_data_record"
    assert dictionary.objects[0x6041].name == "statusword"
    assert dictionary.objects[0x60C2].name == "object_60C2"
    assert dictionary.source == "indices.csv"


def test_a_pseudo_object_and_fillers_are_no_objects_of_a_device() -> None:
    dictionary = load()
    assert dictionary.constant_value("NMT", "start_remote_node") == 1
    assert not dictionary.has_index(0x0000)
    assert not dictionary.has_index(0xFFFF)
    assert dictionary.fillers == {"notused16": Filler("notused16", 16), "notused64": Filler("notused64", 64)}


def test_types_come_from_the_standard_where_the_length_is_the_same() -> None:
    text = "name 0x1008 0 - ro\nblob 0x2001 0 - rw\nodd 0x2002 0 3 rw\nlong 0x2003 0 8 rw\nwrong 0x606C 0 2 ro\n"
    text += "pos 0x6864 0 4 ro\n"
    dictionary = load(INDICES + text)
    types = {
        "position_actual_value": DataType.INTEGER32,
        "ip_time_index": DataType.INTEGER8,
        "ip_time_units": DataType.UNSIGNED8,
        "sync_timeout_factor": DataType.UNSIGNED8,
        "name": DataType.VISIBLE_STRING,
        "blob": DataType.OCTET_STRING,
        "odd": DataType.UNSIGNED24,
        "long": DataType.UNSIGNED64,
        "wrong": DataType.UNSIGNED16,
        "pos": DataType.INTEGER32,  # the second axis
    }
    assert {name: dictionary.variable(name).data_type for name in types} == types
    assert dictionary.variable("odd").pdo_mappable
    assert not dictionary.variable("blob").pdo_mappable
    assert dictionary.variable("statusword").pdo_mappable


def test_any_white_space_separates_and_modes_may_be_in_capitals() -> None:
    dictionary = load("\ufeffa\t0x2000\t\t0 1\x0bRW\r\n\r\n  b  2001  1f  2  WO  \r\n", "", "")
    assert (dictionary.variable("a").access, dictionary.variable("b").access) == (Access.RW, Access.WO)
    assert dictionary.variable("b").subindex == 0x1F


def test_two_aliases_of_one_object() -> None:
    dictionary, findings = load_csv("position 0x6064 0 4 ro\npos 0x6064 0 4 rw\n", "pos zero 0xFFFFFFFF 0x0")
    assert dictionary.variable("pos") is dictionary.variable("position")
    assert dictionary.variable("pos").access is Access.RO
    assert dictionary.names_of("position", 0) == ("zero",)
    assert [each.code for each in findings] == ["two-aliases", "read-only"]


@pytest.mark.parametrize(
    ("line", "place", "text"),
    [
        ("a 0x2000 0 1", "2:12", "a row has 5 columns (alias, index, subindex, length, mode), not 4, ending at '1' [columns]"),
        ("a 0x2000 0 1 rw extra 7", "2:17", "(alias, index, subindex, length, mode), not 7, ending at '7' [columns]"),
        ("a,0x2000,0,1,rw", "2:1", "not 1, ending at 'a,0x2000,0,1,rw' (columns are separated by white space) [columns]"),
        ("a 0x20G0 0 1 rw", "2:3", "index '0x20G0' is not a hexadecimal number of at most 64 bits [number]"),
        ("a 0x12345 0 1 rw", "2:3", "index 0x12345 is more than 0xFFFF [number]"),
        ("a 2_0 0 1 rw", "2:3", "index '2_0' is not a hexadecimal number of at most 64 bits [number]"),
        ("a 0x2000 100 1 rw", "2:10", "subindex 0x100 is more than 0xFF [number]"),
        ("a 0x2000 -1 1 rw", "2:10", "subindex '-1' is not a hexadecimal number of at most 64 bits [number]"),
        ("a 0x2000 0 9 rw", "2:12", "length '9' is not 1 to 8 bytes (decimal), nor - for any length [length]"),
        ("a 0x2000 0 0x2 rw", "2:12", "length '0x2' is not 1 to 8 bytes (decimal), nor - for any length [length]"),
        ("a 0x2000 0 \u0661 rw", "2:12", "length '\\u0661' is not 1 to 8 bytes (decimal), nor - for any length [length]"),
        ("a 0x2000 0 2 r", "2:14", "mode 'r' is not ro, rw or wo [mode]"),
        ("b 0x2000 0 2 rw", "2:1", "'b' is in line 1 already [duplicate-alias]"),
        ("c 0x1FFF 0 2 rw", "2:12", "0x1FFF:00 has another length than as 'b' in line 1 [length]"),
        ("pad 0xFFFF 0 - rw", "2:14", "'pad' is a filler of PDOs, which needs a length [length]"),
    ],
)
def test_an_error_in_indices_names_file_line_and_column(line: str, place: str, text: str) -> None:
    (error,) = errors_of("b 0x1FFF 0 4 rw\n" + line)
    assert error.startswith(f"indices.csv:{place}: error: ")
    assert error.endswith(text)


# ---- constants.csv ----


def test_values_are_hexadecimal_with_and_without_0x() -> None:
    dictionary = load()
    assert dictionary.constant_value("modes_of_operation", "ten") == 0x10
    assert dictionary.names_of("controlword", 0x1F) == ("start_homing|enable_ip_mode", "start_homing")
    assert dictionary.matches("statusword", "operation_enable", 0x1637)
    assert dictionary.constant_value("ip_time_index", "milliseconds") == -3
    assert dictionary.names_of("ip_time_index", -3) == ("milliseconds",)


@pytest.mark.parametrize(
    ("line", "place", "text"),
    [
        ("controlword x 0xFFFF", "2:15", "(alias of an object, name, mask, value), not 3, ending at '0xFFFF' [columns]"),
        ("controlword x FFFF 0xXY", "2:20", "value '0xXY' is not a hexadecimal number of at most 64 bits [number]"),
        ("controlword x 10000000000000000 1", "2:15", "is not a hexadecimal number of at most 64 bits [number]"),
        ("controlwrd x 0xFFFF 1", "2:1", "no object 'controlwrd' in indices.csv; did you mean controlword? [unknown-alias]"),
        ("controlword a 0xFF 1", "2:13", "'a' is in line 1 already [duplicate-alias]"),
        ("cw a 0xFF 1", "2:4", "controlword (0x6040:00) has a constant 'a' already [duplicate-alias]"),
        ("notused16 a 0xFF 1", "2:1", "'notused16' is a filler of PDOs; it has no constants [filler]"),
    ],
)
def test_an_error_in_constants_names_file_line_and_column(line: str, place: str, text: str) -> None:
    (error,) = errors_of(INDICES + "cw 0x6040 0 2 rw\n", "controlword a 0xFFFF 0x1\n" + line)
    assert error.startswith(f"constants.csv:{place}: error: ")
    assert error.endswith(text)


# ---- PDOs.csv ----


def test_pdos_of_the_manual() -> None:
    dictionary = load()
    rpdo, tpdo, debug = dictionary.pdos
    assert (rpdo.direction, rpdo.number, rpdo.cob_base, rpdo.bit_length) == (Direction.RPDO, 1, 0x200, 64)
    assert rpdo.entries[0] is dictionary.variable("controlword")
    assert rpdo.entries[1] == Filler("notused16", 16)
    assert (tpdo.direction, tpdo.number, tpdo.can_id(12)) == (Direction.TPDO, 1, 0x18C)
    assert (debug.direction, debug.number) == (Direction.TPDO, 4)  # its COB-ID counts, not its name


@pytest.mark.parametrize(
    ("cob_base", "alias", "direction", "number"),
    [
        (0x180, "x", Direction.TPDO, 1),
        (0x200, "x", Direction.RPDO, 1),
        (0x280, "x", Direction.TPDO, 2),
        (0x300, "x", Direction.RPDO, 2),
        (0x380, "x", Direction.TPDO, 3),
        (0x400, "x", Direction.RPDO, 3),
        (0x480, "x", Direction.TPDO, 4),
        (0x500, "x", Direction.RPDO, 4),
        (0x680, "my_RPDO_5", Direction.RPDO, None),
        (0x681, "tPDO", Direction.TPDO, None),
        (0x200, "tPDO", Direction.RPDO, 1),
        (0x200, "both_rPDO_tPDO", Direction.RPDO, 1),
    ],
)
def test_the_direction_of_a_pdo(cob_base: int, alias: str, direction: Direction, number: int | None) -> None:
    (pdo,) = load("a 0x2000 0 8 rw", "", f"{alias} 0x{cob_base:X} a").pdos
    assert (pdo.direction, pdo.number) == (direction, number)


@pytest.mark.parametrize(
    ("line", "place", "text"),
    [
        ("x_rPDO 0x200", "2:8", "a PDO needs an alias, a COB-ID and objects, not 2, ending at '0x200' [columns]"),
        ("x_rPDO 0x0 controlword", "2:8", "COB-ID 0 is that of NMT; a PDO cannot have it [cob-id]"),
        ("x_rPDO 0x781 controlword", "2:8", "COB-ID 0x781 is more than 0x780 [number]"),
        ("x_rPDO 2h0 controlword", "2:8", "COB-ID '2h0' is not a hexadecimal number of at most 64 bits [number]"),
        ("x_rPDO 0x200 controlwrod", "2:14", "no object 'controlwrod' in indices.csv; did you mean controlword? [unknown-alias]"),
        ("x_rPDO 0x200 notused64 controlword statusword", "2:24", "'x_rPDO' has more than 8 bytes [pdo-too-long]"),
        ("x_rPDO 0x200 name", "2:14", "'name' has no fixed length: a PDO cannot carry it [pdo-entry]"),
        ("x 0x680 statusword", "2:1", "set, so the alias must say rPDO or tPDO [pdo-direction]"),
        ("first_tPDO 0x180 statusword", "2:1", "'first_tPDO' is in line 1 already [duplicate-alias]"),
    ],
)  # fmt: skip
def test_an_error_in_pdos_names_file_line_and_column(line: str, place: str, text: str) -> None:
    (error,) = errors_of(INDICES + "name 0x1008 0 - ro\n", "", "first_tPDO 0x180 notused64\n" + line)
    assert error.startswith(f"PDOs.csv:{place}: error: ")
    assert error.endswith(text)


# ---- all three ----


def test_all_errors_of_all_files_come_at_once_in_their_order() -> None:
    with pytest.raises(DictionaryError) as caught:
        load_csv("a 0x2000 0 1 rx\nb 0x2000 0 1\n", "c x 1 1\n", "d 0x200 e\n", sources=("/home/me/i.csv", "c.csv", "p.csv"))
    error = caught.value
    assert [(each.source, each.line, each.column, each.code) for each in error.findings] == [
        ("/home/me/i.csv", 1, 14, "mode"), ("/home/me/i.csv", 2, 12, "columns"),
        ("c.csv", 1, 1, "unknown-alias"), ("p.csv", 1, 9, "unknown-alias"),
    ]  # fmt: skip
    assert (error.source, error.line, error.column) == ("/home/me/i.csv", 1, 14)
    assert isinstance(error, LocalProtocolError)


def test_an_object_with_an_error_of_its_own_is_no_unknown_alias_as_well() -> None:
    assert len(errors_of("controlword 0x6040 0 2 r\n", "controlword a 0xFF 0x1", "x_rPDO 0x200 controlword")) == 1


def test_a_long_list_of_errors_is_cut() -> None:
    lines = errors_of("x\n" * 1000)
    assert len(lines) == MAX_SHOWN + 1
    assert lines[-1] == f"{1000 - MAX_SHOWN} more errors"
    assert len(errors_of("x" * 5000)[0]) < 250
    assert len(errors_of(INDICES, "controlwordx a 1 1\n" * 5000)) == MAX_SHOWN + 1  # in no time


def test_nothing_at_all_is_a_dictionary_with_a_warning() -> None:
    dictionary, findings = load_csv("# no object\n\n")
    assert len(dictionary) == 0
    assert findings == [Finding(Severity.WARNING, "empty", "there is no object in this file", "indices.csv")]
    assert str(findings[0]) == "indices.csv: warning: there is no object in this file [empty]"


def test_each_file_can_be_parsed_alone() -> None:
    findings: list[Finding] = []
    assert [row.alias.text for row in read_indices(INDICES, "mine.csv", findings)][:3] == ["notused16", "notused64", "NMT"]
    assert [row.value for row in read_constants(CONSTANTS, "mine.csv", findings)][:3] == [1, 6, 0x1F]
    assert [row.cob_base for row in read_pdos(PDOS, "mine.csv", findings)] == [0x200, 0x180, 0x480]
    assert not findings
    for read in (read_indices, read_constants, read_pdos):
        assert not list(read("a 1", "mine.csv", findings))
    assert [(each.source, each.line) for each in findings] == [("mine.csv", 1)] * 3


WORD = st.sampled_from(
    [
        *("a", "b", "statusword", "notused16", "pdo_rPDO", "é", ",", "#"),
        *("0x6041", "6064", "0xFFFF", "0x200", "200", "0", "0x0", "0x1", "FF", "10"),
        *("1", "2", "4", "8", "-", "ro", "rw", "wo"),
    ]
)
LINES = st.lists(st.lists(WORD, max_size=7).map(" ".join), max_size=8).map("\n".join)
TEXT = st.one_of(st.text(), LINES)


@given(TEXT, TEXT, TEXT)
def test_any_text_gives_a_dictionary_or_a_dictionary_error(indices: str, constants: str, pdos: str) -> None:
    try:
        dictionary, findings = load_csv(indices, constants, pdos)
    except DictionaryError as error:
        assert error.findings
        return
    assert all(each.severity is Severity.WARNING for each in findings)
    assert all(pdo.bit_length <= 64 for pdo in dictionary.pdos)


@given(LINES)
def test_what_was_loaded_can_be_found(indices: str) -> None:
    try:
        dictionary, _ = load_csv(indices)
    except DictionaryError:
        return
    for row in read_indices(indices, "indices.csv", []):
        if row.index == 0xFFFF:
            assert row.alias.text in dictionary.fillers
        else:
            variable = dictionary.variable(row.alias.text)
            assert (variable.index, variable.subindex, variable.size) == (row.index, row.subindex, row.length)
