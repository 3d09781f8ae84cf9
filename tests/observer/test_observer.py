"""Faults on a bus: each rule of the observer, on a session in which it is planted, and on one like it that is right."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, Time
from canopen_proto.observer.observer import RULES, Observer
from canopen_testing.strategies import near_valid_frames, random_frames
from tests.examples import examples
from tests.interop.recorded import load, needs_recordings
from tests.observer.test_decoding import DICTIONARY, U8, U32, obj


class Bus:
    """Says what is found. has_boots: also boot-ups that nobody has asked for; most tests let a node boot to make it forget."""

    def __init__(self, *, has_boots: bool = False, **settings: float) -> None:
        self.has_boots = has_boots
        self.observer = Observer(lambda node_id: DICTIONARY if node_id in (5, 6) else None, **settings)  # type: ignore[arg-type]
        self.now: Time = 0

    def hears(self, text: str, after: Time = 10 * MILLISECOND) -> list[str]:
        self.now += after
        found = self.observer.observe(Frame.parse(text), self.now).findings
        assert all(finding.rule in RULES for finding in found)
        told = [finding for finding in found if self.has_boots or finding.rule != "boot-up"]
        return [f"{finding.rule} {finding.node_id}: {finding.text}" for finding in told]

    def hear_all(self, *texts: str, after: Time = 10 * MILLISECOND) -> list[str]:
        return [finding for text in texts for finding in self.hears(text, after)]


# ---- PDOs ----


def test_the_length_of_a_pdo() -> None:
    bus = Bus()
    assert bus.hears("185#370210000000") == []
    assert bus.hears("185#3702100000") == ["pdo length 5: TPDO 1 has 5 bytes, and its mapping 6"]
    assert bus.hears("185#37021000000000") == ["pdo length 5: TPDO 1 has 7 bytes, and its mapping 6"]
    assert bus.hears("185#R6") == []
    assert bus.hears("205#0600") == []
    assert bus.hears("205#060000") == ["pdo length 5: RPDO 1 has 3 bytes, and its mapping 2"]
    assert bus.hears("187#00") == [], "nobody knows the mapping of node 7"


def test_a_cob_id_that_two_nodes_use() -> None:
    bus = Bus()
    assert bus.hear_all("185#370210000000", "705#05") == [], "the files of 5 and 6 say so, but is there a node 6?"
    assert bus.hears("706#7F") == ["shared cob-id 6: TPDO 1 of node 5 and TPDO 1 of node 6 have the COB-ID 0x185"]
    assert bus.hear_all("706#7F", "185#370210000000") == [], "it is said once"
    bus = Bus()
    assert bus.hear_all("705#05", "606#2300180186010000", "586#6000180100000000", "706#7F") == [], "node 6 was told another one"


# ---- states ----


def test_pdos_of_a_node_that_is_not_operational() -> None:
    bus = Bus()
    assert bus.hear_all("705#05", "185#370210000000", "000#8005", "185#370210000000") == [], "what is in its queue still goes out"
    assert bus.hears("185#370210000000", after=200 * MILLISECOND) == [], "it may have been started meanwhile"
    assert bus.hear_all("705#7F", after=MILLISECOND) == [], "it may have been sent before the PDO"
    assert bus.hears("185#370210000000", after=200 * MILLISECOND) == []
    assert bus.hear_all("705#7F", after=SECOND) == ["not operational 5: it sends a PDO, and is pre-operational"]
    assert bus.hear_all("705#7F", "185#370210000000") == [], "not with each frame"
    assert bus.hear_all("705#00", "185#370210000000", after=SECOND) == [], "it may have started by itself"
    assert bus.hear_all("705#05", "185#370210000000", after=SECOND) == []


def test_an_sdo_to_a_stopped_node() -> None:
    bus = Bus()
    assert bus.hear_all("605#4041600000000000", "585#4B41600037020000", "000#0205", "605#4041600000000000") == []
    words = "an SDO goes to a node that is stopped: it may not answer"
    assert bus.hears("605#4041600000000000", after=SECOND) == [], "it may have been started meanwhile"
    assert bus.hears("705#04", after=SECOND) == [f"stopped 5: {words}"]
    assert bus.hear_all("605#4041600000000000", "705#04", after=SECOND) == []
    assert bus.hear_all("605#4041600000000000", "585#4B41600037020000", after=SECOND) == []
    assert bus.hears("705#04", after=SECOND) == ["stopped 5: it is stopped, and answers an SDO"]
    assert bus.hear_all("000#0100", "605#4041600000000000", "585#4B41600037020000", after=SECOND) == []


def test_a_heartbeat_right_behind_an_sdo_to_a_stopped_node_does_not_acquit_it() -> None:
    bus = Bus()
    told = ["stopped 5: an SDO goes to a node that is stopped: it may not answer"]
    assert bus.hear_all("705#05", "000#0205", "705#04", "605#4041600000000000", after=150 * MILLISECOND) == []
    assert bus.hears("705#04", after=MILLISECOND) == [], "it may have been sent before the SDO"
    assert bus.hears("705#04", after=100 * MILLISECOND) == told
    assert bus.hear_all("705#05", "000#0205", "705#04", "605#4041600000000000", after=150 * MILLISECOND) == []
    assert bus.hear_all("705#04", "705#7F", "705#04", after=20 * MILLISECOND) == [], "it was not stopped all the time"


@pytest.mark.parametrize(
    ("heard", "is_found"),
    [
        (["705#05", "705#7F"] * 3, True),
        (["705#05", "705#05", "705#7F"] * 3, True),
        (["705#05", "705#7F", "705#05", "705#7F"], False),  # an NMT command may be missing, and another one
        (["705#05", "705#7F", "705#05", "705#7F", "705#05"], False),  # or two of them
        (["705#05", "705#7F", "705#05"], False),  # an error, and a node that starts again by itself
        (["705#05", "705#04", "705#7F", "705#05"], False),
        (["705#05", "000#8005", "705#7F", "000#0105", "705#05", "000#8000", "705#7F"], False),
        (["705#05", "705#00", "705#7F", "705#05", "705#00", "705#7F", "705#05"], False),  # switched off and on, twice
        (["705#05", "707#7F", "705#05", "707#7F"], False),
        (["705#85", "705#05", "705#85", "705#05"], False),  # guarding: the toggle bit
    ],
)
def test_two_nodes_with_one_id(heard: list[str], is_found: bool) -> None:
    found = Bus().hear_all(*heard)
    assert bool(found) == is_found
    for text in found:
        assert text.startswith("double id 5: its heartbeats say ")


def test_a_boot_up_in_the_middle_of_operation() -> None:
    told = ["boot-up 5: it boots in the middle of operation, and no reset command is in the recording"]
    for sign_of_life in ("705#05", "585#4B41600037020000", "185#370210000000"):
        bus = Bus(has_boots=True)
        assert bus.hear_all("705#00", "705#00", sign_of_life, "000#8105", "705#00", sign_of_life, "000#8200", "705#00") == []
        assert bus.hear_all(sign_of_life, "000#8106", "705#00") == told, "another node was reset"
        assert bus.hear_all("705#00") == []


def test_a_heartbeat_that_is_late() -> None:
    bus = Bus()
    assert bus.hear_all("607#23161001C8000500", "587#6016100100000000") == []  # node 7 listens to node 5, for 200 ms
    assert bus.hear_all("080#", after=SECOND) == [], "it begins with the first heartbeat"
    assert bus.hear_all("705#05", "705#05", "705#05", after=150 * MILLISECOND) == []
    late = ["late heartbeat 5: no heartbeat for more than 200 ms, which node 7 allows"]
    assert bus.hears("080#", after=250 * MILLISECOND) == [f"{late[0]}; the last one came 250 ms before"]
    assert bus.hears("080#", after=SECOND) == [], "it is said once"
    assert bus.hear_all("705#05", "705#05", after=SECOND)[0].startswith(late[0]), "and again for the next one"
    assert bus.hear_all("607#2316100100000000", "587#6016100100000000", "080#", after=SECOND)[1:] == [], "it is switched off"


def test_a_heartbeat_that_is_late_by_a_consumers_time_that_was_read() -> None:
    read = ("607#4016100100000000", "587#43161001C8000500")  # node 7 listens to node 5, for 200 ms
    bus = Bus()
    assert bus.hear_all(*read, "705#05") == []
    assert bus.hears("080#", after=150 * MILLISECOND) == [], "it still has time"
    assert bus.hears("080#", after=60 * MILLISECOND) == [
        "late heartbeat 5: no heartbeat for more than 200 ms, which node 7 allows; the last one came 210 ms before"
    ]
    bus = Bus()
    assert bus.hear_all(*read, "707#00", "705#05") == [], "behind its boot-up node 7 has the entry that it has stored, or none"
    assert bus.hears("080#", after=SECOND) == []


def test_a_boot_up_leaves_the_consumers_of_a_devices_file() -> None:
    dictionary = ObjectDictionary([obj(0x1016, (U8, 1), (U32, 0x0005_0064))])
    observer = Observer(lambda node_id: dictionary if node_id == 9 else None)
    for text in ("609#2316100100000000", "589#6016100100000000", "000#8109", "709#00", "705#05"):
        assert observer.observe(Frame.parse(text), 0).findings == ()
    assert [each.rule for each in observer.observe(Frame.parse("080#"), SECOND).findings] == ["late heartbeat"]


def test_consumers_of_a_devices_file() -> None:
    dictionary = ObjectDictionary([obj(0x1016, (U8, 1), (U32, 0x0005_0064))])
    observer = Observer(lambda node_id: dictionary if node_id == 9 else None)
    assert observer.observe(Frame.parse("705#05"), 0).findings == ()
    (found,) = observer.observe(Frame.parse("080#"), SECOND).findings
    assert (found.rule, found.node_id) == ("late heartbeat", 5)


def test_what_a_silent_bus_shows() -> None:
    dictionary = ObjectDictionary([obj(0x1016, (U8, 1), (U32, 0x0005_0064))])
    observer = Observer(lambda node_id: dictionary if node_id == 9 else None)
    for frame in ("706#00", "606#4000100000000000", "586#4300100092010200", "705#05"):
        observer.observe(Frame.parse(frame), SECOND)
    assert observer.idle(SECOND + 99 * MILLISECOND) == ((), ())
    findings, summaries = observer.idle(2 * SECOND)
    assert ([each.rule for each in findings], summaries) == (["late heartbeat"], ())
    findings, summaries = observer.idle(4 * SECOND)
    assert (findings, [each.node_id for each in summaries]) == ((), [6])
    assert observer.unfinished() == ()


def written(node_id: int, ms: int) -> tuple[str, str]:
    """A write of the producer heartbeat time."""
    return f"{0x600 + node_id:03X}#2B171000{ms.to_bytes(2, 'little').hex()}0000", f"{0x580 + node_id:03X}#6017100000000000"


def test_a_node_that_falls_silent_though_nobody_consumes_its_heartbeat() -> None:
    bus = Bus()
    late = ["late heartbeat 5: no heartbeat for more than 250 ms, and it sends one in 100 ms"]
    assert bus.hear_all(*written(5, 100)) == []
    assert bus.hears("080#", after=SECOND) == [], "the recording may show no heartbeats at all"
    assert bus.hear_all("705#05", "705#05", after=100 * MILLISECOND) == []
    assert bus.hears("705#05", after=200 * MILLISECOND) == [], "one may be lost"
    assert bus.hears("080#", after=260 * MILLISECOND) == [f"{late[0]}; the last one came 260 ms before"]
    assert bus.hears("080#", after=SECOND) == [], "it is said once"
    assert bus.hear_all("605#4017100000000000", "585#4B17100064000000") == []
    assert bus.hears("080#", after=SECOND) == [], "also if somebody reads its time again"
    assert bus.hears("705#05") == []
    assert bus.hears("080#", after=SECOND) == [f"{late[0]}; the last one came 1 s before"], "and again for the next one"
    assert bus.hear_all("705#05", *written(5, 0)) == []
    assert bus.hears("080#", after=SECOND) == [], "it was switched off"


def test_its_own_rhythm_tells_how_often_it_sends_a_heartbeat() -> None:
    bus = Bus()
    late = ["late heartbeat 5: no heartbeat for more than 250 ms, and it sends one in 100 ms"]
    assert bus.hear_all(*["705#05"] * 4, after=100 * MILLISECOND) == []
    assert bus.hears("080#", after=SECOND) == [], "no rhythm yet"
    assert bus.hear_all(*["705#05"] * 5, after=100 * MILLISECOND) == []
    assert bus.hears("080#", after=SECOND) == [f"{late[0]}; the last one came 1 s before"]
    assert bus.hear_all(*["705#05"] * 5, after=100 * MILLISECOND) == []
    assert bus.hears("000#8105") == []
    assert bus.hears("080#", after=SECOND) == [], "it was reset, and may have another one"
    assert bus.hear_all(*["705#05"] * 5, "705#00", after=100 * MILLISECOND) == []
    assert bus.hears("080#", after=SECOND) == [], "it has booted, and may have another one"
    assert bus.hear_all(*["705#R1", "705#05"] * 5, after=100 * MILLISECOND)[1:] == []
    assert bus.hears("080#", after=SECOND) == [], "these are answers"


def test_the_end_of_a_consumer_leaves_the_nodes_own_rhythm() -> None:
    bus = Bus()
    assert bus.hear_all("607#231610010A000500", "587#6016100100000000") == []
    assert bus.hear_all(*written(5, 100), "705#05")[1:] == []
    assert bus.hear_all("607#2316100100000000", "587#6016100100000000", after=MILLISECOND) == []
    assert [each[:16] for each in bus.hears("080#", after=SECOND)] == ["late heartbeat 5"]


def test_a_heartbeat_that_comes_soon_is_no_copy_where_something_else_explains_it() -> None:
    bus = Bus()
    assert bus.hear_all("705#05", after=100 * MILLISECOND) == []
    request, answer = written(5, 100)
    assert bus.hear_all(request, "705#05", answer, after=MILLISECOND) == [], "the first one of a new time comes at once"
    assert bus.hear_all("705#05", "705#05", after=100 * MILLISECOND) == []
    assert bus.hears("705#05", after=197 * MILLISECOND) == [], "it is late,"
    assert bus.hears("705#05", after=3 * MILLISECOND) == [], "and the next one is in time"
    copied = "copied 5: heartbeats come at once: they are there twice, or were held back"
    assert bus.hears("705#05", after=MILLISECOND) == [copied]
    assert bus.hear_all(*written(7, 2), *["707#05"] * 20, after=2 * MILLISECOND) == [], "it is sent as often"


def test_wrong_lengths() -> None:
    assert Bus().hear_all("000#01", "705#", "705#0505", "000#010500") == [
        "length 0: an NMT command of 1 byte; it has two",
        "length 5: a heartbeat of 0 bytes; it has one",
        "length 5: a heartbeat of 2 bytes; it has one",
        "length 0: an NMT command of 3 bytes; it has two",
    ]


# ---- load ----


def test_the_load() -> None:
    bus = Bus(bitrate=125_000)
    quiet = [bus.hears("185#370210000000", after=2 * MILLISECOND) for _ in range(1500)]
    assert not any(quiet), "about 100 bits each 2 ms: 40 %"
    busy = [finding for _ in range(2000) for finding in bus.hears("185#370210000000", after=MILLISECOND * 4 // 5)]
    assert busy
    assert all(text.startswith("load 0: the load was ") and text.endswith("the limit is 90 %") for text in busy)


# ---- all ----


@needs_recordings
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("canopennode-sdo-block-download-domain", []),
        ("canopennode-sdo-segmented-upload-string", []),
        ("canopennode-pdo-config-and-traffic", []),
        ("canopennode-sdo-aborts", []),
        ("lely-master-boots-lely-slave", []),
        ("lely-slave-pdo-sync", []),
        # The session was made for this: the device's own emergency (0x8130) says the same in the same frame
        ("canopennode-heartbeat-consumer-emcy", ["late heartbeat", "boot-up"]),
        # The recording's client reads from the stopped node, and starts it before its next heartbeat
        ("canopennode-nmt-commands", []),
    ],
)
def test_recorded_sessions(name: str, expected: list[str]) -> None:
    observer = Observer(bitrate=1_000_000)
    lines = load(name)
    found = [(line, finding) for line in lines for finding in observer.observe(line.frame, line.time).findings]
    assert [finding.rule for _, finding in found] == expected
    if name.endswith("consumer-emcy"):
        assert found[0][0].text.startswith("084#3081")


@given(st.lists(st.tuples(near_valid_frames() | random_frames(), st.integers(0, SECOND)), max_size=40))
@examples(150)
def test_any_frames_are_observed_and_nothing_grows(entries: list[tuple[Frame, int]]) -> None:
    bus = Bus(bitrate=500_000)
    now = 0
    for frame, after in entries:
        now += after
        observation = bus.observer.observe(frame, now)
        assert observation.meaning.service
        assert all(finding.rule in RULES and finding.text for finding in observation.findings)
        assert len(observation.findings) <= 4 + 127


@pytest.mark.parametrize("apart", [0, 3 * MICROSECOND, 30 * MICROSECOND])
def test_frames_that_a_late_reader_took_from_its_queue_at_once_are_no_copies(apart: Time) -> None:
    """No bus carries them in so short a time: when they came is not known."""
    queue = ["703#05", "704#05", "080#01", "080#01"] * 4 + ["603#4041600000000000", "583#4B41600037020000"]
    assert Bus().hear_all(*[each for each in queue for _ in range(2)], after=apart) == []


def test_an_earlier_time_counts_as_the_last() -> None:
    observer = Observer()
    observer.observe(Frame.parse("705#05"), SECOND)
    observer.observe(Frame.parse("080#"), 0)
    assert observer.observe(Frame.parse("705#05"), SECOND + MILLISECOND).findings[0].rule == "copied"
