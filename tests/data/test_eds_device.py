"""What an EDS or DCF says of the device as a whole."""

from __future__ import annotations

from canopen_data.description import Commissioning, DeviceInfo, DynamicChannel, FileInfo, FileKind, Module
from canopen_data.eds import read_eds

OBJECT = "[2000]\nParameterName=x\nDataType=7\nAccessType=rw\n"


def told(text: str) -> list[str]:
    """The findings, without the file's name."""
    return [str(each).removeprefix("x:") for each in read_eds(f"{text}\n{OBJECT}", "x").findings]


def test_file_info() -> None:
    text = (
        "[FILEINFO]\nFileName=a.eds\nFileVersion=1\nFileRevision=2\nEDSVersion=4.0\nDescription=d\nCreationTime=01:33PM\n"
        "CreationDate=05-23-2013\nCreatedBy=me\nModificationTime=02:00PM\nModificationDate=05-24-2013\nModifiedBy=you\nLastEDS=b.eds\n"
    )
    assert read_eds(text).file_info == FileInfo(
        "a.eds", 1, 2, "4.0", "d", "01:33PM", "05-23-2013", "me", "02:00PM", "05-24-2013", "you", "b.eds"
    )


def test_device_info() -> None:
    text = (
        "[DeviceInfo]\nVendorName=v\nVendorNumber=0x319\nProductName=p\nProductNumber=001\nRevisionNumber=0x20003\nOrderCode=o\n"
        "BaudRate_125=1\nBaudRate_250=0\nbaudrate_1000=0x1\nSimpleBootUpMaster=0\nSimpleBootUpSlave=1\nGranularity=8\n"
        "DynamicChannelsSupported=3\nGroupMessaging=true\nNrOfRXPDO=4\nNrOfTXPDO=5\nLSS_Supported=1\nCompactPDO=0\n"
    )
    assert read_eds(text).device_info == DeviceInfo(
        "v", 0x319, "p", 1, 0x20003, "o", frozenset({125, 1000}), False, True, 8, 3, True, 4, 5, True, 0
    )
    assert told(text) == []
    assert read_eds("").device_info == DeviceInfo()


def test_numbers_and_flags_that_cannot_be_read() -> None:
    text = (
        "[DeviceInfo]\nVendorNumber=?\nProductNumber=4294967296\nRevisionNumber=010\nBaudRate_10=2\nBaudRate_20=perhaps\n"
        "Granularity=-1"
    )
    assert told(text) == [
        "2:14: warning: in [DeviceInfo]: VendorNumber=? is not a number; left out [number]",
        "3:15: warning: in [DeviceInfo]: ProductNumber=4294967296 is outside 0..4294967295; left out [number]",
        "4:16: warning: in [DeviceInfo]: RevisionNumber=010: a leading 0 means octal; read as 8 [number]",
        "5:13: warning: in [DeviceInfo]: BaudRate_10=2 is neither 0 nor 1; taken as 1 [number]",
        "6:13: warning: in [DeviceInfo]: BaudRate_20=perhaps is not a number; left out [number]",
        "7:13: warning: in [DeviceInfo]: Granularity=-1 is outside 0..4294967295; left out [number]",
    ]


def test_commissioning_in_both_spellings() -> None:
    for name in ("DeviceComissioning", "DeviceCommissioning"):
        text = (
            f"[{name}]\nNodeID=0x10\nNodeName=n\nBaudrate=500\nNetNumber=1\nNetworkName=w\nCANopenManager=1\nLSS_SerialNumber=7\n"
        )
        description = read_eds(text)
        assert description.commissioning == Commissioning(0x10, "n", 500, 1, "w", True, 7)
        assert description.kind is FileKind.DCF
    assert read_eds("").commissioning is None


def test_a_node_id_that_is_none() -> None:
    text = "[DeviceComissioning]\nNodeID=200\nBaudrate=0"
    assert read_eds(text).commissioning == Commissioning()
    assert told(text) == ["2:8: warning: in [DeviceComissioning]: NodeID=200 is outside 1..127; left out [number]"]


def test_dummies_may_be_some_only() -> None:
    assert read_eds("[DummyUsage]\nDummy0005=1\nDummy0007=0\nOther=1\n").dummies == {5: True, 7: False}
    assert read_eds("").dummies is None


def test_comments() -> None:
    assert read_eds("[Comments]\nLines=2\nLine2=b; c\nLine1=a\n").comments == ("a", "b; c")
    assert told("[Comments]\nLines=5\nLine1=a") == ["2:7: warning: in [Comments]: Lines is 5, but there are 1 entries [count]"]
    assert told("[Comments]\nLine1=a") == ["1:1: warning: in [Comments]: Lines is missing; there are 1 entries [count]"]
    assert told("[Comments]") == []


def test_lists_of_objects() -> None:
    text = "[MandatoryObjects]\nSupportedObjects=2\n2=0x1001\n1=4096\n[OptionalObjects]\nSupportedObjects=0\n"
    description = read_eds(text + "[ManufacturerObjects]\n1=0x2000\n10=0x2001\n2=010000\n3=70000\n")
    assert (description.mandatory, description.optional) == ((0x1000, 0x1001), ())
    assert description.manufacturer == (0x2000, 0o10000, 0x2001)
    assert told("[ManufacturerObjects]\nSupportedObjects=1000000000\n1=0x2000\n2=70000\n3=010000") == [
        "2:18: warning: in [ManufacturerObjects]: SupportedObjects is 1000000000, but there are 3 entries [count]",
        "4:3: warning: in [ManufacturerObjects]: 2=70000 is not the index of an object; left out [number]",
        "5:3: warning: in [ManufacturerObjects]: 3=010000: a leading 0 means octal; read as 4096 [number]",
    ]


MODULES = """
[SupportedModules]
NrOfEntries=2
[M1ModuleInfo]
ProductName=DI8
ProductVersion=1
ProductRevision=2
OrderCode=750-400
[M1Comments]
Lines=1
Line1=Eight inputs
[M1FixedObjects]
NrOfEntries=1
1=0x6100
[M1SubExtends]
NrOfEntries=2
1=0x6401
2=0x6000
[M1SubExt6000]
ParameterName=Inputs
Count=1
count=2
ObjExtend=0
[M1SubExt6401]
Count=0
[M2ModuleInfo]
ProductName=DO8
[ConnectedModules]
NrOfEntries=3
1=1
3=x
2=2
"""


def test_modules() -> None:
    description = read_eds(MODULES)
    first, second = description.modules
    assert first == Module(
        1,
        "DI8",
        1,
        2,
        "750-400",
        ("Eight inputs",),
        (0x6100,),
        {0x6401: {"Count": "0"}, 0x6000: {"ParameterName": "Inputs", "Count": "1", "ObjExtend": "0"}},
    )
    assert list(first.sub_extensions) == [0x6401, 0x6000]
    assert second == Module(2, "DO8")
    assert description.connected_modules == (1, 2)
    assert told("[SupportedModules]\nNrOfEntries=9\n[M1ModuleInfo]") == [
        "2:13: warning: in [SupportedModules]: NrOfEntries is 9, but there are 1 modules [count]"
    ]


def test_dynamic_channels() -> None:
    text = (
        "[DynamicChannels]\nNrOfSeg=2\nType1=0x0005\nDir1=ro\nRange1=0xA080-0xA0BF\nPPOffset1=16\n"
        "Type2=7\nDir2=rww\nRange2= 0xA480 - 0xA4BF\n"
    )
    assert read_eds(text).dynamic_channels == (
        DynamicChannel(5, "ro", 0xA080, 0xA0BF, 16),
        DynamicChannel(7, "rww", 0xA480, 0xA4BF, 0),
    )
    assert told("[DynamicChannels]\nNrOfSeg=3\nType1=5\nRange1=0xA080\nType2=5\nRange2=2-1\nType3=x\nRange3=1-2") == [
        "4:8: warning: in [DynamicChannels]: segment 1 has no type and range of indices; left out [number]",
        "6:8: warning: in [DynamicChannels]: segment 2 has no type and range of indices; left out [number]",
        "7:7: warning: in [DynamicChannels]: Type3=x is not a number; left out [number]",
        "8:8: warning: in [DynamicChannels]: segment 3 has no type and range of indices; left out [number]",
    ]
    assert told("[DynamicChannels]\nNrOfSeg=2") == [
        "2:9: warning: in [DynamicChannels]: NrOfSeg is 2, but there are 0 segments [count]"
    ]


def test_nothing_at_all() -> None:
    assert [str(each) for each in read_eds(b"", "x").findings] == [
        "x: error: there is no section of an object in this file [no-objects]"
    ]
