"""Another stack reads the files that we write: to the same values, where its import is right."""

from __future__ import annotations

import io
import struct
from typing import Any

import canopen
import pytest
from hypothesis import assume, given

import canopen_data
from canopen_data.describing import describe
from canopen_data.description import DeviceDescription, DeviceInfo, FileKind
from canopen_data.eds.writer import write_eds
from canopen_proto.datatypes import DataType, Value, is_integer, is_signed
from canopen_proto.dictionary import Access, Object, ObjectDictionary, ObjectType, Variable
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import Shape
from canopen_testing.strategies import device_descriptions
from tests.examples import examples

NODE_ID = 5
_LIMITED = (1, 2, 4, 8)
"""Bytes of the signed integers whose limits it reads; those of others, and of REALs, it drops."""


def imported(text: str) -> Any:
    return canopen.objectdictionary.eds.import_eds(io.StringIO(text), NODE_ID)  # type: ignore[no-untyped-call]


def raw(variable: Variable, value: Value | None, adds_node_id: bool) -> object:
    """A value as the peer has it."""
    if isinstance(value, bool | int):
        return int(value) + NODE_ID * adds_node_id
    if value is None or value in ("", b"") or isinstance(value, float | str | bytes):
        return None if value in ("", b"") else value
    return int.from_bytes(variable.encode(value), "little")


def compare(theirs: Any, variable: Variable) -> None:
    assert theirs.index == variable.index
    assert theirs.subindex == variable.subindex
    assert theirs.name == variable.name
    assert theirs.data_type == variable.data_type
    assert theirs.access_type == variable.access
    assert theirs.pdo_mappable == variable.pdo_mappable
    assert theirs.default == raw(variable, variable.default, variable.adds_node_id)
    if variable.configured is not None:
        assert theirs.value == raw(variable, variable.configured, variable.configured_adds_node_id)
    if is_integer(variable.data_type) and (not is_signed(variable.data_type) or variable.size in _LIMITED):
        assert (theirs.min, theirs.max) == (variable.low_limit, variable.high_limit)


def compare_all(described: DeviceDescription) -> None:
    theirs = imported(write_eds(described))
    assert sorted(index for index in theirs if index >= 0x1000) == sorted(described.dictionary.objects)
    for each in described.dictionary.objects.values():
        single = each.object_type in (ObjectType.VAR, ObjectType.DOMAIN)
        for subindex, variable in each.variables.items():
            compare(theirs[each.index] if single else theirs[each.index].subindices[subindex], variable)
    info = described.device_info
    assert theirs.device_information.vendor_number == info.vendor_number
    assert theirs.device_information.allowed_baudrates == {1000 * rate for rate in info.bit_rates}
    assert theirs.device_information.LSS_supported == info.lss_supported


@pytest.mark.parametrize("shape", Shape)
def test_the_simulated_drives(shape: Shape) -> None:
    compare_all(describe(drive_dictionary(shape), device_info=DeviceInfo(bit_rates=frozenset({125, 1000}), lss_supported=True)))


def test_the_product_s_csv_files() -> None:
    dictionary, _ = canopen_data.load_dictionary()
    compare_all(describe(dictionary))


@given(device_descriptions())
@examples(15)
def test_generated_descriptions(described: DeviceDescription) -> None:
    described = DeviceDescription(
        described.dictionary,
        described.kind,
        device_info=described.device_info,
        commissioning=described.commissioning,
        comments=described.comments,
    )
    assume(" ;" not in write_eds(described))  # it takes that for a comment
    compare_all(described)


def test_a_dcf_brings_node_id_and_bit_rate() -> None:
    text = write_eds(describe(drive_dictionary()), FileKind.DCF, node_id=NODE_ID)
    theirs = canopen.objectdictionary.eds.import_eds(io.StringIO(text), None)  # type: ignore[no-untyped-call]
    assert theirs.node_id == NODE_ID
    assert theirs[0x1800][1].default == 0x4000_0180 + NODE_ID


def test_dummies_and_a_real() -> None:
    pi = struct.unpack("<f", struct.pack("<f", 3.14159))[0]
    real = Variable(0x2000, 0, "pi", DataType.REAL32, Access.CONST, default=pi)
    described = describe(ObjectDictionary([Object.of("pi", [real])]))
    text = write_eds(DeviceDescription(described.dictionary, FileKind.EDS, dummies={index: index > 3 for index in range(1, 8)}))
    theirs = imported(text)
    assert theirs[0x2000].default == pi
    assert [index for index in range(1, 8) if index in theirs] == [4, 5, 6, 7]
