"""The linter of device descriptions: each rule with one small fault that it finds, and no other rule does."""

from __future__ import annotations

from dataclasses import replace

import pytest

from canopen_data.checks import RULES, check
from canopen_data.description import Commissioning, FileKind
from canopen_data.eds.reader import read_eds
from canopen_data.findings import Severity
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectType, Variable
from canopen_proto.dictionary.standard import standard_object
from tests.check.checked_device import (
    OFFSET,
    TABLE,
    Change,
    clean,
    field,
    file,
    head,
    info,
    several,
    whole,
    with_object,
    with_variable,
    without,
)

CASES: list[tuple[str, str, str, Change]] = [
    # objects, lists, names
    ("mandatory-missing", "[MandatoryObjects]", "there is no error register (0x1001)", without(0x1001)),
    ("list-unknown", "[ManufacturerObjects]", "0x2009 is listed, but has no section",
     head(manufacturer=(0x2000, 0x2001, 0x2002, 0x2003, 0x2009))),
    ("list-missing", "[2001]", "it is not in [ManufacturerObjects], nor in another list",
     head(manufacturer=(0x2000, 0x2002, 0x2003))),
    ("list-twice", "[ManufacturerObjects]", "0x2000 is listed twice",
     head(manufacturer=(0x2000, 0x2001, 0x2002, 0x2003, 0x2000))),
    ("list-twice", "[ManufacturerObjects]", "0x1017 is in [OptionalObjects] already",
     head(manufacturer=(0x2000, 0x2001, 0x2002, 0x2003, 0x1017))),
    ("list-other", "[OptionalObjects]", "0x2004 belongs into [ManufacturerObjects]",
     several(with_object(Object.of("More", [replace(OFFSET, index=0x2004, name="More")]), listed=False),
             lambda each: replace(each, optional=(*each.optional, 0x2004)))),
    ("reserved-index", "[C000]", "objects are at 0x1000 to 0xBFFF",
     with_variable(replace(OFFSET, index=0xC000, name="Far"))),
    ("no-entries", "[2004]", "it is a RECORD without any sub-object",
     with_object(Object(0x2004, "Empty", ObjectType.RECORD, {}))),
    ("count-missing", "[2003]", "it has no sub 0, which gives its highest subindex",
     whole(0x2003, variables={1: TABLE.variables[1], 2: TABLE.variables[2]})),
    ("count-type", "[2003sub0]", "sub 0 is of type UNSIGNED16; it is an UNSIGNED8 in every device",
     field(0x2003, 0, data_type=DataType.UNSIGNED16)),
    ("count-default", "[2003sub0]", "sub 0 says that 7 is the highest subindex; the file has entries up to 2",
     field(0x2003, 0, default=7)),
    ("var-with-entries", "[2003]", "it is a VAR, but has 3 sub-objects", whole(0x2003, object_type=ObjectType.VAR)),
    ("array-mixed", "[2003]", "it is an ARRAY, but sub 1 is UNSIGNED16, sub 2 is UNSIGNED8",
     field(0x2003, 2, data_type=DataType.UNSIGNED8)),
    ("name-empty", "[2001]", "the object has no name", with_variable(replace(OFFSET, name=""))),
    ("name-empty", "[2003sub1]", "the sub-object has no name", field(0x2003, 1, name="Table:")),
    ("name-long", "[2001]", "its name has 242 characters; 241 is the most",
     with_variable(replace(OFFSET, name=242 * "x"))),
    ("name-twice", "[2000]", "this is the name of 0x2001 too", with_variable(replace(OFFSET, name="GAIN"))),
    ("name-twice", "[2003sub1]", "this is the name of sub 2 too",
     several(whole(0x2003, object_type=ObjectType.RECORD), field(0x2003, 2, name="Table:First"))),
    # values
    ("default-type", "[2001]", "DefaultValue='x': INTEGER32 takes an integer, not 'x'", field(0x2001, 0, default="x")),
    ("default-type", "[2000]", "DefaultValue=65535: 65536 is outside 0..65535 (UNSIGNED16)",
     field(0x2000, 0, default=65535, adds_node_id=True, high_limit=None)),
    ("text-characters", "[2002]", "DefaultValue='5 €': a VISIBLE_STRING has no character '\\u20ac' ('5 €')",
     field(0x2002, 0, default="5 €")),
    ("default-limits", "[2000]", "DefaultValue=101 is outside its limits 0..100", field(0x2000, 0, default=101)),
    ("default-limits", "[2000]", "DefaultValue=0 is outside its limits 1..",
     field(0x2000, 0, default=0, low_limit=1, high_limit=None)),
    ("configured-type", "[2001]", "ParameterValue=2147483648: 2147483648 is outside -2147483648..2147483647 (INTEGER32)",
     field(0x2001, 0, configured=1 << 31)),
    ("configured-limits", "[2000]", "ParameterValue=101 is outside its limits 0..100",
     field(0x2000, 0, configured=101)),
    ("configured-read-only", "[2002]", "it is const, so that 'B' cannot be written there",
     field(0x2002, 0, configured="B")),
    ("limits-crossed", "[2000]", "LowLimit 9 is above HighLimit 1: no value lies between",
     field(0x2000, 0, default=None, low_limit=9, high_limit=1)),
    ("limit-type", "[2000]", "HighLimit 65536 is outside 0..65535 (UNSIGNED16)", field(0x2000, 0, high_limit=65536)),
    ("limit-useless", "[2002]", "a VISIBLE_STRING has no limits", field(0x2002, 0, low_limit=0)),
    ("real-infinite", "[2001]", "DefaultValue is infinite",
     field(0x2001, 0, data_type=DataType.REAL64, default=float("inf"))),
    ("real-infinite", "[2001]", "HighLimit is infinite",
     field(0x2001, 0, data_type=DataType.REAL32, default=1.0, high_limit=float("inf"))),
    ("const-default", "[2003sub1]", "it is const, but has no DefaultValue", field(0x2003, 1, access=Access.CONST)),
    ("domain-default", "[2004]", "a DOMAIN is sent as it is; a default for it has no meaning",
     with_object(Object.of("Data", [Variable(0x2004, 0, "Data", DataType.DOMAIN, default=b"x" * 50)], ObjectType.DOMAIN))),
    ("mappable-type", "[2004]", "PDOMapping=1, but no PDO can carry a DOMAIN",
     with_object(Object.of("Data", [Variable(0x2004, 0, "Data", DataType.DOMAIN, pdo_mappable=True)], ObjectType.DOMAIN))),
    # standard objects
    ("standard-type", "[1017]", "it is of type UNSIGNED32; producer_heartbeat_time is UNSIGNED16 to the standard",
     field(0x1017, 0, data_type=DataType.UNSIGNED32)),
    ("profile-type", "[6041]", "it is of type UNSIGNED32; statusword is UNSIGNED16 to the standard",
     several(field(0x6041, 0, data_type=DataType.UNSIGNED32), field(0x1A00, 1, default=0x60410020))),
    ("standard-sign", "[6040]", "it is of type INTEGER16; controlword is UNSIGNED16 to the standard",
     field(0x6040, 0, data_type=DataType.INTEGER16)),
    ("standard-access", "[6041]", "it is rw; statusword is ro to the standard", field(0x6041, 0, access=Access.RW)),
    ("standard-access", "[1017]", "it cannot be read; producer_heartbeat_time is rw to the standard",
     field(0x1017, 0, access=Access.WO)),
    ("standard-access", "[1017]", "it is ro; producer_heartbeat_time is rw to the standard",
     field(0x1017, 0, access=Access.RO)),
    ("standard-access", "[1003sub0]", "it is ro; predefined_error_field:number_of_errors is rw to the standard",
     several(with_object(standard_object(0x1003, highest=2)), field(0x1003, 0, access=Access.RO))),
    ("reserved-sub", "[1800sub4]", "the sub-index is reserved, and no device is to have it (CiA 301, 7.5.2.37)",
     several(with_object(standard_object(0x1800, highest=4, defaults={0: 4, 2: 255})),
             field(0x1800, 1, default=0x180, adds_node_id=True))),
    ("reserved-bits", "[1014]", "$NODEID+0x40000080 has bits of 0x40000000, which are reserved",
     field(0x1014, 0, default=0x4000_0080, adds_node_id=True)),
    ("reserved-bits", "[1016sub1]", "0x1050064 has bits of 0xFF000000, which are reserved",
     field(0x1016, 1, default=0x0105_0064)),
    ("consumer-limits", "[1016sub2]", "HighLimit 65535 forbids node-IDs and times up to 0x007FFFFF (node-ID << 16 | ms)",
     field(0x1016, 2, default=0, high_limit=0xFFFF)),
    ("consumer-limits", "[1016sub1]", "LowLimit 1 forbids 0, by which the entry is not in use", field(0x1016, 1, low_limit=1)),
    ("standard-object", "[1017]", "it is a RECORD; to the standard it is one variable",
     several(whole(0x1017, object_type=ObjectType.RECORD), field(0x1017, 0, data_type=DataType.UNSIGNED8, access=Access.CONST))),
    ("standard-object", "[6091]", "it is a VAR; to the standard it is an ARRAY or a RECORD",
     with_variable(Variable(0x6091, 0, "Gear", DataType.UNSIGNED32))),
    ("standard-mappable", "[1017]", "PDOMapping=1; to the standard no PDO carries it",
     field(0x1017, 0, pdo_mappable=True)),
    ("drive-objects", "[1000]", "the device type says CiA 402, but there is no controlword (0x6040)",
     several(without(0x6040), field(0x1600, 1, default=0x20000010))),
    ("error-control-missing", "[OptionalObjects]",
     "there is neither a producer heartbeat time (0x1017) nor a guard time (0x100C)", without(0x1017)),
    ("error-control-twice", "[1017]", "a heartbeat every 100 ms by default, and node guarding (0x100C, 0x100D) too",
     several(with_object(standard_object(0x100C, 100)), with_object(standard_object(0x100D, 3)))),
    ("heartbeat-consumer", "[1016sub2]", "node 5 is watched by sub 1 already", field(0x1016, 2, default=0x0005_0064)),
    ("heartbeat-consumer", "[1016sub2]", "node-ID 128 is outside 1..127", field(0x1016, 2, default=0x0080_0064)),
    # PDOs
    ("pdo-no-mapping", "[1401]", "RPDO2 has no mapping parameter (0x1601)",
     several(with_object(standard_object(0x1401, highest=2, defaults={0: 2})), info(rpdo_count=2))),
    ("pdo-no-communication", "[1601]", "RPDO2 has no communication parameter (0x1401)",
     with_object(standard_object(0x1601, 0, highest=1))),
    ("pdo-entries", "[1600sub0]", "sub 0 is 5, but there are 4 entries",
     several(field(0x1600, 0, default=5), field(0x1600, 3, default=0x20000010), field(0x1600, 4, default=0x00050008))),
    ("pdo-gap", "[1600sub2]", "the entry is counted, but maps nothing", field(0x1600, 2, default=0)),
    ("pdo-object", "[1A00sub2]", "0x20090010 maps 2009:00, which is not in the file",
     field(0x1A00, 2, default=0x20090010)),
    ("pdo-not-mappable", "[1A00sub2]", "0x20010020 maps 2001:00 (Offset), whose PDOMapping is 0",
     field(0x1A00, 2, default=0x20010020)),
    ("pdo-access", "[1600sub1]", "0x60410010 maps 6041:00 (statusword) into an RPDO, but it is ro",
     field(0x1600, 1, default=0x60410010)),
    ("pdo-access", "[1A00sub2]", "0x20000010 maps 2000:00 (Gain) into a TPDO, but it is wo",
     field(0x2000, 0, access=Access.WO)),
    ("pdo-direction", "[1A00sub1]", "0x60400010 maps 6040:00 (controlword) into a TPDO, but it is rww",
     field(0x1A00, 1, default=0x60400010)),
    ("pdo-bits", "[1A00sub2]", "0x20000020 maps 2000:00 (Gain) with 32 bits; its type UNSIGNED16 has 16",
     field(0x1A00, 2, default=0x20000020)),
    ("pdo-part", "[1A00sub2]", "0x20000008 maps 2000:00 (Gain) with 8 bits; it has 16",
     field(0x1A00, 2, default=0x20000008)),
    ("pdo-long", "[1A00sub0]", "TPDO1 has 96 bits; 64 is the most",
     several(*(field(0x1A00, each, default=0x20020020) for each in (3, 4)), field(0x1A00, 2, default=0x20000010),
             field(0x1A00, 0, default=4), field(0x2002, 0, pdo_mappable=True))),
    ("pdo-dummy", "[1600sub2]", "0x00060010 is a dummy entry, but [DummyUsage] does not allow UNSIGNED16 (Dummy0006=0)",
     field(0x1600, 2, default=0x00060010)),
    ("pdo-dummy", "[1600sub2]", "0x00050010 is not a dummy entry: no such data type of so many bits",
     field(0x1600, 2, default=0x00050010)),
    ("pdo-dummy", "[1A00sub2]", "0x00050008 is a dummy entry (UNSIGNED8) in a TPDO; they are for RPDOs",
     field(0x1A00, 2, default=0x00050008)),
    ("transmission-type", "[1400sub2]", "transmission type 252 is reserved for RPDOs", field(0x1400, 2, default=252)),
    ("sync-missing", "[1800sub2]", "the PDO goes by SYNC, but there is no COB-ID SYNC (0x1005)",
     several(without(0x1005), field(0x1800, 2, default=1))),
    ("pdo-count", "[DeviceInfo]", "NrOfTXPDO=4, but the file has 1 TPDO communication parameters", info(tpdo_count=4)),
    # COB-IDs
    ("cob-id-restricted", "[1005]", "SYNC has COB-ID 0x6E0: CAN-ID 0x6E0 is restricted (CiA 301, table 40)",
     field(0x1005, 0, default=0x6E0)),
    ("cob-id-restricted", "[1800sub1]", "TPDO1 has COB-ID $NODEID+0x7F0: CAN-ID 0x7F1 is restricted (CiA 301, table 40)",
     field(0x1800, 1, default=0x7F0)),
    ("cob-id-restricted", "[1800sub1]", "TPDO1 has COB-ID 0x40001234: CAN-ID 0x1234 has more than 11 bits, and bit 29 is 0",
     field(0x1800, 1, default=0x4000_1234, adds_node_id=False)),
    ("cob-id-clash", "[1800sub1]", "TPDO1 has COB-ID $NODEID+0x200, which RPDO1 (1400:01) has already",
     field(0x1800, 1, default=0x200)),
    ("cob-id-fixed", "[1800sub1]", "TPDO1 has COB-ID 0x182, which is right for node 2 only; $NODEID+0x180 is right in each",
     field(0x1800, 1, default=0x182, adds_node_id=False)),
    # device and file
    ("identity-missing", "[1018]", "it has no sub 1 (vendor-ID)",
     with_object(replace(standard_object(0x1018, highest=1, defaults={0: 2}), variables={
         0: standard_object(0x1018, highest=2).variables[0], 2: standard_object(0x1018, highest=2).variables[2]}))),
    ("identity-differs", "[1018sub2]", "it is 0x11 here and 0x10 in [DeviceInfo] (ProductNumber)",
     field(0x1018, 2, default=0x11)),
    ("vendor-missing", "[DeviceInfo]", "there is neither VendorName nor VendorNumber",
     info(vendor_name="", vendor_number=None)),
    ("product-missing", "[DeviceInfo]", "there is neither ProductName nor ProductNumber",
     info(product_name="", product_number=None)),
    ("bit-rate-missing", "[DeviceInfo]", "no bit rate is supported: all BaudRate_... are 0",
     info(bit_rates=frozenset())),
    ("granularity", "[DeviceInfo]", "Granularity=99 is outside 0..64", info(granularity=99)),
    ("commissioning-missing", "[DeviceCommissioning]", "there is no node-ID", head(kind=FileKind.DCF)),
    ("node-id", "[DeviceCommissioning]", "NodeID=200 is outside 1..127",
     head(kind=FileKind.DCF, commissioning=Commissioning(200))),
    ("bit-rate-unsupported", "[DeviceCommissioning]", "Baudrate=1000, but the device supports 500 kbit/s",
     head(kind=FileKind.DCF, commissioning=Commissioning(3, bit_rate=1000))),
    ("eds-version", "[FileInfo]", "EDSVersion=four is not of the form 4.0", file(eds_version="four")),
    ("file-name", "[FileInfo]", "FileName=other.eds, but the file is called drive.eds", file(file_name="other.eds")),
    ("file-date", "[FileInfo]", "CreationDate=23-05-2013 is not of the form 05-23-2013 (month first)",
     file(creation_date="23-05-2013")),
    ("file-date", "[FileInfo]", "ModificationTime=13:33 is not of the form 01:33PM", file(modification_time="13:33")),
]  # fmt: skip


@pytest.mark.parametrize("kind", list(FileKind))
def test_there_is_nothing_wrong_with_a_clean_file(kind: FileKind) -> None:
    assert check(clean(kind)) == []


@pytest.mark.parametrize(
    ("code", "place", "text", "change"), CASES, ids=[f"{number}-{case[0]}" for number, case in enumerate(CASES)]
)
def test_a_fault_is_found_by_its_rule_and_no_other(code: str, place: str, text: str, change: Change) -> None:
    (finding,) = check(change(clean()))
    where, _, said = finding.message.partition(": ")
    assert (finding.code, where.split(" ")[:2], said) == (code, ["in", place], text)
    assert finding.severity is {rule.code: rule.severity for rule in RULES}[code]
    assert finding.source == "folder/drive.eds"


def test_every_rule_has_a_fault_that_it_finds() -> None:
    codes = [rule.code for rule in RULES]
    assert len(codes) == len(set(codes))
    assert set(codes) == {case[0] for case in CASES}


def test_a_finding_says_where_it_is() -> None:
    fault = field(0x1A00, 2, default=0x20090010)
    (finding,) = check(fault(clean()))
    assert str(finding) == (
        "folder/drive.eds: error: in [1A00sub2] tpdo1_mapping_parameter:object_2: "
        "0x20090010 maps 2009:00, which is not in the file [pdo-object]"
    )
    (in_xml,) = check(fault(clean(FileKind.XDD)))
    assert in_xml.message.startswith("in 1A00:02 tpdo1_mapping_parameter:object_2: ")
    (of_head,) = check(info(rpdo_count=2)(clean(FileKind.XDD)))
    assert of_head.message.startswith("NrOfRXPDO=2, but ")


# ---- what is no fault ----


@pytest.mark.parametrize(
    "change",
    [
        field(0x2003, 2, name="Table:First"),  # entries of an ARRAY are told apart by their number
        field(0x1800, 1, default=0x8000_0180),  # a PDO that does not exist yet
        several(field(0x1800, 1, default=0x8000_0000, adds_node_id=False), field(0x1800, 2, default=0)),
        several(without(0x1005), field(0x1800, 1, default=0x8000_0180), field(0x1800, 2, default=1)),
        field(0x1A00, 0, default=0xFE),  # a multiplexed PDO has no mapping
        field(0x1A00, 0, default=0),
        field(0x1A00, 0, default=None),
        field(0x1A00, 3, default=0x2009_0010),  # behind those in use
        field(0x1A00, 1, default=None),  # the file does not say
        field(0x1005, 0, default=0x4000_0080),  # the device produces SYNC
        field(0x1800, 1, default=0x2000_0181, adds_node_id=False),  # 29 bits: another CAN-ID than 0x181
        several(field(0x2002, 0, pdo_mappable=True), field(0x1A00, 2, default=0x2002_0010)),  # two letters of a text
        field(0x1016, 2, default=0),  # a consumer that is not in use
        field(0x6041, 0, pdo_mappable=True, access=Access.CONST, default=1),
        with_object(standard_object(0x1200, highest=2, defaults={0: 2})),
        with_object(standard_object(0x1201, highest=3, defaults={0: 3})),
        with_object(standard_object(0x1003, 0, highest=8)),
        field(0x1017, 0, access=Access.CONST),
        several(field(0x1016, 1, low_limit=0, high_limit=0x00FF_FFFF)),
        with_object(standard_object(0x1280, defaults={1: 0x605, 2: 0x585, 3: 5})),  # a client of node 5's own channel
        with_object(standard_object(0x100C, 100)),
        with_object(Object(0x0040, "Own type", ObjectType.DEFSTRUCT, {}), listed=False),
        several(without(0x1017), with_object(standard_object(0x100C, 100))),
        several(without(0x6040, 0x6041), with_object(standard_object(0x6840)), with_object(standard_object(0x6841)),
                field(0x1600, 1, default=0x68400010), field(0x1A00, 1, default=0x68410010)),
        several(field(0x1000, 0, default=401), with_variable(Variable(0x6091, 0, "Other", DataType.REAL32))),
        several(field(0x1000, 0, default=None), without(0x6040), field(0x1600, 1, default=0x20000010)),
        info(vendor_number=None, product_number=0, revision_number=0, rpdo_count=None),
        file(eds_version="", creation_date="", file_name="DRIVE.EDS"),
        field(0x2001, 0, default=float(1), data_type=DataType.REAL32, low_limit=0.5, high_limit=1.5),
    ],
)  # fmt: skip
def test_what_devices_do_for_good_reason_is_not_reported(change: Change) -> None:
    assert check(change(clean())) == []


def test_many_objects_of_one_name_are_one_finding() -> None:
    twins = several(*(with_variable(replace(OFFSET, index=index)) for index in range(0x2010, 0x2018)))
    (finding,) = check(twins(clean()))
    assert finding.message.endswith("this is the name of 0x2010, 0x2011, 0x2012, 0x2013, 0x2014, 0x2015 and 2 more too")


def test_a_line_that_stands_for_many_sub_objects_has_one_finding() -> None:
    limits = "LowLimit=1\nHighLimit=3\nDefaultValue=9\n"
    compact = f"[2010]\nParameterName=Many\nObjectType=8\nDataType=5\nAccessType=rw\n{limits}CompactSubObj=200\n"
    single = f"[2010sub7]\nParameterName=One\nDataType=5\nAccessType=rw\n{limits}"
    found = [each for each in check(read_eds(compact + single)) if each.code == "default-limits"]
    assert [(each.line, each.message.partition(": ")[2]) for each in found] == [
        (8, "DefaultValue=9 is outside its limits 1..3; the same of 198 more sub-objects"),
        (16, "DefaultValue=9 is outside its limits 1..3"),
    ]


def test_a_commissioned_node_id_is_added() -> None:
    dcf = clean(FileKind.DCF)
    (finding,) = check(field(0x1800, 1, configured=0x203)(dcf))
    assert finding.message.endswith("TPDO1 has COB-ID 0x203, which RPDO1 (1400:01) has already")
    (limit,) = check(field(0x2000, 0, configured=98, configured_adds_node_id=True)(dcf))
    assert limit.code == "configured-limits"
    assert not check(field(0x2000, 0, configured=97, configured_adds_node_id=True)(dcf))
    assert not check(field(0x1800, 1, configured=0x183)(dcf))


def test_findings_come_in_the_order_of_the_file() -> None:
    class Lines:
        def place_of(self, index: int, subindex: int | None = None, field: str = "") -> tuple[int, int]:
            return (0x10000 - index, 1 if subindex is None else subindex + 2)

    faulty = several(field(0x2000, 0, default=101), field(0x2001, 0, default="x"), head(document=Lines()))
    assert [(each.code, each.column) for each in check(faulty(clean()))] == [("default-type", 2), ("default-limits", 2)]


def test_the_findings_of_one_file_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last one gives the number and the worst severity of the rest."""
    monkeypatch.setattr("canopen_data.checks.MAX_FINDINGS", 5)
    listed = "".join(f"{number}=0x{0x1F00 + number:04X}\n" for number in range(20))
    found = check(read_eds(f"[ManufacturerObjects]\n{listed}[1F00]\nDataType=5\nAccessType=ro\n"))
    assert len(found) == 6
    assert found[-1].code == "too-many"
    assert found[-1].severity is Severity.ERROR
    assert "more findings not listed" in found[-1].message
