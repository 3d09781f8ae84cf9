"""Objects of a device that only its host can serve (ObjectAccessPending, complete)."""

from __future__ import annotations

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.sdo.server import ObjectAccessPending, ObjectWritten
from tests.core.device_bench import RESET_NODE, DeviceBench
from tests.core.devices import TEXT, io_device


def with_object(dictionary: ObjectDictionary, index: int, data_type: DataType, access: Access) -> ObjectDictionary:
    variable = Variable(index, 0, f"object_{index:04x}", data_type, access)
    return dictionary.with_objects([Object.of(variable.name, [variable])])


def test_objects_that_only_the_host_can_serve() -> None:
    dictionary = with_object(io_device(), 0x1010, DataType.UNSIGNED32, Access.RW)
    bench = DeviceBench(dictionary)
    bench.node.deferred.add(0x1010)

    assert bench.tell("605#4010100000000000") == []
    (access,) = bench.seen(ObjectAccessPending)
    assert (access.node_id, access.index, access.subindex, access.data) == (5, 0x1010, 0, None)
    bench.node.complete(access.access_id, b"\x01\x00\x00\x00", bench.now)
    assert bench.take() == ["585#4310100001000000"]

    assert bench.tell("605#2310100073617665") == []
    (access,) = bench.seen(ObjectAccessPending)
    assert access.data == b"save"
    bench.node.complete(access.access_id, None, bench.now)
    assert bench.take() == ["585#6010100000000000"]
    assert [(event.index, event.subindex) for event in bench.seen(ObjectWritten)] == [(0x1010, 0)]

    bench.tell("605#2310100073617665")
    (access,) = bench.seen(ObjectAccessPending)
    bench.node.complete(access.access_id, AbortCode.HARDWARE_ERROR, bench.now)
    assert bench.take() == ["585#8010100000000606"]

    bench.tell("605#2310100073617665")
    assert bench.wait(6000) == ["5000 585#8010100020000008"]
    bench.node.complete(access.access_id, None, bench.now)  # too late: no fault, no frame
    assert bench.take() == []


def test_a_deferred_object_keeps_its_access_right_and_length() -> None:
    dictionary = with_object(io_device(), 0x2100, DataType.UNSIGNED32, Access.WO)
    bench = DeviceBench(with_object(dictionary, 0x2101, DataType.UNSIGNED32, Access.RO))
    bench.node.deferred |= {0x2100, 0x2101}
    assert bench.read(0x2100) == AbortCode.WRITE_ONLY
    assert bench.write(0x2101, 0, 1, 4) == AbortCode.READ_ONLY
    assert bench.write(0x2100, 0, 1, 2) == AbortCode.LENGTH_TOO_LOW
    assert bench.seen(ObjectAccessPending) == []


def test_a_host_that_answers_after_a_reset_answers_nobody() -> None:
    bench = DeviceBench()
    bench.node.deferred.add(TEXT)
    bench.tell("605#4003200000000000")
    (access,) = bench.seen(ObjectAccessPending)
    assert bench.tell(RESET_NODE) == ["705#00"]
    bench.node.complete(access.access_id, b"late", bench.now)
    assert bench.take() == []
    assert bench.wait(10_000) == []
