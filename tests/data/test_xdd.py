"""XDD and XDC: what is read of objects, and what is told of faults."""

from __future__ import annotations

import math

import pytest

from canopen_data.checks import check
from canopen_data.description import Commissioning, DynamicChannel, FileKind
from canopen_data.eds import read_eds
from canopen_data.findings import DictionaryError
from canopen_data.xdd import read_xdd
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, ObjectType
from tests.data.xdd_files import read, told, var, xdd


def test_an_object_that_says_all_by_itself() -> None:
    description = read(
        var(
            'dataType="0004" accessType="rw" defaultValue="0x10" lowLimit="-5" highLimit="0x20" PDOmapping="RPDO" objFlags="0003"'
            ' denotation="left"'
        )
    )
    assert not description.findings
    thing = description.dictionary.variable("thing")
    assert (thing.data_type, thing.access, thing.default) == (DataType.INTEGER32, Access.RWW, 16)
    assert (thing.low_limit, thing.high_limit, thing.pdo_mappable) == (-5, 32, True)
    assert (thing.object_flags, thing.denotation, thing.configured) == (3, "left", None)
    whole = description.dictionary.objects[0x2000]
    assert (whole.object_type, whole.data_type, whole.object_flags, whole.denotation) == (ObjectType.VAR, 4, 3, "left")
    assert description.kind is FileKind.XDD
    assert (description.mandatory, description.optional, description.manufacturer) == ((), (), (0x2000,))


@pytest.mark.parametrize(
    ("data_type", "text", "value"),
    [
        ("0001", "true", True),
        ("0001", "0", False),
        ("0002", "0xFF", -1),
        ("0005", "255", 255),
        ("0007", " 7 ", 7),
        ("0008", "1.5", 1.5),
        ("0009", " text ", " text "),
        ("000B", "täxt", "täxt"),
        ("000A", "01 ff", b"\x01\xff"),
        ("000F", "0102", b"\x01\x02"),
        ("07", "1", 1),
    ],
)
def test_values(data_type: str, text: str, value: object) -> None:
    description = read(var(f'dataType="{data_type}" accessType="rw" defaultValue="{text}" actualValue="{text}"'))
    assert not description.findings
    thing = description.dictionary.variable("thing")
    assert (thing.default, thing.configured) == (value, value)
    assert type(thing.default) is type(value)
    assert description.kind is FileKind.XDC


@pytest.mark.parametrize("text", ["$NODEID+0x180", "0x180+$NODEID", "$NodeID + 384"])
def test_a_value_that_depends_on_the_node_id(text: str) -> None:
    description = read(var(f'dataType="0007" accessType="rw" defaultValue="{text}" actualValue="$NODEID"'))
    thing = description.dictionary.variable("thing")
    assert not description.findings
    assert (thing.default, thing.adds_node_id, thing.default_of(5)) == (0x180, True, 0x185)
    assert (thing.configured_adds_node_id, thing.initial_of(5)) == (True, 5)


@pytest.mark.parametrize(
    ("attributes", "code", "severity"),
    [
        ('dataType="0005" accessType="rw" defaultValue="256"', "value", "error"),
        ('dataType="0005" accessType="rw" defaultValue="x"', "value", "error"),
        ('dataType="0005" accessType="rw" actualValue="256"', "setting", "error"),
        ('dataType="0008" accessType="rw" defaultValue="x"', "value", "error"),
        ('dataType="000A" accessType="rw" defaultValue="x"', "value", "error"),
        ('dataType="000C" accessType="rw" defaultValue="00"', "value", "error"),
        ('dataType="0008" accessType="rw" defaultValue="1e39"', "value", "error"),
        ('dataType="0005" accessType="rw" lowLimit="-1"', "limit", "warning"),
        ('dataType="0005" accessType="rw" highLimit="$NODEID+1"', "limit", "warning"),
        ('dataType="0005" accessType="rx"', "access", "warning"),
        ('dataType="0005"', "access", "warning"),
        ('accessType="rw"', "data-type", "warning"),
        ('dataType="0020" accessType="rw"', "data-type", "warning"),
        ('dataType="zz" accessType="rw"', "data-type", "warning"),
        ('dataType="0005" accessType="rw" PDOmapping="yes"', "pdo-mapping", "warning"),
        ('dataType="0005" accessType="rw" objFlags="-1"', "number", "warning"),
        ('dataType="0005" accessType="rw" uniqueIDRef="UID"', "reference", "warning"),
    ],
)
def test_a_fault_is_told_and_the_object_is_read(attributes: str, code: str, severity: str) -> None:
    description = read(var(attributes))
    assert (description.findings[-1].code, description.findings[-1].severity) == (code, severity)
    assert (len(description.findings), description.findings[0].line) == (1, 4)
    assert description.dictionary.variable("thing").default is None


def test_a_guess_is_the_standards() -> None:
    description = read(var("", "1017", "heartbeat") + var('PDOmapping="TPDO"', "6000", "input"))
    heartbeat = description.dictionary.variable(0x1017)
    assert (heartbeat.data_type, heartbeat.access) == (DataType.UNSIGNED16, Access.RW)
    assert description.dictionary.variable(0x6000).access is Access.RWR
    assert len(description.findings) == 4


SUBS = """
<CANopenObject index="1018" name="Identity" objectType="9" subNumber="{}">
  <CANopenSubObject subIndex="00" name="count" objectType="7" dataType="0005" accessType="const" defaultValue="1"/>
  <CANopenSubObject subIndex="01" name="vendor" objectType="7" dataType="0007" accessType="ro" defaultValue="0x55"/>
  {}
</CANopenObject>"""


def test_a_record() -> None:
    description = read(SUBS.format(2, ""))
    assert not description.findings
    record = description.dictionary.objects[0x1018]
    assert (record.object_type, record.name, list(record.variables)) == (ObjectType.RECORD, "Identity", [0, 1])
    assert description.dictionary.variable((0x1018, 1)).default == 0x55
    assert description.mandatory == (0x1018,)


def test_subindex_0_counts_the_others() -> None:
    description = read(SUBS.format(2, "").replace(' dataType="0005"', "").replace("1018", "2018"))
    assert [each.code for each in description.findings] == ["data-type"]
    assert description.dictionary.variable((0x2018, 0)).data_type is DataType.UNSIGNED8


def test_a_limit_of_what_is_no_number_is_kept_for_the_linter() -> None:
    description = read(var('dataType="0009" accessType="rw" lowLimit="5" highLimit="z"'))
    assert [each.code for each in description.findings] == ["limit"]
    assert (description.dictionary.variable("thing").low_limit, description.dictionary.variable("thing").high_limit) == (5, None)


def test_sub_objects_that_cannot_be_read() -> None:
    twice = '<CANopenSubObject subIndex="01" dataType="0007" accessType="ro"/><CANopenSubObject subIndex="1FF"/>'
    description = read(SUBS.format("x", twice + "<CANopenSubObject/>"))
    assert [each.code for each in description.findings] == ["number", "duplicate", "number", "number"]
    assert "outside 0x0..0xFF" in description.findings[2].message
    assert "is missing" in description.findings[3].message
    assert list(description.dictionary.objects[0x1018].variables) == [0, 1]
    assert told(read(SUBS.format(7, ""))) == ["5:71 warning sub-number"]


@pytest.mark.parametrize(
    ("attributes", "object_type", "fault"),
    [
        ('objectType="7"', ObjectType.RECORD, "object-type"),
        ('objectType="8"', ObjectType.ARRAY, ""),
        ('objectType="6"', ObjectType.DEFSTRUCT, ""),
        ('objectType="77"', ObjectType.RECORD, "object-type"),
        ('objectType="x"', ObjectType.RECORD, "number"),
        ("", ObjectType.RECORD, "object-type"),
    ],
)
def test_object_types_with_sub_objects(attributes: str, object_type: ObjectType, fault: str) -> None:
    description = read(SUBS.format(2, "").replace('objectType="9"', attributes))
    assert [each.code for each in description.findings] == [fault] * bool(fault)
    assert description.dictionary.objects[0x1018].object_type is object_type


@pytest.mark.parametrize(
    ("attributes", "object_type", "variables"),
    [
        ('objectType="0"', ObjectType.NULL, []),
        ('objectType="2" accessType="rw"', ObjectType.DOMAIN, [DataType.DOMAIN]),
        ('objectType="5"', ObjectType.DEFTYPE, []),
        ('objectType="5" dataType="0007" accessType="ro"', ObjectType.DEFTYPE, [DataType.UNSIGNED32]),
        ('objectType="9"', ObjectType.RECORD, []),
    ],
)
def test_object_types_alone(attributes: str, object_type: ObjectType, variables: list[DataType]) -> None:
    description = read(f'<CANopenObject index="2000" name="thing" {attributes}/>')
    assert not description.findings
    whole = description.dictionary.objects[0x2000]
    assert whole.object_type is object_type
    assert [each.data_type for each in whole.variables.values()] == variables


def test_objects_that_cannot_be_read() -> None:
    good = var('dataType="0005" accessType="ro" defaultValue="1"')
    description = read(good + good + var("", "0000") + var("", "20000") + var("", "+"))
    assert [(each.line, each.code) for each in description.findings] == [
        (5, "duplicate"), (6, "number"), (7, "number"), (8, "number")
    ]  # fmt: skip
    assert "line 4" in description.findings[0].message
    assert len(description.dictionary) == 1


def test_strict_raises_the_first_error() -> None:
    data = xdd(var('dataType="0005"') + var('dataType="0005" accessType="rw" defaultValue="x"', "2001") + var("", "x"))
    with pytest.raises(DictionaryError) as caught:
        read_xdd(data, "my.xdd", strict=True)
    assert (caught.value.source, caught.value.line, len(caught.value.findings)) == ("my.xdd", 5, 1)
    assert len(read_xdd(xdd(var('dataType="0005"')), strict=True).findings) == 1


@pytest.mark.parametrize("prefix", ["", "q1:", "x-y:"])
def test_any_prefix(prefix: str) -> None:
    data = xdd(var('dataType="0005" accessType="ro"')).decode()
    renamed = (
        data.replace("</", "<//").replace("<", "<" + prefix).replace(f"<{prefix}//", f"</{prefix}").replace(f"<{prefix}?", "<?")
    )
    description = read_xdd(renamed.encode())
    assert not description.findings
    assert "thing" in description.dictionary


def test_places() -> None:
    description = read(
        '<CANopenObject index="2000" name="thing"\n    defaultValue="5" dataType="0005" accessType="rw" uniqueIDRef="P"/>'
        + SUBS.format(2, ""),
        '<parameterList>\n<parameter uniqueID="P" access="read"><USINT/><actualValue value="3"/></parameter></parameterList>',
    )
    assert description.place_of(0x2000) == (5, 1)
    assert description.place_of(0x2000, 0, "ParameterName") == (5, 35)
    assert description.place_of(0x2000, None, "DefaultValue") == (6, 19)
    assert description.place_of(0x2000, 0, "ParameterValue") == (3, 67)
    assert description.place_of(0x2000, 0, "AccessType") == (6, 50)
    assert description.place_of(0x2000, 0, "LowLimit") == (5, 1)
    assert description.place_of(0x2000, 0, "nonsense") == (5, 1)
    assert description.place_of(0x1018, 1, "dataType") == (9, 74)
    assert description.place_of(0x1018, 9) == description.place_of(0x1018) == (7, 1)
    assert description.place_of(0x3000, 1) == (0, 0)


DEVICE = """<vendorName>Maker</vendorName><vendorID>0x55</vendorID><productName>Thing</productName><productID>17</productID>
<productText><description lang="en">A thing</description></productText><orderNumber>A-1</orderNumber>"""
NETWORK = """<TransportLayers><PhysicalLayer><baudRate><supportedBaudRate value="125 Kbps"/>
<supportedBaudRate value="auto-baudRate"/>
<supportedBaudRate value="1000 Kbps"/></baudRate></PhysicalLayer></TransportLayers><NetworkManagement>
<CANopenGeneralFeatures granularity="8" nrOfRxPDO="4" nrOfTxPDO="5" bootUpSlave="true" groupMessaging="1" dynamicChannels="2"
 layerSettingServiceSlave="true"/><CANopenMasterFeatures bootUpMaster="false"/>{}</NetworkManagement>"""
LAYERS = """<dummyUsage><dummy entry="Dummy0005=1"/><dummy entry="Dummy0006=0"/></dummyUsage><dynamicChannels>
<dynamicChannel dataType="0005" accessType="readOnly" startIndex="A000" endIndex="A03F" maxNumber="64" addressOffset="0010"/>
</dynamicChannels>"""


def test_the_device_as_a_whole() -> None:
    body = 'fileName="my.xdd" fileCreator="me" fileCreationDate="2024-01-02" fileCreationTime="10:00:00" fileVersion="1.2"'
    description = read("<!-- none -->", identity=DEVICE, network=NETWORK.format(""), layers=LAYERS, body=body)
    assert not description.findings
    device = description.device_info
    assert (device.vendor_name, device.vendor_number, device.product_name, device.product_number) == ("Maker", 0x55, "Thing", 17)
    assert (device.order_code, device.bit_rates, device.granularity) == ("A-1", frozenset({125, 1000}), 8)
    assert (device.rpdo_count, device.tpdo_count, device.dynamic_channels_supported) == (4, 5, 2)
    assert (device.simple_boot_up_slave, device.simple_boot_up_master) == (True, False)
    assert (device.group_messaging, device.lss_supported, device.revision_number) == (True, True, None)
    file = description.file_info
    assert (file.file_name, file.file_version, file.file_revision, file.description) == ("my.xdd", 1, 2, "A thing")
    assert (file.created_by, file.creation_date, file.creation_time) == ("me", "2024-01-02", "10:00:00")
    assert description.dummies == {5: True, 6: False}
    assert description.dynamic_channels == (DynamicChannel(5, "ro", 0xA000, 0xA03F, 0x10),)
    assert description.commissioning is None


def test_a_file_that_says_nothing_of_the_device() -> None:
    description = read(identity="<productText><description>only</description></productText>")
    assert not description.findings
    assert description.file_info.description == "only"
    assert (description.device_info.rpdo_count, description.dummies, description.dynamic_channels) == (None, None, ())


def test_faults_of_the_device_are_warnings() -> None:
    network = (
        NETWORK.replace("125 Kbps", "130 Kbps").replace("1000 Kbps", "fast").replace('nrOfRxPDO="4"', 'nrOfRxPDO="600"')
        .replace('bootUpSlave="true"', 'bootUpSlave="perhaps"').replace('nrOfTxPDO="5"', 'nrOfTxPDO="some"')
    )  # fmt: skip
    description = read(
        identity=DEVICE.replace("0x55", "0x1FFFFFFFF"),
        network=network.format(""),
        layers=LAYERS.replace("Dummy0005=1", "Dummy5").replace('dataType="0005"', 'dataType=""').replace("0010", "-"),
        body='fileVersion="new"',
    )
    assert {each.severity for each in description.findings} == {"warning"}
    codes = sorted(each.code for each in description.findings)
    assert codes == ["bit-rate", "bit-rate", "dummy", "flag"] + 6 * ["number"]
    assert description.device_info.vendor_number is None
    assert description.device_info.bit_rates == frozenset()
    assert description.dynamic_channels == ()


COMMISSIONING = '<deviceCommissioning nodeID="{}" nodeName="left" actualBaudRate="{}" networkNumber="3" networkName="arm" {}/>'


@pytest.mark.parametrize(
    ("rate", "kbit"), [("500 Kbps", 500), ("500", 500), ("1000000", 1000), ("auto-baudRate", None), ("", None)]
)
def test_commissioning(rate: str, kbit: int | None) -> None:
    description = read(network=NETWORK.format(COMMISSIONING.format(5, rate, 'CANopenManager="TRUE"')))
    assert not description.findings
    assert description.commissioning == Commissioning(5, "left", kbit, 3, "arm", True)
    assert description.kind is FileKind.XDC


@pytest.mark.parametrize(("node_id", "rate"), [("0", "7 Kbps"), ("128", "fast"), ("me", "-1")])
def test_commissioning_that_cannot_be(node_id: str, rate: str) -> None:
    text = COMMISSIONING.format(node_id, rate, "").replace('networkNumber="3" networkName="arm"', "")
    description = read(network=NETWORK.format(text))
    assert len(description.findings) == 2
    assert description.commissioning == Commissioning(node_name="left")


def test_real_numbers() -> None:
    description = read(var('dataType="0008" accessType="rw" defaultValue="-inf" lowLimit="-1.5e3" highLimit="0x10"'))
    thing = description.dictionary.variable("thing")
    assert (thing.default, thing.low_limit, thing.high_limit) == (-math.inf, -1500.0, 16.0)
    assert [(each.code, each.severity) for each in description.findings] == [("limit", "warning")]


def test_an_odd_value_is_read_with_a_warning() -> None:
    description = read(var('dataType="0007" accessType="rw" defaultValue="0180h"'))
    assert description.dictionary.variable("thing").default == 0x180
    assert told(description) == ["4:103 warning value"]


@pytest.mark.parametrize("text", ["Größe", "20 €", "日本", "Ω"])
def test_a_text_has_one_verdict_in_xdd_and_eds(text: str) -> None:
    """A VISIBLE_STRING has no character beyond Latin-1; the reader keeps the text, and lint says so of both files."""
    section = f"[2000]\nParameterName=a\nObjectType=7\nDataType=9\nAccessType=ro\nDefaultValue={text}\nPDOMapping=0\n"
    both = read(var(f'dataType="0009" accessType="ro" defaultValue="{text}"', "2000")), read_eds(section)
    codes = []
    for description in both:
        assert description.dictionary.variable(0x2000).default == text
        assert not [each for each in description.findings if each.code == "value"]
        codes.append([each.code for each in check(description) if each.code.startswith(("text", "default"))])
    assert codes[0] == codes[1] == ([] if text == "Größe" else ["text-characters"])


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        ("", "this device has modules"),
        ("<interfaceList/>", "this device has modules"),
        ("<moduleInterface/>", "describes a module"),
    ],
)
def test_that_modules_are_not_read_is_told(inside: str, words: str) -> None:
    """CiA 311 v1.1: a device lists the interfaces for its modules; the file of a module names the one that it fits."""
    modules = f"<moduleManagement>{inside}</moduleManagement><CANopenObjectList".encode()
    text = xdd(var('dataType="0005" accessType="rw"')).replace(b"<CANopenObjectList", modules, 1)
    (finding,) = read_xdd(text).findings
    assert finding.code == "modules"
    assert words in finding.message
