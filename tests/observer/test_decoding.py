"""What frames mean, in words; SDO transfers overheard."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.datatypes import DataType
from canopen_proto.dictionary import Constant, Direction, Filler, ObjectDictionary, PdoDescription, Variable
from canopen_proto.dictionary.objects import Object, ObjectType
from canopen_proto.frame import EXTENDED, Frame, routing_key
from canopen_proto.observer.meaning import ShownObject, bytes_text
from canopen_proto.observer.observer import Observer
from canopen_proto.observer.parameters import ObservedParameters
from canopen_proto.observer.pdo import ObservedPdos
from canopen_testing.strategies import frames, near_valid_frames, random_frames
from tests.examples import examples
from tests.interop.recorded import FOLDER, needs_recordings


def obj(index: int, *values: tuple[DataType, int], name: str = "") -> Object:
    """An object with these entries, or with one of that name."""
    variables = [Variable(index, sub, name, kind, default=value) for sub, (kind, value) in enumerate(values)]
    kind = ObjectType.VAR if name else ObjectType.RECORD
    return Object(index, name, kind, {each.subindex: each for each in variables})


U8, U16, U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
DICTIONARY = ObjectDictionary(
    [
        Object(0x1008, "name", ObjectType.VAR, {0: Variable(0x1008, 0, "name", DataType.VISIBLE_STRING)}),
        Object(0x2000, "blob", ObjectType.VAR, {0: Variable(0x2000, 0, "blob", DataType.DOMAIN)}),
        obj(0x6041, (U16, 0), name="statusword"),
        obj(0x6064, (DataType.INTEGER32, 0), name="position"),
        obj(0x1800, (U8, 2), (U32, 0x185), (U8, 1)),
        obj(0x1A00, (U8, 2), (U32, 0x6041_0010), (U32, 0x6064_0020)),
        obj(0x1400, (U8, 2), (U32, 0x205), (U8, 1)),
        obj(0x1600, (U8, 1), (U32, 0x6041_0010)),
    ],
    constants={0x604100: [Constant("ready", 0x6F, 0x6F)]},
)


def meanings(*frames: str, of: int | None = 5) -> list[str]:
    observer = Observer(lambda node_id: DICTIONARY if node_id == of else None)
    made = [observer.observe(Frame.parse(frame), 0).meaning for frame in frames]
    return [f"{each.service} {each.node_id} {each.text}".rstrip() for each in made]


@pytest.mark.parametrize(
    ("frame", "meaning"),
    [
        ("000#0105", "NMT 5 start: node 5"),
        ("000#8000", "NMT 0 enter pre-operational: all nodes"),
        ("000#77FF", "NMT 0 unknown command 0x77: node-ID 255, which no node can have"),
        ("000#01", "NMT 0 too short: 01"),
        ("080#", "SYNC 0"),
        ("080#07", "SYNC 0 counter 7"),
        ("085#3032054200000000", "EMCY 5 0x3230 "),
        ("085#0000000000000000", "EMCY 5 0x0000 "),
        ("085#00", "EMCY 5 too short: 00"),
        ("100#000000000000", "TIME 0 1984-01-01 00:00:00+00:00"),
        ("100#00", "TIME 0 not a time: 00"),
        ("705#00", "boot-up 5"),
        ("705#05", "heartbeat 5 operational"),
        ("705#85", "guarding 5 operational"),
        ("705#42", "heartbeat 5 unknown state 0x42"),
        ("705#", "heartbeat 5 of a wrong length: no data"),
        ("705#R1", "guarding 5 the master asks for the state"),
        ("185#6F0039300000", "TPDO 1 5 statusword = 111 (ready), position = 12345 (0x3039)"),
        ("185#6F", "TPDO 1 5 shorter than its mapping of 6 bytes: 6f"),
        (
            "185#6F003930000007",
            "TPDO 1 5 statusword = 111 (ready), position = 12345 (0x3039), longer than its mapping of 6 bytes: 07 left over",
        ),
        ("185#R", "TPDO 1 5 requested by a remote frame"),
        ("205#0000", "RPDO 1 5 statusword = 0"),
        ("285#AABB", "TPDO 2 5 aa bb"),
        ("506#AABB", "RPDO 4 6 aa bb"),
        ("286#R", "TPDO 2 6 requested by a remote frame"),
        ("606#R8", "? 0 a remote frame, 8 bytes"),
        ("7E5#0401000000000000", "LSS 0 all slaves: configuration"),
        ("7E4#0401", "LSS 0 slave: 04 01"),
        ("7E0#0401", "? 0 04 01"),
        ("071#0005", "NMT master 0 node 5 is the active master, priority 0"),
        ("072#", "NMT master 0 a negotiation of the flying masters begins"),
        ("076#01", "NMT master 0 the flying masters have to negotiate again: 01"),
        ("780#", "? 0 nothing"),
        ("18FF0001#00", "? 0 29-bit identifier, which no file here assigns"),
        ("605#", "SDO 5 too short for its command: no data"),
        ("585#", "SDO 5 too short for its command: no data"),
    ],
)
def test_each_service(frame: str, meaning: str) -> None:
    (seen,) = meanings(frame)
    assert seen == meaning or (meaning.endswith(" ") and seen.startswith(meaning) and "error register" in seen)


def test_an_emergency_is_told_in_full() -> None:
    (seen,) = meanings("085#1081014200000000")
    assert seen.startswith("EMCY 5 0x8110 CAN overrun")
    assert seen.endswith("error register 0x01 (generic), 42 00 00 00 00")


MAPPED_ANEW = (
    "605#2300180185010080", "585#6000180100000000",  # the PDO is destroyed
    "605#2F001A0000000000", "585#60001A0000000000",
    "605#23001A0199999999", "585#80001A0141000406",  # refused: it does not count
    "605#23001A0110004160", "585#60001A0100000000",
    "605#23001A0208002222", "585#60001A0200000000",
    "605#2F001A0002000000", "585#60001A0000000000",
    "605#2300180186010000", "585#6000180100000000",
)  # fmt: skip


def test_pdo_parameters_that_the_recording_shows_count_until_the_next_boot_up() -> None:
    before, *_, old, new = meanings("185#6F0039300000", *MAPPED_ANEW, "185#6F0039300000", "186#6F0005")
    assert before == "TPDO 1 5 statusword = 111 (ready), position = 12345 (0x3039)"
    assert old == "TPDO 1 5 6f 00 39 30 00 00"  # nothing that we know has this COB-ID now
    assert new == "TPDO 1 5 statusword = 111 (ready), 0x2222:00 = 5"  # an object that the file lacks
    *_, after, gone = meanings(*MAPPED_ANEW, "705#00", "185#6F0039300000", "186#6F0005")
    assert (after, gone) == (before, "TPDO 1 6 6f 00 05")


def written(node_id: int, index: int, subindex: int, value: int) -> list[str]:
    """A write that the node confirms."""
    place = f"{index & 0xFF:02X}{index >> 8:02X}{subindex:02X}"
    return [f"{0x600 + node_id:03X}#23{place}{value.to_bytes(4, 'little').hex()}", f"{0x580 + node_id:03X}#60{place}00000000"]


def test_cob_ids_of_services_that_the_recording_shows() -> None:
    *_, sync, predefined = meanings(*written(5, 0x1005, 0, 0x4000_0091), "091#03", "080#")
    assert (sync, predefined) == ("SYNC 0 counter 3", "SYNC 0")
    *_, time = meanings(*written(5, 0x1012, 0, 0x8000_0101), "101#000000000000")
    assert time == "TIME 0 1984-01-01 00:00:00+00:00"
    frames = ["0A0#1081010000000000", "120#1081010000000000"]
    *_, before, emergency = meanings(*written(5, 0x1014, 0, 0x120), *frames)
    assert before.startswith("EMCY 32 0x8110")
    assert emergency.startswith("EMCY 5 0x8110")
    *_, invalid = meanings(*written(5, 0x1014, 0, 0x8000_0120), frames[1])
    assert invalid.startswith("? 0")
    *_, extended = meanings(*written(5, 0x1014, 0, 0x3234_5678), "12345678#1081010000000000")
    assert extended.startswith("EMCY 5 0x8110")
    *_, consumed = meanings(*written(9, 0x1028, 5, 0x120), frames[1])
    assert consumed.startswith("EMCY 5 0x8110"), "who listens to it says whose it is"
    *_, after = meanings(*written(5, 0x1014, 0, 0x120), "705#00", frames[1])
    assert after.startswith("? 0"), "a boot-up: the power-on value counts again"


def test_a_file_that_leaves_out_the_node_id_changes_nothing() -> None:
    entries = [
        obj(0x1014, (U32, 0x80), name="emcy"),
        obj(0x1012, (U32, 0x85), name="time"),
        obj(0x1005, (U32, 0x86), name="sync"),
    ]
    channel = obj(0x1201, (U8, 2), (U32, 0x605), (U32, 0x585))
    observer = Observer({9: ObjectDictionary([*entries, channel])}.get)
    frames = ("080#01", "085#1081010000000000", "086#1081010000000000", "605#4041600000000000")
    seen = [observer.observe(Frame.parse(frame), 0).meaning for frame in frames]
    assert [(each.service, each.node_id) for each in seen] == [("SYNC", 0), ("EMCY", 5), ("EMCY", 6), ("SDO", 5)]


def test_stored_parameters_outlive_a_boot_up() -> None:
    moved = written(5, 0x1014, 0, 0x120)
    save, load = int.from_bytes(b"save", "little"), int.from_bytes(b"load", "little")
    *_, stored = meanings(*moved, *written(5, 0x1010, 1, save), "705#00", "120#1081010000000000")
    assert stored.startswith("EMCY 5 0x8110")
    *_, restored = meanings(*moved, *written(5, 0x1010, 1, save), *written(5, 0x1011, 1, load), "705#00", "120#1081010000000000")
    assert restored.startswith("? 0")
    *_, other = meanings(*moved, *written(5, 0x1010, 3, save), "705#00", "120#1081010000000000")
    assert other.startswith("? 0"), "only parameters of the application were stored"
    *_, refused = meanings(*moved, written(5, 0x1010, 1, save)[0], "585#8010100120000008", "705#00", "120#1081010000000000")
    assert refused.startswith("? 0")


CHANNEL = ["6E1#4041600000000000", "6E2#4B4160006F000000"]


@pytest.mark.parametrize(
    "record",
    [
        written(5, 0x1201, 1, 0x6E1) + written(5, 0x1201, 2, 0x6E2),
        written(9, 0x1280, 1, 0x6E1) + written(9, 0x1280, 2, 0x6E2) + written(9, 0x1280, 3, 5),  # its client has it
        written(5, 0x1201, 1, 0x6E1) + written(5, 0x1201, 2, 0x6E2) + written(9, 0x1280, 1, 0x6E1) + written(9, 0x1280, 2, 0x6E2),
    ],
)
def test_sdo_channels_beyond_the_first(record: list[str]) -> None:
    *_, request, answer = meanings(*record, *CHANNEL)
    assert (request, answer) == ("SDO 5 read 6041:00 statusword", "SDO 5 read 6041:00 statusword = 111 (ready)")
    *_, request, _ = meanings(*record, *written(5, 0x1201, 1, 0x8000_06E1), *written(9, 0x1280, 2, 0x8000_06E2), *CHANNEL)
    assert request.startswith("? 0"), "it is not valid any more"


def test_two_channels_of_a_server_are_two_transfers() -> None:
    record = written(5, 0x1201, 1, 0x6E1) + written(5, 0x1201, 2, 0x6E2)
    *_, first, second = meanings(*record, "605#4064600000000000", *CHANNEL, "585#4364600007000000")
    assert (first, second) == ("SDO 5 read 6041:00 statusword = 111 (ready)", "SDO 5 read 6064:00 position = 7")


def test_multiplexed_pdos() -> None:
    source = [*written(6, 0x1A00, 0, 0xFE), *written(6, 0x1800, 1, 0x186)]
    *_, known, unknown, short = meanings(*source, "186#056460000700FEFF", "186#0600200101000000", "186#05")
    assert known == "TPDO 1 6 6064:00 position of node 5 = -131065"
    assert unknown == "TPDO 1 6 2000:01 of node 6 = 0x00000001"
    assert short == "TPDO 1 6 a multiplexed PDO has 8 bytes: 05"
    destination = [*written(6, 0x1600, 0, 0xFF), *written(6, 0x1400, 1, 0x206)]
    *_, whom, all_nodes = meanings(*destination, "206#8541600037020000", "206#8041600037020000")
    assert whom == "RPDO 1 6 6041:00 statusword of node 5 = 567 (0x237)"
    assert all_nodes == "RPDO 1 6 6041:00 of all nodes = 0x00000237"


def test_pdo_parameters_count_for_a_device_without_a_file_as_well() -> None:
    reads = ("605#40001A0000000000", "585#4F001A0001000000", "605#40001A0100000000", "585#43001A0110004160")
    *_, meaning = meanings(*reads, "185#6F00", of=None)
    assert meaning == "TPDO 1 5 0x6041:00 = 111"  # its COB-ID is the standard's until another is seen


@pytest.mark.parametrize(
    ("reason", "is_told"),
    [
        ("585#4300100092010200", True),  # 0x1000: a drive
        ("585#4300100091010F00", False),  # inputs and outputs
        ("585#4318100132030000", True),  # 0x1018:01: the vendor whose PDOs the file describes
        ("585#4318100133030000", False),
        ("585#4318100232030000", False),  # 0x1018:02
        ("586#4300100092010200", False),  # another node
        ("080#", False),
    ],
)
def test_a_guess_needs_a_reason_and_the_length(reason: str, is_told: bool) -> None:
    dictionary = ObjectDictionary(
        [], pdos=[PdoDescription("short", 0x180, Direction.TPDO, 1, (Variable(0x6041, 0, "statusword", U16),))]
    )
    observer = Observer(lambda node_id: dictionary)
    request = Frame(int(reason[:3], 16) + 0x80, b"\x40" + bytes.fromhex(reason[6:12]) + bytes(4))
    for frame in (Frame.parse("185#0F00"), request, Frame.parse(reason)):
        observer.observe(frame, 0)
    guess, longer = (observer.observe(Frame.parse(text), 0).meaning for text in ("185#0F00", "185#0F0000"))
    assert f"{guess.service} {guess.text}".startswith("short? statusword" if is_told else "TPDO 1 0f 00")
    assert f"{longer.service} {longer.text}" == "TPDO 1 0f 00 00", "its length refutes the guess"


def test_pdos_of_the_csv_file_for_devices_that_describe_none() -> None:
    variables = [Variable(0x6040, 0, "controlword", U16), Variable(0x6064, 0, "position", DataType.INTEGER32)]
    control, position = variables
    pdos = [
        PdoDescription("short", 0x200, Direction.RPDO, 1, (control,)),
        PdoDescription("long", 0x200, Direction.RPDO, 1, (control, Filler("notused16", 16), position)),
    ]
    dictionary = ObjectDictionary([Object(0x6040, "c", ObjectType.VAR, {0: control})], pdos=pdos)
    observer = Observer(lambda node_id: dictionary, drives=[5])
    seen = [
        observer.observe(Frame.parse(text), 0).meaning
        for text in ("205#0F00", "205#0F00000001000000", "205#0F", "285#0F00", "180#")
    ]
    assert [f"{each.service} {each.text}" for each in seen] == [
        "short? controlword = 15 (enable operation)",
        "long? controlword = 15 (enable operation), position = 1",
        "RPDO 1 0f",
        "TPDO 2 0f 00",
        "? nothing",
    ]


def test_names_that_repeat_are_told_with_their_place() -> None:
    inputs = {sub: Variable(0x6401, sub, "input", U8) for sub in (1, 2)}
    entries = obj(0x1A00, (U8, 2), (U32, 0x6401_0108), (U32, 0x6401_0208))
    dictionary = ObjectDictionary(
        [Object(0x6401, "inputs", ObjectType.ARRAY, inputs), obj(0x1800, (U8, 2), (U32, 0x185)), entries]
    )
    assert (
        Observer(lambda node_id: dictionary).observe(Frame.parse("185#0102"), 0).meaning.text
        == "6401:01 input = 1, 6401:02 input = 2"
    )


def shown(*frames: str) -> list[tuple[ShownObject, ...]]:
    observer = Observer(lambda node_id: DICTIONARY if node_id == 5 else None)
    return [observer.observe(Frame.parse(frame), 0).meaning.objects for frame in frames]


def test_the_objects_of_a_pdo_have_names_and_values() -> None:
    statusword = ShownObject(5, 0x6041, 0, "statusword", 0x6F, "111 (ready)", True)
    position = ShownObject(5, 0x6064, 0, "position", -2, "-2", True)
    assert shown("185#6F00FEFFFFFF", "205#6F00", "185#6F", "185#R") == [
        (statusword, position),
        (replace(statusword, is_held=False),),  # the master's; it is not sure that the node takes it
        (),
        (),
    ]


def test_the_object_of_an_sdo_transfer_has_a_value_where_a_frame_shows_it() -> None:
    asked = ShownObject(5, 0x6041, 0, "statusword", None, "", False)
    read = ShownObject(5, 0x6041, 0, "statusword", 0x6F, "111 (ready)", True)
    assert shown("605#4041600000000000", "585#4B4160006F000000") == [(asked,), (read,)]
    position = ShownObject(5, 0x6064, 0, "position", 7, "7", True)
    assert shown("605#2364600007000000", "585#6064600000000000") == [(replace(position, is_held=False),), (position,)]
    refused = [(replace(position, is_held=False),), (ShownObject(5, 0x6064, 0, "position", None, "", False),)]
    assert shown("605#2364600007000000", "585#8064600000000008") == refused
    unknown = ShownObject(5, 0x3000, 1, "", b"\1\2", "0x0201", False)
    strange = ShownObject(5, 0x6041, 0, "statusword", b"\1", "01 (not of its type, UNSIGNED16)", False)
    assert shown("605#2B00300101020000", "605#2F41600001000000") == [(unknown,), (strange,)]
    assert shown("605#6000000000000000", "705#05", "605#") == [(), (), ()]


def test_bytes() -> None:
    assert [bytes_text(each) for each in (b"", b"\0", b"abc\0\0", b"\xff", bytes(40))] == [
        "nothing",
        "00",
        "'abc'",
        "ff",
        "00 " * 31 + "00 ... (40 bytes)",
    ]


one_frame = frames(nodes=st.just(5)) | near_valid_frames(nodes=st.just(5)) | random_frames()


parameters = st.tuples(
    st.sampled_from([5, 6]),
    st.sampled_from(
        [0x1005, 0x1010, 0x1012, 0x1014, 0x1028, 0x1200, 0x1201, 0x1280, 0x1400, 0x1600, 0x1800, 0x1801, 0x1A00, 0x1A01]
    ),
    st.integers(0, 3),
    st.sampled_from([0, 1, 2, 5, 0xFE, 0xFF, 0x85, 0x185, 0x605, 0x8000_0185, 0x2000_0185, 0x6041_0010, 0x6064_0020, 0x7573_6173])
    | st.integers(0, 0xFFFF_FFFF),
)


@given(st.lists(parameters | st.none(), max_size=30))
@examples(100)
def test_pdos_that_change_one_by_one_are_those_that_are_read_at_once(steps: list[tuple[int, int, int, int] | None]) -> None:
    """None: node 5 boots."""
    known = ObservedParameters({5: DICTIONARY, 6: ObjectDictionary(())})
    pdos = ObservedPdos(known)
    for node_id in (5, 6):
        pdos.renew(node_id)
    for step in steps:
        if step is None:
            known.booted(5)
            pdos.renew(5)
        elif known.settle(step[0], step[1], step[2], step[3].to_bytes(4, "little")):
            pdos.renew(step[0], step[1])
    fresh = ObservedPdos(known)
    for node_id in (5, 6):
        fresh.renew(node_id)

    def seen(of: ObservedPdos) -> list[object]:
        keys = [routing_key(can_id, flags) for can_id in range(0x800) for flags in (0, EXTENDED)]
        found = [pdo and (pdo.node_id, pdo.name, pdo.mapping and pdo.mapping.parameters) for pdo in map(of.find, keys)]
        return [*found, *[(key, first.name, second.name) for key, first, second in of.shared()]]

    assert seen(pdos) == seen(fresh)


changes = parameters.map(lambda change: [Frame.parse(text) for text in written(*change)])


@given(st.lists(one_frame.map(lambda frame: [frame]) | changes, max_size=40))
@examples(150)
def test_any_frames_have_a_meaning(parts: list[list[Frame]]) -> None:
    observer = Observer(lambda node_id: DICTIONARY if node_id == 5 else None)
    for frame in (frame for part in parts for frame in part):
        meaning = observer.observe(frame, 0).meaning
        assert meaning.service
        assert 0 <= meaning.node_id <= 127
        assert len(meaning.text) < 300


@needs_recordings
def test_words_do_not_depend_on_when_they_are_read() -> None:
    for path in sorted(FOLDER.glob("*.log")):
        frames = [Frame.parse(line.split()[2]) for line in path.read_text().splitlines()]
        first, second = Observer(), Observer()
        at_once = [(meaning.text, meaning.objects) for meaning in (first.observe(frame, 0).meaning for frame in frames)]
        later = [second.observe(frame, 0).meaning for frame in frames]
        assert [(meaning.text, meaning.objects) for meaning in later] == at_once


@needs_recordings
def test_recorded_transfers_come_out_whole() -> None:
    seen = []
    for path in sorted(FOLDER.glob("*.log")):
        observer = Observer()
        frames = [Frame.parse(line.split()[2]) for line in path.read_text().splitlines()]
        seen += [observer.observe(frame, 0).meaning for frame in frames]
    texts = [meaning.text for meaning in seen]
    assert "read 1008:00 manufacturer_device_name = 'CANopenDemoLinux'" in texts
    assert "write 2121:02 = 'ABCDEFGHIJKLMNOPQRSTUVWX'" in texts
    assert any(text.startswith("write 2122:00 = ") and text.endswith("(3000 bytes)") for text in texts)
    assert not any("not heard" in text for text in texts)
    assert {meaning.service for meaning in seen} >= {
        "NMT",
        "SYNC",
        "EMCY",
        "TIME",
        "SDO",
        "LSS",
        "boot-up",
        "heartbeat",
        "TPDO 1",
    }
