"""Reading all that a node holds: what comes of each object, and of a device that falls silent."""

from __future__ import annotations

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType, Value
from canopen_proto.dictionary import Access, Object, ObjectDictionary, Variable
from canopen_proto.frame import Frame
from canopen_proto.machine import LocalProtocolError, Time
from canopen_proto.manager.parameters.backup import MAX_SILENT, Backup, ObjectRead, ReadResult, back_up, same_value
from canopen_proto.manager.parameters.walk import MAX_OBJECTS, WalkProgress, back_up_by_names, walk
from canopen_proto.procedures.steps import SdoTransferError
from tests.core.devices import TEXT
from tests.manager.restore_bench import FACTORY, GAIN, HIDDEN, IMAGE, SECRET, Bench, device


def results(backup: Backup) -> dict[int, ReadResult]:
    return {each.variable.mux: each.result for each in backup.readings}


def test_each_object_is_read_or_told_why_not() -> None:
    bench = Bench()
    bench.device.values.store[GAIN << 8] = 2.5
    backup = bench.run(back_up(bench.remote))
    found = results(backup)
    assert list(found) == [each.mux for each in bench.dictionary]
    not_read = {key: result for key, result in found.items() if result is not ReadResult.READ}
    assert not_read == {
        SECRET << 8: ReadResult.WRITE_ONLY,
        IMAGE << 8: ReadResult.DOMAIN,
        HIDDEN << 8: ReadResult.KEPT_OUT,
        **dict.fromkeys((0x1003_01, 0x1003_02, 0x1003_03), ReadResult.ABSENT),  # the history is empty
    }
    assert backup.is_complete
    assert backup.counts[ReadResult.ABSENT] == 3
    assert backup.values == {key: bench.device.values.store[key] for key in found if key not in not_read}
    assert backup.values[GAIN << 8] == 2.5
    assert backup.values[TEXT << 8] == "an I/O device with a long name"
    assert not any(line.startswith("000#") for line in bench.bus.trace())
    assert bench.device.writes == []


def test_a_control_word_that_somebody_else_has_written_does_not_become_ours() -> None:
    words = [Object.of("word", [Variable(index, 0, "word", DataType.UNSIGNED16, default=0)]) for index in (0x6040, 0x6060)]
    bench = Bench(device(0, *words))
    bench.remote.commanded.add(0x604000)
    for index in (0x6040, 0x6060):
        bench.device.values.store[index << 8] = 0x0F
    backup = bench.run(back_up(bench.remote))
    assert backup.values[0x604000] == 0x0F
    assert [bench.remote.values.store[index << 8] for index in (0x6040, 0x6060)] == [0, 0x0F]


def test_domains_are_read_on_request_and_progress_is_told() -> None:
    bench = Bench()
    only = [bench.dictionary.variable(index) for index in (IMAGE, FACTORY, SECRET)]
    backup = bench.run(back_up(bench.remote, only=only, domains=True))
    assert backup.values == {IMAGE << 8: b"firmware", FACTORY << 8: 3}
    assert bench.bus.take_events(ObjectRead) == [
        ObjectRead(5, IMAGE, 0, ReadResult.READ, 1, 3),
        ObjectRead(5, FACTORY, 0, ReadResult.READ, 2, 3),
        ObjectRead(5, SECRET, 0, ReadResult.WRITE_ONLY, 3, 3),
    ]


def test_a_device_that_is_not_what_its_dictionary_says() -> None:
    def own(index: int, data_type: DataType) -> Object:
        return Object.of("own", [Variable(index, 0, "own", data_type)])

    real = device(0, own(0x2200, DataType.UNSIGNED16), own(0x2203, DataType.UNSIGNED8))
    described = device(
        0,
        own(0x2200, DataType.UNSIGNED32),
        own(0x2201, DataType.UNSIGNED8),
        Object.of("wo", [Variable(SECRET, 0, "wo", DataType.UNSIGNED16)]),
        own(0x2203, DataType.UNSIGNED8),
    )
    bench = Bench(real)
    reads = bench.device.read
    bench.device.read = lambda index, sub, now: (  # type: ignore[method-assign]
        AbortCode.DEVICE_STATE if index == 0x2203 else reads(index, sub, now)
    )
    backup = bench.run(back_up(bench.remote, described))
    found = {each.variable.index: each for each in backup.readings}
    assert found[0x2200].result is ReadResult.WRONG_LENGTH
    assert found[0x2200].data == b"\0\0"
    assert found[0x2200].value is None
    assert found[0x2201].result is ReadResult.ABSENT
    assert found[SECRET].result is ReadResult.WRITE_ONLY
    assert (found[0x2203].result, found[0x2203].abort_code) == (ReadResult.REFUSED, AbortCode.DEVICE_STATE)
    assert not backup.is_complete
    assert 0x2200_00 not in backup.values


def test_a_node_that_is_not_there() -> None:
    bench = Bench()
    bench.bus.detach(bench.network)
    with pytest.raises(SdoTransferError, match="node 5 did not answer reading 0x1000:00"):
        bench.run(back_up(bench.remote))


@pytest.mark.parametrize("gone_after", [1, 2, 30])
def test_a_node_that_goes_away_is_noticed_soon(gone_after: int) -> None:
    bench = Bench()

    def read(index: int, subindex: int, now: Time) -> bytes | AbortCode:
        count[0] += 1
        if count[0] > gone_after:
            bench.bus.detach(bench.network)
        result = reads(index, subindex, now)
        assert isinstance(result, bytes | AbortCode)
        return result

    count, reads = [0], bench.device.read
    bench.device.read = read  # type: ignore[method-assign]
    with pytest.raises(SdoTransferError, match="did not answer"):
        bench.run(back_up(bench.remote))
    asked = [each for each in bench.bus.take_events(ObjectRead) if each.result is ReadResult.NO_ANSWER]
    assert len(asked) == MAX_SILENT - 1


def test_one_object_without_an_answer_does_not_end_a_backup() -> None:
    bench = Bench()
    index = 0x1A01
    bench.device.takes = lambda frame: frame.data[1:3] != index.to_bytes(2, "little")
    backup = bench.run(back_up(bench.remote, only=[each for each in bench.dictionary if each.subindex == 0]))
    assert [key for key, result in results(backup).items() if result is ReadResult.NO_ANSWER] == [index << 8]
    assert not backup.is_complete


@pytest.mark.parametrize("code", [None, AbortCode.TIMED_OUT, AbortCode.INVALID_COMMAND, AbortCode.TOGGLE_NOT_ALTERNATED])
def test_a_read_that_broke_is_repeated_once(code: AbortCode | None) -> None:
    """Each object gets no answer, or a stray abort, at first; nothing is missing in the end."""
    bench = Bench()
    whole = bench.run(back_up(bench.remote, domains=True)).values
    broken: set[tuple[int, int]] = set()

    def takes(frame: Frame) -> bool:
        place = int.from_bytes(frame.data[1:3], "little"), frame.data[3] if len(frame.data) > 3 else 0
        if frame.can_id != 0x605 or frame.data[0] & 0xE3 not in (0x40, 0xA0) or place in broken:
            return True
        broken.add(place)
        if code is not None:
            bench.network.out.frames.append(Frame(0x585, bytes((0x80, *frame.data[1:4])) + code.to_bytes(4, "little")))
        return False

    bench.device.takes = takes
    again = bench.run(back_up(bench.remote, domains=True))
    assert again.is_complete
    assert again.values == whole
    assert len(broken) == len([each for each in again.readings if each.result in (ReadResult.READ, ReadResult.ABSENT)])


def test_what_the_device_says_of_an_object_is_asked_for_once() -> None:
    bench = Bench()
    asked: list[int] = []

    def read(index: int, subindex: int, now: Time) -> AbortCode:
        asked.append(index)
        return AbortCode.DEVICE_STATE

    bench.device.read = read  # type: ignore[method-assign]
    backup = bench.run(back_up(bench.remote, only=[bench.dictionary.variable(index) for index in (GAIN, TEXT)]))
    assert asked == [GAIN, TEXT]
    assert set(results(backup).values()) == {ReadResult.REFUSED}


def test_a_reset_meanwhile_ends_a_backup() -> None:
    bench = Bench()
    bench.start(back_up(bench.remote))
    bench.bus.run(5_000_000)
    bench.bus.send("705#00")
    with pytest.raises(SdoTransferError, match="was given up: 0x060A0023"):
        raise bench.outcome().error  # type: ignore[attr-defined]


# ---- without a dictionary ----


def test_a_walk_finds_what_can_be_read() -> None:
    bench = Bench(known=ObjectDictionary([]))
    ranges = [range(0x1000, 0x1030), range(0x1400, 0x1402), range(0x1A00, 0x1A03), range(0x2000, 0x2020), [0x2100]]
    backup = bench.run(walk(bench.remote, ranges))
    truth = bench.run(back_up(bench.remote, bench.dictionary, domains=True))
    expected = {each.variable.mux: each.data for each in truth.readings if each.data is not None}
    expected[HIDDEN << 8] = b"\0"  # a walk knows nothing of flags
    unused = {0x1A00_02, 0x1A01_02, 0x1A02_02}  # beyond the number of mapped objects, which is their subindex 0
    found = {each.variable.mux: each.data for each in backup.readings if each.data is not None}
    asked = {index for each in ranges for index in each}
    assert found == {key: data for key, data in expected.items() if key >> 8 in asked and key not in unused}
    by_name = backup.dictionary
    assert by_name.variable("producer_heartbeat_time").mux == 0x1017_00
    assert by_name.variable("tpdo1_mapping_parameter:object_1").data_type is DataType.UNSIGNED32
    assert by_name.variable((0x2100, 2)).name == "object_2100:02"
    assert by_name.variable(0x2001).data_type is DataType.UNSIGNED16  # it is an INTEGER16, which nobody can see
    assert by_name.variable(TEXT).data_type is DataType.OCTET_STRING
    assert backup.values[TEXT << 8] == b"an I/O device with a long name"
    assert results(backup)[SECRET << 8] is ReadResult.WRITE_ONLY
    steps = bench.bus.take_events(WalkProgress)
    assert [(each.done, each.total) for each in steps] == [(0, 86), (64, 86)]
    assert 0 < steps[-1].found <= len(backup.readings)


def test_a_node_without_a_file_is_walked_where_its_pdos_are() -> None:
    names = ObjectDictionary(
        [
            Object.of("my_heartbeat", [Variable(0x1017, 0, "my_heartbeat", DataType.UNSIGNED16)]),
            Object.of("gain", [Variable(GAIN, 0, "gain", DataType.REAL32)]),
            Object.of("image", [Variable(IMAGE, 0, "image", DataType.DOMAIN)]),
            Object.of("not there", [Variable(0x5000, 0, "not there", DataType.UNSIGNED8)]),
        ]
    )
    bench = Bench()
    backup = bench.run(back_up_by_names(bench.remote, names))
    truth = bench.run(back_up(bench.remote, bench.dictionary))
    found = {each.variable.mux: each.data for each in backup.readings if each.data is not None}
    communication = {each.variable.mux: each.data for each in truth.readings if each.variable.index < 0x2000 and each.data}
    counts = {key: data[0] for key, data in communication.items() if key >> 16 in (0x16, 0x1A) and not key & 0xFF}
    used = {key: data for key, data in communication.items() if (key & 0xFF) <= max(1, counts.get(key & ~0xFF, 0xFF))}
    assert found == used | {GAIN << 8: b"\0\0\xc0\x3f"}
    assert backup.dictionary.variable("my_heartbeat").mux == 0x1017_00
    assert backup.values[GAIN << 8] == 1.5
    assert results(backup)[IMAGE << 8] is ReadResult.DOMAIN
    assert results(backup)[0x5000_00] is ReadResult.ABSENT


def test_a_walk_believes_the_standard_only_where_the_length_agrees() -> None:
    odd = ObjectDictionary(
        [
            Object.of("type", [Variable(0x1000, 0, "type", DataType.UNSIGNED16, Access.RO, 7)]),
            Object.of("byte", [Variable(0x2000, 0, "byte", DataType.UNSIGNED8, Access.RO, 9)]),
            Object.of("list", [Variable(0x2001, each, f"{each}", DataType.UNSIGNED8, default=200) for each in (0, 1, 3)]),
        ]
    )
    bench = Bench(odd, start=False)
    backup = bench.run(walk(bench.remote, [[0x2001, 0x1000], range(0x2000, 0x2001)]))
    assert {each.variable.mux: each.value for each in backup.readings} == {
        0x1000_00: 7,
        0x2000_00: 9,
        0x2001_00: 200,
        0x2001_01: 200,
        0x2001_03: 200,
    }
    assert backup.dictionary.variable(0x1000).data_type is DataType.UNSIGNED16


def test_a_walk_is_bounded() -> None:
    bench = Bench(start=False)
    with pytest.raises(LocalProtocolError, match="indices are"):
        bench.run(walk(bench.remote, [range(0x20000)]))
    assert bench.run(walk(bench.remote, [])).readings == []
    assert MAX_OBJECTS < 1 << 20


def test_a_device_that_has_everything_ends_a_walk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("canopen_proto.manager.parameters.walk.MAX_OBJECTS", 300)
    bench = Bench(start=False)
    bench.device.read = lambda index, sub, now: b"\xff"  # type: ignore[method-assign]
    backup = bench.run(walk(bench.remote, [range(0x1000, 0x2000)]))
    assert len(backup.readings) == 2 * 255  # whole objects: two of 0..0xFE


def test_a_record_of_write_only_fields_and_refused_counts() -> None:
    bench = Bench(start=False)
    answers = {
        (0x2000, 0): AbortCode.GENERAL_ERROR,
        (0x2000, 1): b"\x01",
        (0x2001, 0): b"\x02",
        (0x2001, 1): AbortCode.WRITE_ONLY,
    }
    bench.device.read = lambda index, sub, now: answers.get((index, sub), AbortCode.NO_SUCH_SUBINDEX)  # type: ignore[method-assign]
    backup = bench.run(walk(bench.remote, [range(0x2000, 0x2002)]))
    assert list(results(backup).values()) == [ReadResult.REFUSED, ReadResult.READ, ReadResult.READ, ReadResult.WRITE_ONLY]


def test_what_counts_as_the_same_value() -> None:
    def same(data_type: DataType, one: Value | None, other: Value | None) -> bool:
        return same_value(Variable(0x2000, 0, "own", data_type), one, other)

    assert not same(DataType.VISIBLE_STRING, "name\0\0", "name")
    assert not same(DataType.VISIBLE_STRING, "name", "other")
    assert same(DataType.REAL64, float("nan"), float("nan"))
    assert same(DataType.REAL32, 5.2, 5.199999809265137)
    assert not same(DataType.REAL64, 5.2, 5.199999809265137)
    assert same(DataType.BOOLEAN, 1, True)
    assert not same(DataType.UNSIGNED8, None, 0)
    assert same(DataType.UNSIGNED8, None, None)
    assert not same(DataType.UNSIGNED8, 300, "text")


def test_a_backup_that_met_another_client_is_right_and_not_complete() -> None:
    bench = Bench()
    bench.bus.send(f"{0x600 + bench.remote.node_id:03X}#4018100100000000")
    backup = bench.run(back_up(bench.remote))
    assert backup.others_doing == "asked for 0x1018:01"
    assert not backup.is_complete
    assert all(each.value is not None for each in backup.readings if each.result is ReadResult.READ)
    assert backup.values == bench.run(back_up(bench.remote)).values


def test_small_values_are_asked_for_so_that_their_answer_names_the_object() -> None:
    """An upload in blocks, or of segments, may be confused with another client's; one frame may not."""
    bench = Bench()
    bench.run(back_up_by_names(bench.remote, bench.dictionary))
    asked = {frame[4:6] for frame in bench.bus.trace() if frame.startswith(f"{0x600 + bench.remote.node_id:03X}#")}
    assert asked == {"40", "60", "70"}
