"""A COB-ID that a file gives no value is never 0, which is the CAN-ID of NMT: not in a device, not for its master."""

from __future__ import annotations

from types import MappingProxyType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto import LocalNode, ObjectDictionary
from canopen_proto.cob_id import cob_id_without_value
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Direction, Object, ObjectType, Variable
from canopen_proto.dictionary.standard import find_standard
from canopen_proto.frame import COB_ID_INVALID
from canopen_proto.machine import Outbox
from canopen_proto.nmt import NmtCommand
from canopen_proto.pdo.configure import InvalidPdoError, check_rpdo
from canopen_proto.pdo.settings import PdoSettings
from canopen_proto.pdo.slots import described_pdos, slots_of
from canopen_proto.remote_node import RemoteNode
from tests.examples import examples

PDOS = [*range(0x1400, 0x1404), 0x15FF, *range(0x1800, 0x1804), 0x19FF]


def record(index: int, *variables: Variable) -> Object:
    return Object(index, "record", ObjectType.RECORD, MappingProxyType({each.subindex: each for each in variables}))


def pdo(index: int, cob_id: int | None) -> list[Object]:
    """A PDO that carries one byte, and has this COB-ID."""
    number, word, byte = DataType.UNSIGNED32, DataType.UNSIGNED16, DataType.UNSIGNED8
    return [
        record(index, Variable(index, 1, "COB-ID", number, default=cob_id), Variable(index, 2, "type", byte, default=255)),
        record(
            index + 0x200,
            Variable(index + 0x200, 0, "count", byte, default=1),
            Variable(index + 0x200, 1, "first", number, default=0x20000008),
            Variable(index + 0x200, 2, "second", word),
        ),
    ]


def device_of(*objects: Object) -> ObjectDictionary:
    byte = Variable(0x2000, 0, "byte", DataType.UNSIGNED8, pdo_mappable=True)
    return ObjectDictionary([*objects, Object(0x2000, "byte", ObjectType.VAR, MappingProxyType({0: byte}))])


@given(
    st.sets(st.sampled_from(PDOS), min_size=1),
    st.sampled_from([None, 0, 0x40000000, 1, 0x7F, 0x701]),
    st.integers(1, 127),
)
@examples(200)
def test_a_pdo_without_a_cob_id_is_neither_sent_nor_received(indices: set[int], cob_id: int | None, node_id: int) -> None:
    dictionary = device_of(*(each for index in sorted(indices) for each in pdo(index, cob_id)))
    assert described_pdos(dictionary, node_id) == []
    if cob_id is None:
        assert not any(slot.pdo.is_valid for slot in slots_of(dictionary, node_id))
    node = LocalNode(Outbox(), node_id, dictionary)
    node.boot(0)
    node.execute(NmtCommand.START, 1)
    node.handle_timeout(10**10)
    sent = {frame.can_id for frame in node.out.frames}
    assert sent <= {0x700 + node_id, 0x80 + node_id}
    for index in indices:
        assert node.values.read((index, 1)) == (COB_ID_INVALID if cob_id is None else cob_id)


@given(st.integers(0x1000, 0x1FFF), st.integers(0, 255), st.integers(1, 127))
@examples(1000)
def test_without_a_value_a_cob_id_is_that_of_the_standard(index: int, subindex: int, node_id: int) -> None:
    known = find_standard(index, subindex)
    told = cob_id_without_value(index, subindex, node_id)
    if told is None:
        assert known is None or "cob_id" not in known.name or not subindex
        return
    assert known is not None
    assert told == known.default_of(node_id)
    assert Variable(index, subindex, "", DataType.UNSIGNED32).default_of(node_id) == told != 0


@pytest.mark.parametrize(("index", "subindex", "base"), [(0x1005, 0, 0x80), (0x1012, 0, 0x100), (0x1014, 0, None)])
def test_sync_time_and_emcy_without_a_value(index: int, subindex: int, base: int | None) -> None:
    variable = Variable(index, subindex, "COB-ID", DataType.UNSIGNED32)
    assert variable.default is None
    node = LocalNode(Outbox(), 5, device_of(Object(index, "", ObjectType.VAR, MappingProxyType({0: variable}))))
    assert node.values.read(index) == (0x85 if base is None else base)
    node.values.set_node_id(6)
    assert node.values.read(index) == (0x86 if base is None else base)


@pytest.mark.parametrize("cob_id", [0, 0x40000000, 0x7F, 0x605, 0x705, 0x800])
def test_no_rpdo_is_sent_on_a_can_id_of_another_service(cob_id: int) -> None:
    """Whatever a device says of itself: 0, above all, would be an NMT command."""
    node = RemoteNode(Outbox(), 5, ObjectDictionary([]))
    check_rpdo(node, PdoSettings(1, Direction.TPDO, cob_id, 1, ()))
    check_rpdo(node, PdoSettings(1, Direction.RPDO, 0x205, 1, ()))
    with pytest.raises(InvalidPdoError, match=f"COB-ID 0x{cob_id:X} has a CAN-ID that no PDO may have; nothing is sent there"):
        check_rpdo(node, PdoSettings(1, Direction.RPDO, cob_id, 1, ()))
