"""Writing EDS and DCF: what did not change keeps its form; what did is said in the form of the old."""

from __future__ import annotations

import datetime
import math
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import pytest

from canopen_data.configured import with_configured
from canopen_data.describing import describe
from canopen_data.description import Commissioning, DeviceDescription, FileInfo, FileKind
from canopen_data.eds.reader import read_eds
from canopen_data.eds.writer import encode_eds, write_eds
from canopen_data.eds.writer_sections import sections_of
from canopen_proto.datatypes import DataType, ValueRangeError
from canopen_proto.dictionary import Object, ObjectDictionary, ObjectType, Variable
from canopen_proto.machine import LocalProtocolError
from canopen_proto.multiplexer import mux
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from tests.builds import takes_any_type

SAMPLE = """\
; a file of a maker
[FileInfo]
FileName = sample.eds
FileVersion=0x01
FileRevision=001
EDSVersion=4.0

[DEVICEINFO]
VendorName=Maker ; & sons
Vendornumber=0x0000002A
BaudRate_125=1
; what we sell
NrOfRXPDO=0
NrOfTXPDO=1
LSS_Supported=0

[Comments]
Lines=2
Line1=one
Line2=two

[MandatoryObjects]
SupportedObjects=1
1=0x1000

[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=ro
DefaultValue=0x00020192
PDOMapping=0

[OptionalObjects]
SupportedObjects=3
1=0x1003
2=0x1017
3=0x1800

[1003]
ParameterName=Errors
ObjectType=0x8
DataType=0x0007
AccessType=ro
PDOMapping=0
CompactSubObj=2

[1017]
; in ms
parametername=Heartbeat
ObjectType=7
DataType=0x6
AccessType=RW
DefaultValue=0x03e8
PDOMapping=0
Vendor=keep me

[1800]
ParameterName=TPDO
ObjectType=0x9
SubNumber=3

[1800Sub0]
ParameterName=count
ObjectType=0x7
DataType=0x0005
AccessType=ro
DefaultValue=2
PDOMapping=0

[1800Sub1]
ParameterName=COB-ID
ObjectType=0x7
DataType=0x0007
AccessType=rw
DefaultValue=0x180+$NODEID
PDOMapping=0

[1800Sub2]
ParameterName=type
ObjectType=0x7
DataType=0x0005
AccessType=rw
DefaultValue=255
PDOMapping=0

[ManufacturerObjects]
SupportedObjects=0

[Tools]
Items=1

[Tool1]
Name=a tool
"""
NODE_5 = Commissioning(node_id=5, node_name="arm", bit_rate=500)


def sample(text: str = SAMPLE) -> DeviceDescription:
    return read_eds(text, "sample.eds")


def with_variable(description: DeviceDescription, index: int, subindex: int, **changes: object) -> DeviceDescription:
    each = description.dictionary.objects[index]
    variable = replace(each.variables[subindex], **changes)  # type: ignore[arg-type]
    return with_object(description, replace(each, variables=MappingProxyType({**each.variables, subindex: variable})))


def with_object(description: DeviceDescription, each: Object) -> DeviceDescription:
    return replace(description, dictionary=description.dictionary.with_objects([each]))


def changes(before: str, after: str) -> tuple[list[str], list[str]]:
    """The lines that are gone and the lines that are new, as long as there is one run of each."""
    old, new = before.split("\n"), after.split("\n")
    start = next(
        (number for number, pair in enumerate(zip(old, new, strict=False)) if pair[0] != pair[1]), min(len(old), len(new))
    )
    end = 0
    while end < min(len(old), len(new)) - start and old[-1 - end] == new[-1 - end]:
        end += 1
    return old[start : len(old) - end], new[start : len(new) - end]


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_nothing_changed_is_the_same_text(newline: str) -> None:
    text = SAMPLE.replace("\n", newline)
    assert write_eds(sample(text)) == text
    assert write_eds(sample(text.rstrip())) == text.rstrip()


def test_a_changed_number_keeps_its_form() -> None:
    assert changes(SAMPLE, write_eds(with_variable(sample(), 0x1017, 0, default=0x1F))) == (
        ["DefaultValue=0x03e8"],
        ["DefaultValue=0x001f"],
    )
    assert changes(SAMPLE, write_eds(with_variable(sample(), 0x1800, 2, default=1))) == (["DefaultValue=255"], ["DefaultValue=1"])
    assert changes(SAMPLE, write_eds(with_variable(sample(), 0x1800, 1, default=0x80000180))) == (
        ["DefaultValue=0x180+$NODEID"],
        ["DefaultValue=$NODEID+0x80000180"],
    )


def test_a_new_key_stands_where_the_standard_has_it() -> None:
    written = write_eds(with_variable(sample(), 0x1017, 0, low_limit=10, configured=500))
    assert "DataType=0x6\nLowLimit=10\nAccessType=RW\nDefaultValue=0x03e8\nParameterValue=500\nPDOMapping=0\n" in written


def test_a_key_without_a_value_any_more_is_gone() -> None:
    assert changes(SAMPLE, write_eds(with_variable(sample(), 0x1017, 0, default=None))) == (["DefaultValue=0x03e8"], [])


def test_a_name_is_replaced_in_its_line() -> None:
    written = write_eds(with_variable(sample(), 0x1800, 1, name="new [name]; = x"))
    assert changes(SAMPLE, written) == (["ParameterName=COB-ID"], ["ParameterName=new [name]; = x"])
    info = FileInfo("mine.eds", 1, 1, "4.0", modified_by="me")
    written = write_eds(sample(), file_info=info)
    assert "FileName = mine.eds\nFileVersion=0x01\nFileRevision=001\nEDSVersion=4.0\nModifiedBy=me\n" in written


def test_aliases_do_not_take_the_places_of_the_file_s_names() -> None:
    names = {(0x1017, 0): "heartbeat_time", (0x1800, 1): "tpdo1:cob_id"}
    aliases = [Object.of(name, [Variable(*place, name, DataType.UNSIGNED32)]) for place, name in names.items()]
    named = replace(sample(), dictionary=sample().dictionary.with_names_of(ObjectDictionary(aliases)))
    assert named.dictionary.variable("tpdo1:cob_id").names == ("tpdo1:cob_id", "COB-ID")
    assert write_eds(named) == SAMPLE
    renamed = with_variable(named, 0x1800, 1, aliases=())
    assert "ParameterName=tpdo1:cob_id\n" in write_eds(renamed)


def test_a_new_object_is_listed_and_stands_behind_the_one_before() -> None:
    new = Object.of("Name", [Variable(0x2000, 0, "Name", DataType.VISIBLE_STRING, default="x y")])
    written = write_eds(with_object(sample(), new))
    assert changes(SAMPLE, written)[1] == [
        "SupportedObjects=1",
        "1=0x2000",
        "",
        "[2000]",
        "ParameterName=Name",
        "ObjectType=0x7",
        "DataType=0x0009",
        "AccessType=rw",
        "DefaultValue=x y",
        "PDOMapping=0",
    ]


def test_an_object_that_is_gone_leaves_nothing() -> None:
    read = sample()
    less = ObjectDictionary([each for each in read.dictionary.objects.values() if each.index != 0x1017])
    written = write_eds(replace(read, dictionary=less, optional=(0x1003, 0x1800)))
    assert "[1017]" not in written
    assert "SupportedObjects=2\n1=0x1003\n2=0x1800\n\n[1003]" in written
    assert "CompactSubObj=2\n\n[1800]" in written
    assert sections_of(read_eds(written)) == sections_of(replace(read, dictionary=less, optional=(0x1003, 0x1800)))


def test_a_compact_object_that_changes_is_written_out() -> None:
    written = write_eds(with_variable(sample(), 0x1003, 2, default=5))
    assert "CompactSubObj" not in written
    assert "[1003sub2]\nParameterName=Errors2\n" in written
    assert "; in ms\nparametername=Heartbeat" in written
    assert read_eds(written).dictionary.variable((0x1003, 2)).default == 5


def test_a_dcf_of_an_eds() -> None:
    dcf = with_configured(sample(), {mux(0x1017): 100, mux(0x1800, 1): 0x185}, NODE_5)
    written = write_eds(dcf)
    assert "[DeviceComissioning]\nNodeID=5\nNodeName=arm\nBaudrate=500\nCANopenManager=0\n" in written
    assert written.startswith("; a file of a maker\n[FileInfo]\nFileName = sample.eds\n")
    assert "LastEDS=sample.eds\n" in written
    assert "DefaultValue=0x03e8\nParameterValue=100\n" in written
    assert "DefaultValue=0x180+$NODEID\nParameterValue=0x00000185\n" in written
    again = read_eds(written, "sample.dcf")
    assert again.kind is FileKind.DCF
    assert again.commissioning == NODE_5
    assert sections_of(again) == sections_of(dcf)
    assert read_eds(write_eds(again, FileKind.EDS)).commissioning is None
    assert sections_of(read_eds(write_eds(again, FileKind.EDS))) == sections_of(sample())


def test_a_dcf_needs_a_node_id() -> None:
    with pytest.raises(LocalProtocolError, match="node-ID"):
        write_eds(sample(), FileKind.DCF)
    with pytest.raises(LocalProtocolError, match="128"):
        write_eds(sample(), FileKind.DCF, node_id=128)
    with pytest.raises(LocalProtocolError, match="XDD"):
        write_eds(sample(), FileKind.XDD)
    written = write_eds(sample(), FileKind.DCF, node_id=9)
    assert read_eds(written).commissioning == Commissioning(node_id=9)
    assert read_eds(write_eds(read_eds(written), FileKind.DCF)).commissioning == Commissioning(node_id=9)


def test_both_spellings_of_commissioning_stay() -> None:
    for spelling in ("DeviceComissioning", "devicecommissioning"):
        text = f"{SAMPLE}\n[{spelling}]\nNodeID=0x05\nNodeName=arm\nBaudRate=500\n"
        assert write_eds(read_eds(text)) == text
        written = write_eds(read_eds(text), FileKind.DCF, node_id=0x11)
        assert changes(text, written) == (["NodeID=0x05"], ["NodeID=0x11"])


def test_without_a_document_the_standard_s_order_and_forms() -> None:
    described = describe(drive_dictionary(), file_info=FileInfo("drive.eds", 1, eds_version="4.0"))
    written = write_eds(described)
    assert written.startswith("[FileInfo]\nFileName=drive.eds\nFileVersion=1\n")
    assert "DefaultValue=0x00020192\n" in written
    assert "DefaultValue=$NODEID+0x40000180\n" in written
    assert "\n\n[MandatoryObjects]\nSupportedObjects=3\n1=0x1000\n2=0x1001\n3=0x1018\n\n[1000]\n" in written
    again = read_eds(written)
    assert not again.findings
    assert list(again.dictionary) == [replace(each, aliases=()) for each in described.dictionary]
    assert write_eds(again) == written


def test_types_of_objects_that_are_none() -> None:
    """DEFTYPE, DEFSTRUCT and NULL stand in files, too."""
    objects = [
        Object(0x40, "ours", ObjectType.DEFSTRUCT, MappingProxyType({})),
        Object(0x3000, "nothing", ObjectType.NULL, MappingProxyType({})),
    ]
    names = sections_of(describe(ObjectDictionary(objects)))
    assert names["0040"] == {"ParameterName": "ours", "ObjectType": "0x6", "SubNumber": "0"}
    assert names["3000"] == {"ParameterName": "nothing", "ObjectType": "0x0"}


def test_a_var_with_sub_objects_is_written_as_a_record() -> None:
    """An EDS that has CompactSubObj in a VAR. Subindex 255 tells the structure, which any object may."""
    subs = {subindex: Variable(0x2000, subindex, "x", DataType.UNSIGNED8) for subindex in (0, 1, 0xFF)}

    def written_type(object_type: ObjectType, *subindices: int) -> str:
        each = Object(0x2000, "x", object_type, MappingProxyType({subindex: subs[subindex] for subindex in subindices}))
        return sections_of(describe(ObjectDictionary([each])))["2000"]["ObjectType"]

    assert written_type(ObjectType.VAR, 0, 1) == "0x9"
    assert written_type(ObjectType.VAR, 0, 0xFF) == "0x7"
    assert written_type(ObjectType.DOMAIN, 0, 0xFF) == "0x9"
    assert written_type(ObjectType.ARRAY, 0, 1) == "0x8"


def test_what_a_line_cannot_hold() -> None:
    odd = Variable(0x2000, 0, " two\nlines\r\n", DataType.VISIBLE_STRING, default="a\rb ")
    entries = sections_of(describe(ObjectDictionary([Object.of(odd.name, [odd])])))["2000"]
    assert (entries["ParameterName"], entries["DefaultValue"]) == ("two lines", "a b")


def test_bytes_in_the_encoding_of_the_old_file() -> None:
    assert encode_eds("ä", "cp1252") == b"\xe4"
    assert encode_eds("äł", "cp1252") == "äł".encode()
    assert encode_eds("ä\ud800", "cp1252") == "ä?".encode()


# ---- files with faults, and odd forms ----


def test_a_last_line_without_an_end() -> None:
    text = SAMPLE[: SAMPLE.index("PDOMapping=0\n\n[ManufacturerObjects]")].rstrip()
    written = write_eds(with_variable(sample(text), 0x1800, 2, pdo_mappable=True))
    assert written == f"{text}\nPDOMapping=1\n"


def test_of_what_stands_twice_the_first_counts() -> None:
    twice = SAMPLE.replace("DefaultValue=0x03e8", "DefaultValue=0x03e8\nDefaultValue=7")
    twice += "\n[1017]\nParameterName=Other\nObjectType=7\nDataType=6\nAccessType=ro\nDefaultValue=9\n"
    assert write_eds(sample(twice)) == twice
    written = write_eds(with_variable(sample(twice), 0x1017, 0, default=0x10))
    assert read_eds(written).dictionary.variable(0x1017).default == 0x10
    assert written.endswith("DefaultValue=9\n")
    gone = write_eds(with_variable(sample(twice), 0x1017, 0, default=None))
    assert read_eds(gone).dictionary.variable(0x1017).default is None
    less = ObjectDictionary([each for each in sample(twice).dictionary.objects.values() if each.index != 0x1017])
    assert "[1017]" not in write_eds(replace(sample(twice), dictionary=less, optional=(0x1003, 0x1800)))


def test_numbered_keys_with_gaps_are_written_anew() -> None:
    """A line cannot be put between two others there: the file's form is given up, what it says is not."""
    gaps = SAMPLE.replace("Line1=one\nLine2=two", "Line2=one\nLine5=two")
    read = replace(sample(gaps), comments=("one", "two", "three"))
    written = write_eds(read)
    assert read_eds(written).comments == ("one", "two", "three")
    assert sections_of(read_eds(written)) == sections_of(read)
    assert written.startswith("[FileInfo]\nFileName=sample.eds\n")
    assert written.endswith("\n\n[Tools]\nItems=1\n\n[Tool1]\nName=a tool\n")


def test_pdos_in_compact_form_are_written_out_where_they_change() -> None:
    text = SAMPLE.replace("NrOfRXPDO=0", "NrOfRXPDO=2\nCompactPDO=0x02")
    read = sample(text)
    assert write_eds(read) == text
    written = write_eds(with_variable(read, 0x1401, 2, configured=1))
    assert "[1400]" not in written
    assert "[1401sub2]\nParameterName=Transmission type\n" in written
    assert sections_of(read_eds(written)) == sections_of(with_variable(read, 0x1401, 2, configured=1))
    assert (
        written.index("[1800]") < written.index("[1401]") < written.index("[1401sub2]") < written.index("[ManufacturerObjects]")
    )


def test_a_section_before_all_others() -> None:
    read = read_eds("[1017]\nParameterName=Heartbeat\nDataType=6\nAccessType=rw\n")
    written = write_eds(replace(read, file_info=FileInfo("a.eds")))
    assert written.startswith("[FileInfo]\nFileName=a.eds\nFileVersion=0\nFileRevision=0\n\n[1017]\nParameterName=Heartbeat\n")


def only(**facts: Any) -> DeviceDescription:
    """The description of one object."""
    variable = Variable(0x2000, 0, "Speed", **{"data_type": DataType.UNSIGNED16, **facts})
    return describe(ObjectDictionary([Object.of("Speed", [variable])]))


@pytest.mark.parametrize(
    ("facts", "text"),
    [
        ({"default": "abc"}, "default 'abc' .*UNSIGNED16"),
        ({"default": 99999}, "default 99999 .*0..65535"),
        ({"default": 1.5}, "default 1.5 "),
        ({"default": -1}, "default -1 "),
        ({"default": -128, "adds_node_id": True}, "default -128 "),
        ({"default": 0xFFFF, "adds_node_id": True}, "default 65535 .*whatever the node-ID"),
        ({"configured": 70000}, "configured 70000 "),
        ({"low_limit": -5}, "low_limit -5 "),
        ({"high_limit": 1.5}, "high_limit 1.5 "),
        ({"data_type": DataType.REAL32, "high_limit": math.nan}, "high_limit nan "),
        ({"data_type": DataType.REAL32, "default": 1e300}, "default 1e[+]300 "),
        ({"data_type": DataType.VISIBLE_STRING, "default": 5}, "default 5 "),
        ({"data_type": DataType.VISIBLE_STRING, "high_limit": 1.5}, "high_limit 1.5 "),
        ({"data_type": DataType.OCTET_STRING, "default": "ab"}, "default 'ab' "),
        ({"data_type": DataType.BOOLEAN, "default": 2}, "default 2 "),
        ({"factor": 0.0}, "factor 0.0 "),
        ({"factor": math.inf}, "factor inf "),
    ],
)
def test_a_value_that_its_own_reader_would_not_give_back_is_never_written(facts: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueRangeError, match=rf"Speed \(0x2000:00\): {text}"):
        write_eds(only(**facts), FileKind.DCF, node_id=5)


@pytest.mark.parametrize(
    "facts",
    [
        {"default": True},
        {"default": 0xFFFE, "adds_node_id": True},
        {"default": -1, "adds_node_id": True},
        {"data_type": DataType.INTEGER64, "default": -(1 << 63), "low_limit": -(1 << 63), "high_limit": (1 << 63) - 1},
        {"data_type": DataType.REAL32, "default": 0.1, "high_limit": math.inf, "low_limit": 3},
        {"data_type": DataType.BOOLEAN, "default": False, "high_limit": 1},
        {"data_type": DataType.OCTET_STRING, "default": b"\x00\xff"},
        {"data_type": DataType.TIME_OF_DAY, "default": datetime.datetime(2026, 1, 2, 3, 4, 5, 6000, datetime.UTC)},
        {"data_type": DataType.TIME_DIFFERENCE, "default": datetime.timedelta(days=1, milliseconds=5)},
        {"low_limit": 10, "high_limit": 5},
    ],
)
def test_what_can_be_kept_is_written_and_read_again(facts: dict[str, Any]) -> None:
    variable = read_eds(write_eds(only(**facts))).dictionary.variable((0x2000, 0))
    assert {name: getattr(variable, name) for name in facts} == facts


@takes_any_type
def test_a_data_type_that_does_not_exist_is_told_with_its_object() -> None:
    with pytest.raises(LocalProtocolError, match=r"Speed \(0x2000:00\): there is no data type 99"):
        only(data_type=99)


def test_the_kind_of_a_new_file_is_never_guessed_wrong() -> None:
    assert "NodeID=9\n" in write_eds(sample(), "DCF", node_id=9)  # type: ignore[arg-type]
    with pytest.raises(LocalProtocolError, match="an EDS or a DCF can be written here, no PDF"):
        write_eds(sample(), "PDF")  # type: ignore[arg-type]
    for kind in (None, FileKind.EDS, FileKind.DCF):
        with pytest.raises(LocalProtocolError, match=r"node-ID 200 is outside 1\.\.127"):
            write_eds(sample(), kind, node_id=200)
    with pytest.raises(LocalProtocolError, match="an EDS has no node-ID: kind=FileKind.DCF"):
        write_eds(sample(), node_id=9)
