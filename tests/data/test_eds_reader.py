"""Objects out of EDS and DCF files: one small file for each trait that files in the field have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from canopen_data.checks import check
from canopen_data.description import FileKind
from canopen_data.descriptions import read_file
from canopen_data.eds import EdsDocument, read_eds
from canopen_data.findings import DictionaryError, Severity
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectType, Values, Variable
from canopen_proto.machine import LocalProtocolError
from tests.vendor_files import INI_NAMES, load, needs_vendor_files

DATA = Path(__file__).parents[1] / "files"

VAR = "[2000]\nParameterName=x\nObjectType=7\nDataType=0x0007\nAccessType=rw\n"


def objects(text: str) -> dict[int, Object]:
    return dict(read_eds(text).dictionary.objects)


def only(text: str) -> Variable:
    """The one variable of a text."""
    (found,) = read_eds(text).dictionary
    return found


def told(text: str) -> list[str]:
    """The findings, without the file's name."""
    return [str(each).removeprefix("x:") for each in read_eds(text, "x").findings]


# ---- what a section says ----


def test_a_variable() -> None:
    text = VAR + "DefaultValue=5\nLowLimit=1\nHighLimit=0x10\nPDOMapping=1\nObjFlags=0x3\n"
    assert only(text) == Variable(0x2000, 0, "x", DataType.UNSIGNED32, Access.RW, 5, 1, 16, pdo_mappable=True, object_flags=3)
    (each,) = objects(text).values()
    assert (each.name, each.object_type, each.data_type, each.object_flags) == ("x", ObjectType.VAR, 7, 3)
    assert told(text) == []


def test_what_a_dcf_adds() -> None:
    text = VAR + "ParameterValue=$NODEID+0x100\nDenotation=mine\nUploadFile=up.bin\nDownloadFile=down.bin\n"
    variable = only(text)
    assert (variable.configured, variable.configured_adds_node_id, variable.initial_of(5)) == (0x100, True, 0x105)
    assert (variable.denotation, variable.upload_file, variable.download_file) == ("mine", "up.bin", "down.bin")
    assert (read_eds(text).kind, read_eds(VAR).kind) == (FileKind.DCF, FileKind.EDS)


def test_keys_that_some_files_have() -> None:
    variable = only(VAR + "Unit=mV\nFactor=0.1\nDescription=of the cell\n_Own=1\n")
    assert (variable.unit, variable.factor, variable.description) == ("mV", 0.1, "of the cell")
    assert told(VAR + "_Own=1\n") == []
    assert told(VAR + "Colour=red\nDefaultVlaue=1\n") == [
        "6:8: notice: in [2000]: CiA 306 has no colour, defaultvlaue [unknown-key]"
    ]


@pytest.mark.parametrize("factor", ["0", "nan", "inf", "ERROR"])
def test_a_factor_that_is_none(factor: str) -> None:
    assert only(f"{VAR}Factor={factor}\n").factor == 1.0
    assert told(f"{VAR}Factor={factor}\n") == [
        f"6:8: warning: in [2000]: Factor {factor!r} is not a number other than 0; taken as 1 [number]"
    ]


def test_any_case_of_keys_and_blanks_anywhere() -> None:
    text = "[2000]\t\n parametername = x \nOBJECTTYPE=0X7\ndatatype=0x07 \naccesstype=Rw\ndefaultvalue= 1\npdomapping=0x1\n"
    assert only(text) == Variable(0x2000, 0, "x", DataType.UNSIGNED32, Access.RW, 1, pdo_mappable=True)


@pytest.mark.parametrize("key", ["ParameterName", "parametername", " PARAMETERNAME "])
def test_sections_that_differ_in_their_names_only(key: str) -> None:
    """They are read once; faults are told of each."""
    rest = "DataType=5\nAccessType=ro\nDefaultValue={}\n\n"
    text = "".join(f"[{0x2000 + number:04X}]\n{key}=n{number}\n" + rest for number in range(3))
    assert [(each.name, each.default) for each in read_eds(text.format(1, 1, 1)).dictionary] == [("n0", 1), ("n1", 1), ("n2", 1)]
    assert [each.line for each in read_eds(text.format(256, 256, 256)).findings] == [5, 11, 17]


def test_no_default_is_none_and_the_node_id_may_be_unknown() -> None:
    assert only(VAR).default is only(VAR + "DefaultValue=\n").default is None
    relative = only(VAR + "DefaultValue=$NODEID+0x180\n")
    assert (relative.default, relative.adds_node_id) == (0x180, True)
    assert Values(read_eds(VAR + "DefaultValue=0x180+$NodeId\n").dictionary, 5).read((0x2000, 0)) == 0x185


def test_limits() -> None:
    signed = VAR.replace("0x0007", "0x0003")
    variable = only(signed + "LowLimit=0x8000\nHighLimit=0x7FFF\n")
    assert (variable.low_limit, variable.high_limit) == (-0x8000, 0x7FFF)
    real = only(VAR.replace("0x0007", "0x0008") + "LowLimit=-0.5\nHighLimit=1e3\n")
    assert (real.low_limit, real.high_limit) == (-0.5, 1000.0)
    assert (only(VAR + "LowLimit=\nHighLimit=\n").low_limit, told(VAR + "LowLimit=\n")) == (None, [])
    text = only(VAR.replace("0x0007", "0x0009") + "LowLimit=1\nHighLimit=x\n")
    assert (text.low_limit, text.high_limit) == (1, None)


def test_values_that_are_lost_and_values_with_a_remark() -> None:
    assert told(VAR + "DefaultValue=No\nLowLimit=-1\nHighLimit=$NODEID\nParameterValue=010\nObjFlags=x\nPDOMapping=2\n") == [
        "6:14: error: in [2000]: DefaultValue 'No' is not a number; left out [value]",
        "7:10: warning: in [2000]: LowLimit '-1': an UNSIGNED32 is not negative; read as 0xFFFFFFFF [value]",
        "8:11: error: in [2000]: HighLimit '$NODEID' depends on the node-ID, which a limit cannot; left out [value]",
        "9:16: warning: in [2000]: ParameterValue '010': a leading 0 means octal; read as 8 [value]",
        "10:10: warning: in [2000]: ObjFlags 'x' is not a number; taken as 0 [number]",
        "11:12: warning: in [2000]: PDOMapping '2' is outside 0..1; taken as 0 [number]",
    ]
    assert told(VAR.replace("0x0007", "9") + "LowLimit=x\n") == [
        "6:10: error: in [2000]: LowLimit 'x' is not a number; left out [value]"
    ]


# ---- what is missing ----


@pytest.mark.parametrize(
    ("text", "data_type", "access"),
    [
        ("[2000]\n", DataType.OCTET_STRING, Access.RW),
        ("[2000]\nObjectType=2\n", DataType.DOMAIN, Access.RW),
        ("[1017]\n", DataType.UNSIGNED16, Access.RW),
        ("[1000]\nDataType=0x0099\nAccessType=UNKNOWN\n", DataType.UNSIGNED32, Access.RO),
        ("[2000]\nDataType=0x7 # UNSIGNED32\nAccessType=RO # ro;\n", DataType.UNSIGNED32, Access.RO),
        ("[2000]\nDataType=07\nAccessType=Const\n", DataType.UNSIGNED32, Access.CONST),
    ],
)
def test_type_and_access_where_the_file_does_not_say(text: str, data_type: DataType, access: Access) -> None:
    assert (only(text).data_type, only(text).access) == (data_type, access)


def test_what_is_guessed_is_told() -> None:
    assert told(
        "[2000]\nDataType=x\n[1008]\nDataType=9\nAccessType=write\n[2001]\nDataType=0x7;\nAccessType=wo; never read\n"
    ) == [
        "1:1: warning: in [2000]: AccessType is missing; taken as rw [access]",
        "2:10: warning: in [2000]: DataType 'x' is not a type for values; taken as OCTET_STRING [data-type]",
        "5:12: warning: in [1008]: AccessType 'write' is none of ro, wo, rw, rwr, rww, const; taken as const [access]",
        "7:10: warning: in [2001]: DataType '0x7;': the comment after it was left out; a comment has a line of its own [number]",
        "8:12: warning: in [2001]: the comment after AccessType was left out [access]",
    ]


def test_object_type_var_is_the_default() -> None:
    assert objects("[2000]\nDataType=7\nAccessType=ro\n")[0x2000].object_type is ObjectType.VAR
    assert told("[2000]\nDataType=7\nAccessType=ro\n") == []


@pytest.mark.parametrize("text", ["10", "x", "0x77"])
def test_an_object_type_that_is_none(text: str) -> None:
    assert told(VAR.replace("ObjectType=7", f"ObjectType={text}")) == [
        f"3:12: warning: in [2000]: ObjectType {text!r} does not exist; taken as VAR [object-type]"
    ]


def test_an_object_type_in_an_odd_form() -> None:
    text = VAR.replace("ObjectType=7", "ObjectType=0x007 # VAR")
    assert objects(text)[0x2000].object_type is ObjectType.VAR
    assert len(told(text)) == 1


# ---- object types ----


def test_domain_null_and_types() -> None:
    text = "[1021]\nObjectType=2\nParameterName=EDS\nAccessType=ro\n[2000]\nObjectType=0\nParameterName=gap\n"
    text += "[0040]\nObjectType=5\nDataType=4\nAccessType=ro\n[0041]\nObjectType=5\nParameterName=bare\n"
    text += "[0042]\nObjectType=6\nParameterName=struct\nSubNumber=1\n[0042sub0]\nDataType=5\nAccessType=ro\nDefaultValue=0\n"
    found = objects(text)
    assert [(each.index, each.object_type, len(each.variables)) for each in found.values()] == [
        (0x0040, ObjectType.DEFTYPE, 1),
        (0x0041, ObjectType.DEFTYPE, 0),
        (0x0042, ObjectType.DEFSTRUCT, 1),
        (0x1021, ObjectType.DOMAIN, 1),
        (0x2000, ObjectType.NULL, 0),
    ]
    assert found[0x1021].variables[0].data_type is DataType.DOMAIN
    assert told(text) == []


@pytest.mark.parametrize(
    "type_section", ["[0040]\nObjectType=5\nDataType=4\nAccessType=ro\n", "[40]\nx=1\n[40sub1]\nDefaultValue=4\n"]
)
def test_a_type_that_the_file_itself_defines(type_section: str) -> None:
    text = type_section + VAR.replace("0x0007", "0x0040") + "DefaultValue=-1\n"
    variable = read_eds(text).dictionary.variable((0x2000, 0))
    assert (variable.data_type, variable.default) == (DataType.INTEGER32, -1)
    assert told(text) == []


RECORD = "[2000]\nParameterName=r\nObjectType=9\nSubNumber=2\nObjFlags=1\nDenotation=d\n"
SUBS = (
    "[2000sub0]\nParameterName=n\nDataType=5\nAccessType=ro\nDefaultValue=1\n"
    "[2000Sub01]\nParameterName=a\nDataType=7\nAccessType=rw\n"
)


def test_a_record_and_an_array() -> None:
    record = objects(RECORD + SUBS)[0x2000]
    assert (record.name, record.object_type, record.object_flags, record.denotation) == ("r", ObjectType.RECORD, 1, "d")
    assert [(each.subindex, each.name) for each in record.variables.values()] == [(0, "n"), (1, "a")]
    array = (
        "[2000]\nParameterName=r\nObjectType=8\nSubNumber=2\nDataType=3\n[2000sub0]\nAccessType=ro\n[2000sub1]\nAccessType=ro\n"
    )
    found = objects(array)[0x2000]
    assert (found.object_type, found.data_type) == (ObjectType.ARRAY, 3)
    assert [each.data_type for each in found.variables.values()] == [DataType.UNSIGNED8, DataType.INTEGER16]


def test_subs_before_their_parent_and_without_one() -> None:
    assert objects(SUBS + RECORD) == objects(RECORD + SUBS)
    orphans = objects(SUBS)[0x2000]
    assert (orphans.name, orphans.object_type, list(orphans.variables)) == ("", ObjectType.RECORD, [0, 1])
    assert told(SUBS) == ["1:1: warning: [2000sub0]: there is no [2000]; taken as a RECORD without a name [no-parent]"]


def test_subs_are_in_order_and_up_to_255() -> None:
    text = (
        RECORD.replace("SubNumber=2", "SubNumber=3")
        + "[2000subFF]\nDataType=7\nAccessType=ro\n[2000subA]\nDataType=7\nAccessType=ro\n"
    )
    assert list(objects(text + SUBS)[0x2000].variables) == [0, 1, 0xA, 0xFF]
    assert told(text + SUBS) == []
    assert told(RECORD + SUBS + "[2000sub100]\n")[0].endswith("left out [no-object]")


def test_a_var_with_subs_is_a_record() -> None:
    found = read_eds(VAR + SUBS, "x")
    assert found.dictionary.objects[0x2000].object_type is ObjectType.RECORD
    assert "3:12: warning: in [2000]: a VAR has no sub-objects; taken as RECORD [object-type]" in told(VAR + SUBS)
    assert objects("[2000]\nParameterName=r\n" + SUBS)[0x2000].object_type is ObjectType.RECORD


def test_a_var_with_its_sub_0() -> None:
    found = objects(VAR + SUBS.partition("[2000Sub01]")[0])[0x2000]
    assert (found.object_type, found.variables[0].name) == (ObjectType.VAR, "n")


@pytest.mark.parametrize(
    ("sub_number", "said"),
    [
        ("2", None),
        ("0x2", None),
        ("4294967295", "SubNumber is 4294967295, but there are 2 sub-objects"),
        ("0", "SubNumber is 0, but there are 2 sub-objects"),
        ("many", "SubNumber 'many' is not a number"),
        ("", "SubNumber is missing"),
    ],
)
def test_sub_number(sub_number: str, said: str | None) -> None:
    found = told(RECORD.replace("SubNumber=2", f"SubNumber={sub_number}") + SUBS)
    assert found == ([] if said is None else [f"4:{11}: warning: in [2000]: {said} [sub-number]"])


def test_an_object_that_no_list_names_is_there_and_index_0_is_not() -> None:
    description = read_eds("[0000]\nDataType=7\nAccessType=rw\n[0000sub1]\nDataType=7\nAccessType=rw\n" + VAR)
    assert (list(description.dictionary.objects), description.manufacturer) == ([0x2000], ())
    assert told("[0000sub1]\n" + VAR)[0].startswith("1:1: error: [0000sub1] is not an object")


# ---- compact forms ----

COMPACT = "[2000]\nParameterName=In\nObjectType=8\nDataType=6\nAccessType=ro\nDefaultValue=7\nPDOMapping=1\nCompactSubObj=3\n"


def test_an_array_in_compact_form() -> None:
    text = COMPACT + "[2000Name]\nNrOfEntries=1\n2=Second\n[2000Value]\n3=9\n[2000Denotation]\n1=mine\n"
    found = objects(text)[0x2000]
    assert found.object_type is ObjectType.ARRAY
    assert found.variables[0] == Variable(0x2000, 0, "NrOfObjects", DataType.UNSIGNED8, Access.RO, default=3)
    facts = [(each.name, each.default, each.configured, each.denotation) for each in found.variables.values()]
    assert facts[1:] == [("In1", 7, None, "mine"), ("Second", 7, None, ""), ("In3", 7, 9, "")]
    assert all(each.pdo_mappable and each.data_type is DataType.UNSIGNED16 for each in list(found.variables.values())[1:])
    assert (told(text), read_eds(text).kind) == ([], FileKind.DCF)


def test_sections_of_their_own_go_before_the_compact_form() -> None:
    text = COMPACT + "[2000sub0]\nParameterName=n\nDataType=5\nAccessType=const\nDefaultValue=3\n"
    text += (
        "[2000sub2]\nParameterName=own\nDataType=7\nAccessType=rw\n[2000sub9]\nParameterName=more\nDataType=7\nAccessType=rw\n"
    )
    found = objects(text)[0x2000].variables
    assert [each.name for each in found.values()] == ["n", "In1", "own", "In3", "more"]


@pytest.mark.parametrize(("kind", "code"), [("Name", "unused-entry"), ("Value", "setting"), ("Denotation", "unused-entry")])
def test_an_entry_of_a_list_that_no_sub_object_takes_has_a_finding(kind: str, code: str) -> None:
    own = "[2000sub2]\nParameterName=own\nDataType=6\nAccessType=rw\n"
    text = COMPACT + own + f"[2000{kind}]\nNrOfEntries=7\n3=5\n01=6\n0x1=7\n0=8\n4=9\n2=10\n9=\n_own=11\n"
    here = f"in [2000{kind}]"
    left = ["01=6", "0x1=7", "0=8", "4=9"]
    assert told(text) == [
        *(
            f"{line}:{entry.index('=') + 2}: error: {here}: {entry} is for no subindex from 1 to 3; left out [{code}]"
            for line, entry in enumerate(left, 16)
        ),
        f"20:3: warning: {here}: 2=10 is not used: sub-object 2 has a section of its own [unused-entry]",
    ]


def test_compact_numbers_that_are_none() -> None:
    assert list(objects(COMPACT.replace("CompactSubObj=3", "CompactSubObj=x"))[0x2000].variables) == [0]
    assert len(objects(COMPACT.replace("CompactSubObj=3", "CompactSubObj=4000000000"))[0x2000].variables) == 255
    assert objects(VAR + "CompactSubObj=0\n")[0x2000].object_type is ObjectType.VAR
    untyped = COMPACT.replace("ObjectType=8\n", "")
    assert objects(untyped)[0x2000].object_type is ObjectType.ARRAY
    assert told(untyped) == ["1:1: warning: in [2000]: ObjectType is missing; taken as ARRAY [object-type]"]


def test_compact_pdos() -> None:
    text = f"[DeviceInfo]\nCompactPDO=0x3\nNrOfRXPDO=5\nNrOfTXPDO=1\n{VAR}[1401]\nParameterName=own\nDataType=7\nAccessType=rw\n"
    found = read_eds(text).dictionary
    assert [index for index in found.objects if index < 0x1600] == [0x1400, 0x1401, 0x1402, 0x1403, 0x1404]
    assert found.objects[0x1401].name == "own"
    assert list(found.objects[0x1400].variables) == [0, 1, 2]
    values = Values(found, 5)
    assert [values.read((index, 1)) for index in (0x1400, 0x1402, 0x1404, 0x1800)] == [0x205, 0x405, 0x8000_0000, 0x185]
    assert values.read((0x1600, 0)) == 0
    assert len(found.objects[0x1A00].variables) == 9
    assert list(read_eds(text.replace("0x3", "0x3F")).dictionary.objects[0x1800].variables) == [0, 1, 2, 3, 5, 6]


# ---- whole files ----


def test_strict_raises_the_first_error() -> None:
    assert read_eds(VAR + "Colour=x\n", strict=True).dictionary.objects
    with pytest.raises(DictionaryError) as caught:
        read_eds(VAR + "DefaultValue=a\n[2000]\n", "x.eds", strict=True)
    assert caught.value.failed == "x.eds:6:14: error: in [2000]: DefaultValue 'a' is not a number; left out [value]"


def test_text_and_bytes_are_the_same() -> None:
    assert (
        read_eds(VAR).dictionary.objects
        == read_eds("\ufeff" + VAR).dictionary.objects
        == read_eds(VAR.encode()).dictionary.objects
    )
    document = read_eds(VAR).document
    assert isinstance(document, EdsDocument)
    assert document.text == VAR
    assert read_eds(VAR.replace("=x", "=\xb5m").encode("latin-1")).encoding == "cp1252"


def test_a_file_with_many_faults() -> None:
    description = read_eds((DATA / "faulty.eds").read_bytes(), "faulty.eds")
    found = [each.code for each in description.findings]
    assert {each: found.count(each) for each in sorted(set(found))} == {
        "access": 3,
        "bracket": 1,
        "comment": 1,
        "count": 4,
        "data-type": 2,
        "encoding": 1,
        "junk": 3,
        "key-twice": 1,
        "no-object": 2,
        "no-parent": 1,
        "number": 9,
        "object-type": 3,
        "section-twice": 1,
        "sub-number": 2,
        "unknown-key": 1,
        "value": 8,
    }
    assert [each.line for each in description.findings] == sorted(each.line for each in description.findings)
    assert len(description.dictionary.objects) == 9
    assert description.dictionary.variable("Größeµ").default == "a;b"
    assert (description.dictionary.variable((0x1018, 1)).name, description.device_info.vendor_number) == ("Vendor-ID", 1)


@pytest.mark.parametrize("name", ["sample_io.eds", "sample_drive.eds"])
def test_the_samples_have_no_fault(name: str) -> None:
    description = read_eds(read_file(name), name, strict=True)
    assert (description.findings, check(description)) == ((), [])
    assert not Values(description.dictionary, 5).unfit


def test_both_samples_of_the_io_device_are_one_device() -> None:
    from canopen_data.xdd import read_xdd

    ours = read_eds(read_file("sample_io.eds")).dictionary
    other = read_xdd(read_file("sample_io.xdd")).dictionary
    assert [(each.mux, each.name, each.data_type, each.default) for each in ours if each.mux != 0x640100] == [
        (each.mux, each.name, each.data_type, each.default) for each in other if each.mux != 0x640100
    ]


MOST_ERRORS = {"canopen-sample.eds": 1, "cia-301.eds": 10}


@needs_vendor_files
@pytest.mark.parametrize("name", INI_NAMES)
def test_a_makers_file_is_read(name: str) -> None:
    description = read_eds(load(name), name)
    errors = [each for each in description.findings if each.severity is Severity.ERROR]
    assert len(errors) == MOST_ERRORS.get(name, 0), errors
    assert description.dictionary.variable((0x1000, 0)).data_type is DataType.UNSIGNED32
    for variable in description.dictionary:
        line, column = description.place_of(variable.index, variable.subindex, "DataType")
        assert line > 0
        assert column > 0


@pytest.mark.parametrize("path", ["/files/[old] x.EDS", "sample_io.eds", Path("x.eds")])
def test_a_path_is_never_parsed_as_a_text(path: Any) -> None:
    with pytest.raises(LocalProtocolError, match=r"(?i)(x|sample_io)\.eds' is no text of an EDS.*load_description"):
        read_eds(path)
