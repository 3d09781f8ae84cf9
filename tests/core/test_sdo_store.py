"""The store over a dictionary and its values: each rule and its abort code (CiA 301 v4.2.0, 7.2.4.3.17, table 22)."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary.model import Access, Object, ObjectDictionary, Variable
from canopen_proto.dictionary.values import Values
from canopen_proto.sdo.server import ObjectStore
from canopen_proto.sdo.store import ValuesStore

DICTIONARY = ObjectDictionary(
    [
        Object.of("device_type", [Variable(0x1000, 0, "device_type", DataType.UNSIGNED32, Access.CONST, 0x192)]),
        Object.of("name", [Variable(0x1008, 0, "name", DataType.VISIBLE_STRING, Access.RO, "arm")]),
        Object.of("mode", [Variable(0x6060, 0, "mode", DataType.INTEGER8, low_limit=-1, high_limit=10)]),
        Object.of("gain", [Variable(0x2000, 0, "gain", DataType.REAL32, low_limit=0.0)]),
        Object.of("key", [Variable(0x2001, 0, "key", DataType.UNSIGNED16, Access.WO)]),
        Object.of("text", [Variable(0x2002, 0, "text", DataType.UNICODE_STRING)]),
        Object.of("at", [Variable(0x2003, 0, "at", DataType.TIME_OF_DAY)]),
        Object.of("blob", [Variable(0x2004, 0, "blob", DataType.DOMAIN)]),
        Object.of("switch", [Variable(0x2005, 0, "switch", DataType.BOOLEAN, Access.RWW)]),
        Object.of("far", [Variable(0x2006, 0, "far", DataType.INTEGER24, Access.RWR, high_limit=100)]),
    ]
)


@pytest.fixture
def store() -> ValuesStore:
    return ValuesStore(Values(DICTIONARY, 12))


@pytest.mark.parametrize(
    ("index", "subindex", "answer"),
    [
        (0x1000, 0, b"\x92\x01\x00\x00"),
        (0x1008, 0, b"arm"),
        (0x2002, 0, b""),
        (0x1001, 0, AbortCode.NO_SUCH_OBJECT),
        (0x1000, 1, AbortCode.NO_SUCH_SUBINDEX),
        (0x2001, 0, AbortCode.WRITE_ONLY),
    ],
)
def test_read(store: ValuesStore, index: int, subindex: int, answer: bytes | AbortCode) -> None:
    assert store.read(index, subindex, 0) == answer


@pytest.mark.parametrize(
    ("index", "subindex", "size", "answer"),
    [
        (0x1001, 0, None, AbortCode.NO_SUCH_OBJECT),
        (0x1000, 1, None, AbortCode.NO_SUCH_SUBINDEX),
        (0x1000, 0, 4, AbortCode.READ_ONLY),
        (0x1008, 0, None, AbortCode.READ_ONLY),
        (0x2001, 0, None, None),
        (0x2001, 0, 2, None),
        (0x2001, 0, 4, AbortCode.LENGTH_TOO_HIGH),
        (0x2001, 0, 1, AbortCode.LENGTH_TOO_LOW),
        (0x2001, 0, 0, AbortCode.LENGTH_TOO_LOW),
        (0x2002, 0, 6, None),
        (0x2002, 0, 5, AbortCode.LENGTH_MISMATCH),
        (0x2004, 0, 5_000_000, None),
        (0x2005, 0, 1, None),
        (0x2006, 0, 3, None),
    ],
)
def test_check_write(store: ValuesStore, index: int, subindex: int, size: int | None, answer: AbortCode | None) -> None:
    assert store.check_write(index, subindex, size) == answer
    if size is not None:
        before = dict(store.values.store)
        assert store.write(index, subindex, bytes(size), 0) == answer  # zero is within all limits
        assert answer is None or store.values.store == before


@pytest.mark.parametrize(
    ("index", "data", "answer"),
    [
        (0x6060, "0A", 10),
        (0x6060, "0B", AbortCode.VALUE_TOO_HIGH),
        (0x6060, "FF", -1),
        (0x6060, "FE", AbortCode.VALUE_TOO_LOW),
        (0x2000, "0000C03F", 1.5),
        (0x2000, "0000C0BF", AbortCode.VALUE_TOO_LOW),
        (0x2000, "0000C07F", AbortCode.INVALID_VALUE),  # NaN
        (0x2003, "00 5C 26 05 00 00", AbortCode.INVALID_VALUE),  # a millisecond more than a day has
        (0x2004, "00FF", b"\x00\xff"),
        (0x2006, "650000", AbortCode.VALUE_TOO_HIGH),
        (0x2006, "000080", -0x800000),
    ],
)
def test_write(store: ValuesStore, index: int, data: str, answer: Value | AbortCode) -> None:
    before = dict(store.values.store)
    refusal = store.write(index, 0, bytes.fromhex(data), 0)
    if isinstance(answer, AbortCode):
        assert refusal is answer
        assert store.values.store == before
    else:
        assert refusal is None
        assert store.values[index << 8] == answer


def test_its_steps_stand_apart_for_devices_with_effects(store: ValuesStore) -> None:
    variable = store.writable(0x6060, 0)
    assert isinstance(variable, Variable)
    assert store.decode(variable, b"\x06") == 6
    assert store.decode(variable, b"\x0b") is AbortCode.VALUE_TOO_HIGH
    assert store.decode(variable, b"\x06\x00") is AbortCode.LENGTH_TOO_HIGH
    assert store.check(variable, 6) is None
    assert store.writable(0x1000, 0) is AbortCode.READ_ONLY
    assert store.readable(0x2001, 0) is AbortCode.WRITE_ONLY
    assert store.readable(0x1000, 0) is DICTIONARY.get(0x1000)
    text = store.writable(0x2002, 0)
    assert isinstance(text, Variable)
    assert store.check(text, "any") is None


def test_a_value_that_the_device_itself_got_wrong_is_an_abort_and_no_error(store: ValuesStore) -> None:
    store.values.store[0x1000 << 8] = -1
    assert store.read(0x1000, 0, 0) is AbortCode.INTERNAL_INCOMPATIBILITY


def test_it_is_an_object_store(store: ValuesStore) -> None:
    served: ObjectStore = store
    assert served.read(0x1008, 0, 0) == b"arm"
