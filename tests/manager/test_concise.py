"""The concise DCF: bytes as CiA 302-3 lays them out, and bytes that are none."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Object, ObjectDictionary, Variable
from canopen_proto.dictionary import concise as module
from canopen_proto.dictionary.concise import ConciseError, from_concise, pack_concise
from canopen_proto.dictionary.download_order import download_order, settings_of
from tests.builds import replaces_what_is_compiled

HEARTBEAT = Variable(0x1017, 0, "producer heartbeat time", DataType.UNSIGNED16, configured=500)
NAME = Variable(0x2000, 0, "name", DataType.VISIBLE_STRING, configured="arm")
PLAIN = Variable(0x2001, 0, "plain", DataType.UNSIGNED8, default=3)
DICTIONARY = ObjectDictionary([Object.of(each.name, [each]) for each in (HEARTBEAT, NAME, PLAIN)])
LITERAL = "02000000 1710 00 02000000 F401 0020 00 03000000 61726D"


def test_as_the_standard_lays_it_out() -> None:
    data = bytes.fromhex(LITERAL)
    writes = download_order(DICTIONARY, settings_of(DICTIONARY, 5), 5).writes
    assert writes == ((0x1017, 0, b"\xf4\x01"), (0x2000, 0, b"arm"))
    assert pack_concise(writes) == data
    assert tuple(from_concise(data)) == writes


@pytest.mark.parametrize("data", [b"", bytes(4)])
def test_nothing_configures_nothing(data: bytes) -> None:
    assert from_concise(data) == []


@pytest.mark.parametrize(
    ("text", "offset", "message"),
    [
        ("0200", 0, "begins with a count of 4 bytes; only 2"),
        ("01000000", 4, "1 entries are announced, but the data end before entry 1"),
        ("FFFFFFFF 1710 00 02000000 F401", 13, "4294967295 entries are announced, but the data end before entry 2"),
        ("01000000 1710 00 FFFFFFFF F401", 11, r"entry 1 \(0x1017:00\) announces 4294967295 bytes; 2 are left"),
        ("01000000 1710 00 01000000 F401", 12, "1 more bytes follow the last of 1 entries"),
    ],
)
def test_other_bytes_are_refused_with_their_place(text: str, offset: int, message: str) -> None:
    with pytest.raises(ConciseError, match=message) as caught:
        from_concise(bytes.fromhex(text))
    assert caught.value.offset == offset


@replaces_what_is_compiled
def test_both_ways_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_CONCISE", 20)
    assert len(pack_concise([(0x2000, 0, bytes(9))])) == 20
    with pytest.raises(ConciseError, match="at most 20 bytes; entry 1"):
        pack_concise([(0x2000, 0, bytes(10))])
    with pytest.raises(ConciseError, match="at most 20 bytes, not 21"):
        from_concise(bytes(21))


@pytest.mark.parametrize("place", [(0x10000, 0), (-1, 0), (0x2000, 0x100), (0x2000, -1)])
def test_an_impossible_place_is_the_callers_fault(place: tuple[int, int]) -> None:
    with pytest.raises(ConciseError, match="entry 2: there is no object"):
        pack_concise([(0x2000, 0, b""), (*place, b"")])


@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFF), st.binary(max_size=20)), max_size=10))
def test_there_and_back(entries: list[tuple[int, int, bytes]]) -> None:
    assert from_concise(pack_concise(entries)) == entries


@given(st.binary(max_size=80))
def test_any_bytes_are_entries_or_refused(data: bytes) -> None:
    try:
        entries = from_concise(data)
    except ConciseError:
        return
    assert pack_concise(entries) == data or not data
