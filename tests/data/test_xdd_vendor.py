"""XDD files of real devices, and one device's EDS and XDD side by side."""

from __future__ import annotations

from dataclasses import fields

import pytest

from canopen_data.description import DeviceDescription, FileKind
from canopen_data.eds.reader import read_eds
from canopen_data.xdd import read_xdd
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Variable
from tests.vendor_files import XDD_NAMES, load, needs_vendor_files

pytestmark = needs_vendor_files

NO_ACCESS = {index << 8 | subindex for index in range(0x6005, 0x600A) for subindex in range(1, 3 if index < 0x6009 else 5)}
"""By mux. The XDD has access="noAccess", the EDS AccessType=UNKNOWN: both become rw, the XDD's with a direction by PDOmapping."""


@pytest.fixture
def pair() -> tuple[DeviceDescription, DeviceDescription]:
    return read_eds(load("sample-node-1.eds"), "sample-node-1.eds"), read_xdd(load("sample-node-1.xdd"), "sample-node-1.xdd")


@pytest.mark.parametrize("name", XDD_NAMES)
def test_nothing_is_lost(name: str) -> None:
    description = read_xdd(load(name), name, strict=True)
    assert description.kind is FileKind.XDD
    for variable in description.dictionary:
        line, column = description.place_of(variable.index, variable.subindex, "DefaultValue")
        assert line > 1
        assert column > 1


def test_a_large_one() -> None:
    description = read_xdd(load("oresat-gps.xdd"), "oresat-gps.xdd")
    assert not description.findings
    dictionary = description.dictionary
    assert (len(dictionary.objects), len(dictionary)) == (102, 608)
    error_field = dictionary.objects[0x1003]
    assert (error_field.data_type, len(error_field.variables)) == (DataType.UNSIGNED32, 9)
    emergency = dictionary.variable((0x1014, 0))
    assert (emergency.default_of(5), emergency.access) == (0x85, Access.RW)
    command = dictionary.variable((0x1023, 1))
    assert (command.data_type, command.access) == (DataType.DOMAIN, Access.RW)
    locked = dictionary.variable(0x6001)
    assert (locked.pdo_mappable, locked.access, locked.data_type) == (True, Access.RO, DataType.UNSIGNED8)
    assert dictionary.variable(0x2010).data_type is DataType.UNSIGNED64
    assert dictionary.variable(0x2010).description.startswith("CCSDS")
    assert description.device_info.bit_rates == {10, 20, 50, 125, 250, 500, 800, 1000}


def test_one_device_as_eds_and_as_xdd(pair: tuple[DeviceDescription, DeviceDescription]) -> None:
    eds, xdd = pair
    assert list(eds.dictionary.objects) == list(xdd.dictionary.objects)
    for index, ours in xdd.dictionary.objects.items():
        theirs = eds.dictionary.objects[index]
        assert (ours.name, ours.object_type, list(ours.variables)) == (theirs.name, theirs.object_type, list(theirs.variables))
    different: dict[str, set[int]] = {}
    for variable in xdd.dictionary:
        other = eds.dictionary.variable((variable.index, variable.subindex))
        for field in fields(Variable):
            if getattr(variable, field.name) != getattr(other, field.name):
                different.setdefault(field.name, set()).add(variable.mux)
    assert different == {"access": NO_ACCESS}


def test_what_the_two_files_say_of_the_device(pair: tuple[DeviceDescription, DeviceDescription]) -> None:
    eds, xdd = pair
    for name in ("dummies", "mandatory", "optional", "manufacturer", "commissioning", "dynamic_channels"):
        assert getattr(eds, name) == getattr(xdd, name), name
    different = {
        each.name
        for each in fields(eds.device_info)
        if getattr(eds.device_info, each.name) != getattr(xdd.device_info, each.name)
    }
    assert different == {"revision_number"}, "CiA 311 has none"
    of_file = {
        each.name for each in fields(eds.file_info) if getattr(eds.file_info, each.name) != getattr(xdd.file_info, each.name)
    }
    assert of_file == {
        "file_name",  # .eds, .xdd
        "file_revision",  # the XDD's version is "1"
        "eds_version",  # of CiA 306
        "creation_date", "creation_time", "modification_date", "modification_time",  # ISO 8601 in an XDD
    }  # fmt: skip
