"""What is different between two descriptions: each field, whole objects, the device; and nothing where nothing is."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from canopen_data.description import Commissioning, FileKind, Module
from canopen_data.difference import Change, Relative, compare, shown
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, ObjectType
from tests.check.checked_device import OFFSET, clean, field, file, head, info, several, whole, with_variable, without
from tests.check.checked_device import Change as Edit


@pytest.mark.parametrize(
    "change",
    [
        head(comments=("other",), source="b.eds", kind=FileKind.XDD, optional=()),
        file(file_name="b.eds", creation_date="12-31-2020"),
        whole(0x2003, data_type=5),  # one of both does not say
        field(0x2001, 0, default=-5.0),
        several(),
    ],
)
def test_the_same_in_other_words_is_no_difference(change: Edit) -> None:
    assert compare(clean(), change(clean())) == []
    assert compare(change(clean()), clean()) == []


def test_a_value_that_is_no_number_equals_itself() -> None:
    nan = field(0x2001, 0, data_type=DataType.REAL32, default=math.nan)
    assert compare(nan(clean()), field(0x2001, 0, data_type=DataType.REAL32, default=float("nan"))(clean())) == []


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (without(0x2001), "2001 Offset: removed"),
        (with_variable(replace(OFFSET, index=0x2009, name="More")), "2009 More: added"),
        (whole(0x2003, object_type=ObjectType.RECORD), "2003 Table: ObjectType ARRAY -> RECORD"),
        (whole(0x2003, name="List"), "2003 Table: ParameterName 'Table' -> 'List'"),
        (field(0x2003, 2, name="Table:Last"), "2003:02 Table:Second: ParameterName 'Table:Second' -> 'Table:Last'"),
        (field(0x2000, 0, name="Amplification"), "2000:00 Gain: ParameterName 'Gain' -> 'Amplification'"),
        (field(0x2000, 0, data_type=DataType.INTEGER16), "2000:00 Gain: DataType UNSIGNED16 -> INTEGER16"),
        (field(0x2000, 0, access=Access.RO), "2000:00 Gain: AccessType rw -> ro"),
        (field(0x2000, 0, default=40), "2000:00 Gain: DefaultValue 5 -> 40 (0x28)"),
        (field(0x2000, 0, default=None), "2000:00 Gain: DefaultValue 5 -> -"),
        (field(0x2000, 0, adds_node_id=True), "2000:00 Gain: DefaultValue 5 -> $NODEID+0x5"),
        (field(0x2000, 0, configured=7), "2000:00 Gain: ParameterValue - -> 7"),
        (field(0x2000, 0, configured=7, configured_adds_node_id=True), "2000:00 Gain: ParameterValue - -> $NODEID+0x7"),
        (field(0x2000, 0, high_limit=-20), "2000:00 Gain: HighLimit 100 (0x64) -> -20"),
        (field(0x2000, 0, pdo_mappable=False), "2000:00 Gain: PDOMapping yes -> no"),
        (info(vendor_name="Emca"), "device: vendor_name 'Acme' -> 'Emca'"),
        (info(bit_rates=frozenset({500, 20})), "device: bit_rates 500 -> 20, 500"),
        (info(bit_rates=frozenset()), "device: bit_rates 500 -> none"),
        (head(commissioning=Commissioning(4)), "commissioning: added"),
        (head(modules=(Module(1),), dummies=clean().dummies), None),
    ],
)
def test_each_difference_is_told_once(change: Edit, text: str | None) -> None:
    (found,) = compare(clean(), change(clean()))
    if text is not None:
        assert str(found) == text


def test_sub_objects_come_and_go() -> None:
    table = clean().dictionary.objects[0x2003]
    shorter = whole(0x2003, variables={0: table.variables[0], 1: table.variables[1]})
    (gone,) = compare(clean(), shorter(clean()))
    assert (gone.change, gone.place, gone.name) == (Change.REMOVED, "2003:02", "Table:Second")
    (come,) = compare(shorter(clean()), clean())
    assert come.change is Change.ADDED


def test_a_renamed_record_is_one_difference() -> None:
    table = clean().dictionary.objects[0x2003]
    renamed = {each.subindex: replace(each, name=each.name.replace("Table", "List")) for each in table.variables.values()}
    changed = whole(0x2003, name="List", variables=renamed)
    assert [str(each) for each in compare(clean(), changed(clean()))] == ["2003 Table: ParameterName 'Table' -> 'List'"]
    renamed[2] = replace(renamed[2], name="List:Last")
    changed = whole(0x2003, name="List", variables=renamed)
    assert len(compare(clean(), changed(clean()))) == 4


def test_commissioning_is_compared_field_by_field() -> None:
    dcf = clean(FileKind.DCF)
    other = replace(dcf, commissioning=Commissioning(4, "axis", 500))
    assert [str(each) for each in compare(dcf, other)] == ["commissioning: node_id 3 -> 4"]
    (removed,) = compare(dcf, replace(dcf, commissioning=None))
    assert removed.change is Change.REMOVED


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (b"", "empty"),
        (b"\x01\xff", "01ff"),
        (1.5, "1.5"),
        (Relative(0x180), "$NODEID+0x180"),
        (Change.ADDED, "added"),
        (True, "yes"),
    ],
)
def test_values_are_shown_for_people(value: Any, text: str) -> None:
    assert shown(value) == text
