"""What we write as XDD or XDC is read back as what it was."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree

import pytest
from hypothesis import given

from canopen_data.checks import check
from canopen_data.describing import describe, lists_of
from canopen_data.description import Commissioning, DeviceDescription, DeviceInfo, FileInfo, FileKind
from canopen_data.descriptions import load_description
from canopen_data.xdd import read_xdd
from canopen_data.xdd.writer import write_xdd
from canopen_proto.datatypes import DataType, Value, ValueRangeError
from canopen_proto.dictionary import Access, Object, ObjectDictionary, ObjectType, Variable
from canopen_proto.machine import LocalProtocolError
from canopen_testing.strategies import device_descriptions
from tests.examples import examples


def expressible(description: DeviceDescription) -> DeviceDescription:
    """What CiA 311 can say of a description."""

    def variable(each: Variable) -> Variable:
        return replace(each, upload_file="", download_file="", not_read="")

    def whole(each: Object) -> Object:
        variables = MappingProxyType({subindex: variable(one) for subindex, one in each.variables.items()})
        return replace(each, variables=variables)

    dictionary = ObjectDictionary([whole(each) for each in description.dictionary.objects.values()])
    mandatory, optional, manufacturer = lists_of(dictionary.objects)
    commissioning = description.commissioning and replace(description.commissioning, lss_serial_number=None)
    return DeviceDescription(
        dictionary,
        FileKind.XDD if commissioning is None else FileKind.XDC,
        file_info=replace(description.file_info, eds_version="", last_eds=""),
        device_info=replace(description.device_info, revision_number=None, compact_pdo=0),
        commissioning=commissioning,
        dummies=description.dummies,
        mandatory=mandatory,
        optional=optional,
        manufacturer=manufacturer,
        dynamic_channels=description.dynamic_channels,
    )


@given(device_descriptions())
@examples(60)
def test_what_is_written_is_read(described: DeviceDescription) -> None:
    wanted = expressible(described)
    text = write_xdd(described, wanted.kind)
    ElementTree.fromstring(text.encode())
    found = read_xdd(text.encode())
    assert found.dictionary.objects == wanted.dictionary.objects
    assert replace(found, dictionary=wanted.dictionary, document=None) == wanted
    assert found.findings == ()


@pytest.mark.parametrize("name", ["sample_io.eds", "sample_drive.eds"])
def test_an_eds_becomes_an_xdd(name: str) -> None:
    description = load_description(name)
    found = read_xdd(write_xdd(description).encode(), "new.xdd", strict=True)
    assert found.kind is FileKind.XDD
    assert found.dictionary.objects == description.dictionary.objects
    assert (found.file_info.creation_date, found.file_info.creation_time) == ("2026-11-21", "12:00:00")
    assert check(found) == check(description) == []


def test_a_dcf_becomes_an_xdc_or_an_xdd_without_its_settings() -> None:
    description = replace(load_description("sample_io.xdc"), commissioning=Commissioning(5, "station", 500))
    assert read_xdd(write_xdd(description).encode()).commissioning == Commissioning(5, "station", 500)
    plain = read_xdd(write_xdd(description, FileKind.XDD).encode())
    assert plain.kind is FileKind.XDD
    assert plain.commissioning is None
    with pytest.raises(LocalProtocolError, match="no EDS"):
        write_xdd(description, FileKind.EDS)


def test_characters_that_xml_cannot_have() -> None:
    variable = Variable(0x2000, 0, 'a "b" <c> & d\x01\ne', DataType.UNSIGNED8, Access.RO)
    description = DeviceDescription(ObjectDictionary([Object.of(variable.name, [variable], ObjectType.VAR)]), FileKind.EDS)
    found = read_xdd(write_xdd(description, file_info=FileInfo(created_by="me")).encode())
    assert found.dictionary.at(0x2000, 0).name == 'a "b" <c> & d? e'
    assert found.file_info.created_by == "me"
    assert found.device_info == DeviceInfo()


@pytest.mark.parametrize("facts", [{"default": 99999}, {"default": -1}, {"default": "abc"}, {"low_limit": -5}, {"factor": 0.0}])
def test_a_value_that_its_own_reader_would_not_give_back_is_never_written(facts: dict[str, Any]) -> None:
    variable = Variable(0x2000, 0, "Speed", DataType.UNSIGNED16, **facts)
    with pytest.raises(ValueRangeError, match=r"Speed \(0x2000:00\): .* cannot be kept in the file \(UNSIGNED16\)"):
        write_xdd(describe(ObjectDictionary([Object.of("Speed", [variable])])))


@pytest.mark.parametrize(
    ("data_type", "value"),
    [
        (DataType.REAL32, float("nan")),
        (DataType.VISIBLE_STRING, ""),
        (DataType.VISIBLE_STRING, "a\x19b"),
        (DataType.VISIBLE_STRING, " a"),
        (DataType.OCTET_STRING, b""),
    ],
)
def test_a_setting_that_an_xdc_cannot_hold_is_never_left_out(data_type: DataType, value: Value) -> None:
    """A DCF holds its bytes; an XDC would have another value, or none."""
    variable = Variable(0x2000, 0, "Setting", data_type, configured=value)
    described = replace(describe(ObjectDictionary([Object.of("Setting", [variable])])), commissioning=Commissioning(5))
    with pytest.raises(ValueRangeError, match=r"Setting \(0x2000:00\): .* cannot be kept in an XDC; a DCF can hold it"):
        write_xdd(described, FileKind.XDC)
    assert read_xdd(write_xdd(described, FileKind.XDD).encode()).dictionary.at(0x2000, 0).configured is None
