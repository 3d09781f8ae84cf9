"""A description around a dictionary that came without one."""

from __future__ import annotations

from dataclasses import replace

import canopen_data
from canopen_data.describing import describe, identified
from canopen_data.description import DeviceInfo, FileInfo, FileKind
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.simulation.drive.dictionary import drive_dictionary


def test_what_follows_from_the_objects() -> None:
    described = describe(drive_dictionary())
    info = described.device_info
    assert described.kind is FileKind.CSV
    assert (info.vendor_number, info.product_number, info.revision_number) == (0, 0xE5, 0x10000)
    assert (info.rpdo_count, info.tpdo_count, info.granularity) == (4, 4, 8)
    assert described.mandatory == (0x1000, 0x1001, 0x1018)
    assert described.manufacturer == ()
    assert {*described.mandatory, *described.optional} == set(described.dictionary.objects)
    assert described.file_info.eds_version == "4.0"
    assert "simulated drive" in described.source


def test_nothing_is_made_up() -> None:
    names = ObjectDictionary([Object.of("identity", [Variable(0x1018, 1, "vendor", DataType.UNSIGNED32)])])
    info = describe(names).device_info
    assert (info.vendor_number, info.product_number, info.granularity, info.bit_rates) == (None, None, 0, frozenset())
    made, _ = canopen_data.load_dictionary()
    assert describe(made).device_info.vendor_name == ""


def test_what_the_caller_says_counts() -> None:
    said = DeviceInfo(vendor_number=7, granularity=1, rpdo_count=9, tpdo_count=8)
    info = FileInfo("mine.eds")
    described = describe(drive_dictionary(), device_info=said, file_info=info)
    got = described.device_info
    assert (got.vendor_number, got.product_number, got.granularity, got.rpdo_count, got.tpdo_count) == (7, 0xE5, 1, 9, 8)
    assert described.file_info == info


def test_manufacturer_objects_have_their_own_list() -> None:
    objects = [Object.of("x", [Variable(index, 0, "x", DataType.UNSIGNED8)]) for index in (0x6000, 0x2000, 0x5FFF, 0x1017)]
    described = describe(ObjectDictionary(objects))
    assert (described.mandatory, described.optional, described.manufacturer) == ((), (0x1017, 0x6000), (0x2000, 0x5FFF))


def test_the_identity_of_the_file_where_the_object_has_none() -> None:
    members = [Variable(0x1018, subindex, f"number{subindex}", DataType.UNSIGNED32) for subindex in (1, 2, 3, 4)]
    members[1] = replace(members[1], default=5)
    info = DeviceInfo(vendor_number=0xFB, product_number=6, revision_number=None)
    dictionary = identified(describe(ObjectDictionary([Object.of("identity", members)]), device_info=info))
    assert [dictionary.variable((0x1018, subindex)).default for subindex in (1, 2, 3, 4)] == [0xFB, 5, None, None]
    nothing = describe(ObjectDictionary([]), device_info=info)
    assert identified(nothing) is nothing.dictionary
