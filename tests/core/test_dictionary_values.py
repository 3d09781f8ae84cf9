"""Values: one device's memory over a shared description."""

from __future__ import annotations

import pytest

from canopen_proto.datatypes import DataType, ValueRangeError
from canopen_proto.dictionary import (
    Access,
    Constant,
    ConstantNotFoundError,
    Object,
    ObjectDictionary,
    ObjectNotFoundError,
    Values,
    Variable,
)

VARIABLES = [
    Variable(0x0000, 0, "NMT", DataType.UNSIGNED8, Access.WO),
    Variable(0x1008, 0, "name", DataType.VISIBLE_STRING, Access.CONST, "drive"),
    Variable(0x1014, 0, "cob_id_emergency", DataType.UNSIGNED32, default=0x80, adds_node_id=True),
    Variable(0x1017, 0, "producer_heartbeat_time", DataType.UNSIGNED16, default=100),
    Variable(0x6040, 0, "controlword", DataType.UNSIGNED16),
    Variable(0x607A, 0, "target_position", DataType.INTEGER32, low_limit=-1000, high_limit=1000),
]
DICTIONARY = ObjectDictionary(
    [Object.of(each.name, [each]) for each in VARIABLES], constants={0x604000: [Constant("sm_shutdown", 0xFFFF, 6)]}
)


def test_it_starts_with_the_defaults_of_its_node() -> None:
    values = Values(DICTIONARY, node_id=12)
    assert values.read("cob_id_emergency") == 0x8C
    assert values.read(0x1008) == "drive"
    assert values.read("controlword") == 0
    assert values.raw(0x1014) == bytes.fromhex("8C000000")
    assert set(values.store) == {variable.mux for variable in DICTIONARY}
    assert Values(DICTIONARY).read("cob_id_emergency") == 0x80


def test_what_has_no_default_begins_within_its_limits() -> None:
    """Many an EDS has limits and no default; a device that refuses the value that it has itself would be odd."""
    silent = [
        Variable(0x2000, 0, "above", DataType.UNSIGNED8, low_limit=2, high_limit=10),
        Variable(0x2001, 0, "below", DataType.INTEGER16, low_limit=-10, high_limit=-2),
        Variable(0x2002, 0, "around", DataType.REAL32, low_limit=-0.5, high_limit=0.5),
        Variable(0x2003, 0, "said", DataType.UNSIGNED8, default=0, low_limit=2),
        Variable(0x2004, 0, "beyond its type", DataType.UNSIGNED8, low_limit=300),
        Variable(0x2005, 0, "text", DataType.VISIBLE_STRING, low_limit=2),
        Variable(0x2006, 0, "none", DataType.UNSIGNED8, low_limit=9, high_limit=8),
    ]
    values = Values(ObjectDictionary([Object.of(each.name, [each]) for each in silent]))
    assert list(values.store.values()) == [2, -2, 0.0, 0, 0, "", 0]


def test_six_drives_of_one_description_share_nothing() -> None:
    drives = [Values(DICTIONARY, node_id) for node_id in range(3, 9)]
    drives[0].write("target_position", 5)
    assert [drive.read("target_position") for drive in drives] == [5, 0, 0, 0, 0, 0]


def test_writing_by_constant_and_by_value() -> None:
    values = Values(DICTIONARY)
    values.write("controlword", "sm_shutdown")
    assert values.read(0x6040) == 6
    values.write((0x607A, 0), -1000)
    assert values.raw(0x607A) == bytes.fromhex("18FCFFFF")
    values.write("name", "sm_shutdown")  # an object that holds text
    assert values.read("name") == "sm_shutdown"


def test_a_refused_write_changes_nothing() -> None:
    values = Values(DICTIONARY)
    before = dict(values.store)
    with pytest.raises(ValueRangeError, match=r"target_position \(0x607A:00\): 1001 is outside -1000\.\.1000"):
        values.write("target_position", 1001)
    with pytest.raises(ValueRangeError, match=r"controlword \(0x6040:00\): 65536 is outside 0\.\.65535"):
        values.write("controlword", 0x10000)
    with pytest.raises(ConstantNotFoundError):
        values.write("controlword", "sm_start")
    with pytest.raises(ObjectNotFoundError):
        values.write("status", 0)
    assert values.store == before


def test_unchecked_access_by_mux() -> None:
    values = Values(DICTIONARY)
    values[0x607A00] = 5000
    assert values[0x607A00] == 5000 == values.read("target_position")
    with pytest.raises(ObjectNotFoundError, match="object 0x6041:00 is not in the dictionary"):
        values[0x604100] = 1
    with pytest.raises(KeyError):
        values[0x604100]


def test_a_pseudo_object_is_no_memory() -> None:
    values = Values(DICTIONARY)
    for access in (lambda: values.read("NMT"), lambda: values.write("NMT", 1)):
        with pytest.raises(ObjectNotFoundError, match=r"NMT \(0x0000:00\) is no object of this device"):
            access()
    with pytest.raises(ObjectNotFoundError, match="0x6099:01"):
        values.raw(0x6099, 1)


def test_reset_of_the_communication_area_leaves_the_rest() -> None:
    values = Values(DICTIONARY, 12)
    values.write("producer_heartbeat_time", 5)
    values.write("cob_id_emergency", 0x700)
    values.write("target_position", 77)
    values.reset(0x1000, 0x1FFF)
    assert [values.read(key) for key in ("producer_heartbeat_time", "cob_id_emergency", "target_position")] == [100, 0x8C, 77]
    values.reset()
    assert values.read("target_position") == 0


def test_a_value_that_does_not_fit_its_type_is_zero() -> None:
    """An EDS says what it likes, and a node-ID may carry a value over the edge."""
    odd = [
        Variable(0x2000, 0, "sum", DataType.UNSIGNED8, default=0xFF, adds_node_id=True),
        Variable(0x2001, 0, "text", DataType.VISIBLE_STRING, default=5),
        Variable(0x2002, 0, "right", DataType.INTEGER8, default=-1),
    ]
    values = Values(ObjectDictionary([Object.of(each.name, [each]) for each in odd]), node_id=1)
    assert [values.raw(index) for index in (0x2000, 0x2001, 0x2002)] == [b"\x00", b"", b"\xff"]
    assert [variable.name for variable in values.unfit] == ["sum", "text"]
    values.store[0x200000] = values.store[0x200200] = 7
    values.reset(0x2000, 0x2001)
    assert (values[0x200000], values[0x200200]) == (0, 7)
    assert len(values.unfit) == 2
