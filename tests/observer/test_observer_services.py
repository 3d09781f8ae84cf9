"""Faults of SYNC, emergencies, time stamps, guarding, NMT commands, and of the times at which PDOs come."""

from __future__ import annotations

import pytest

from canopen_proto.machine import MILLISECOND, SECOND
from tests.observer.test_observer import Bus


def written(node_id: int, index: int, subindex: int, value: int, size: int) -> tuple[str, str]:
    """Frames of a write of this value, and of its confirmation."""
    place = f"{index & 0xFF:02X}{index >> 8:02X}{subindex:02X}"
    command = 0x23 | (4 - size) << 2
    data = value.to_bytes(4, "little").hex()
    return f"{0x600 + node_id:03X}#{command:02X}{place}{data}", f"{0x580 + node_id:03X}#60{place}00000000"


@pytest.mark.parametrize(
    ("frames", "expected"),
    [
        ("100#000000000000", []),
        ("100#0000000000", ["length 0: a time stamp of 5 bytes; it has 6"]),
        ("085#0010010000000000", []),
        ("085#001001", ["length 5: an emergency of 3 bytes; it has 8"]),
        ("7E5#0400000000000000", []),
        ("7E5#04", ["length 0: an LSS frame of 1 byte; it has 8"]),
        ("080#0102", ["length 0: a SYNC of 2 bytes; it has one for the counter, or none"]),
        ("000#0105", []),
        ("000#0305", ["nmt 0: an NMT command 0x03 for node 5: there is no such command"]),
        ("000#0180", ["nmt 0: the NMT command start (0x01) with node-ID 128: 0 is all nodes, 1 to 127 one node"]),
        ("000#82FF", ["nmt 0: the NMT command reset communication (0x82) with node-ID 255: 0 is all nodes, 1 to 127 one node"]),
        ("705#7F", []),
        ("705#7E", ["state 5: its heartbeat says state 0x7E, which CiA 301 does not have"]),
    ],
)
def test_single_frames(frames: str, expected: list[str]) -> None:
    assert Bus().hears(frames) == expected


# ---- SYNC ----


@pytest.mark.parametrize(
    ("counters", "found"),
    [
        ([1, 2, 3, 4, 1, 2, 3, 4, 1], []),
        ([3, 4, 5, 1], []),  # the recording begins in the middle
        ([1, 2, 1, 2, 3], []),  # the producer begins again
        ([1, 2, 4], ["missing 0: frames are missing here: the counter of SYNC is 4 behind 2"]),
        ([1, 2, 4, 9], ["missing 0: frames are missing here: the counter of SYNC is 4 behind 2"]),  # the same gap
        ([5, 6, 6], ["copied 0: the counter of SYNC is 6 behind 6: it is there twice, or two nodes produce SYNC"]),
        ([7, 3], ["missing 0: frames are missing here: the counter of SYNC is 3 behind 7"]),
        ([239, 240, 241], ["sync counter 0: the counter of SYNC is 241; it runs from 1 to 240 at most"]),
        ([0], ["sync counter 0: the counter of SYNC is 0; it runs from 1 to 240 at most"]),
    ],
)
def test_the_counter_of_sync(counters: list[int], found: list[str]) -> None:
    heard = Bus().hear_all(*(f"080#{counter:02X}" for counter in counters))
    assert heard == found


def test_syncs_of_two_producers() -> None:
    mixed = ["two sync 0: SYNCs with a counter and without one in turn: two nodes produce SYNC"]
    assert Bus().hear_all("080#", "080#01", "080#02", "080#03") == [], "the producer was given a counter"
    assert Bus().hear_all("080#", "080#01", "080#", "080#01", "080#") == mixed
    bus = Bus()
    first = [*written(5, 0x1005, 0, 0x4000_0080, 4), *written(5, 0x1006, 0, 10_000, 4)]
    assert bus.hear_all(*first, *written(8, 0x1005, 0, 0x4000_0080, 4), *written(7, 0x1006, 0, 10_000, 4)) == []
    both = ["two sync 8: nodes 5, 8 produce SYNC: bit 30 of 0x1005, and 0x1006 > 0"]
    assert bus.hear_all(*written(8, 0x1006, 0, 5000, 4)) == both
    assert bus.hear_all(*written(8, 0x1006, 0, 5000, 4)) == [], "it is said once"
    assert bus.hear_all("705#00", *written(8, 0x1006, 0, 5000, 4)) == [], "node 5 has forgotten it"
    assert bus.hear_all(*first) == ["two sync 5: nodes 5, 8 produce SYNC: bit 30 of 0x1005, and 0x1006 > 0"]


# ---- error control ----


@pytest.mark.parametrize(
    ("answers", "found"),
    [
        (["05", "85", "05", "85"], []),
        (["05", "85", *["85"] * 6], ["missing"]),  # the recording may lack the one between, each time
        (["05", "85", *["85"] * 7], ["missing", "toggle"]),
        (["05"] * 8, ["missing", "toggle"]),
        (["05", "85", *["85"] * 6, "05", "05"], ["missing"]),
        (["7F", "FF", "00", "7F", "FF"], []),  # it has booted
        (["00", "FF"], ["missing"]),  # the first answer behind a boot-up has 0
    ],
)
def test_the_toggle_bit_of_guarding_answers(answers: list[str], found: list[str]) -> None:
    heard = Bus().hear_all(*(text for answer in answers for text in ("705#R1", f"705#{answer}")))
    words = "its guarding answers do not alternate the toggle bit"
    texts = {
        "missing": f"missing 5: frames are missing here: {words}",
        "toggle": f"toggle 5: {words}: it sends heartbeats instead, or two nodes have one ID",
    }
    assert heard == [texts[each] for each in found]
    assert Bus().hear_all(*(f"705#{answer}" for answer in answers)) == [], "requests that are not in the recording"
    assert Bus().hear_all("705#05", "705#R1", "707#05", "707#R1", "705#85", "707#85") == []


def test_heartbeats_of_two_nodes_with_one_state() -> None:
    bus = Bus()
    assert bus.hear_all(*written(5, 0x1017, 0, 100, 2)) == []
    assert bus.hear_all(*["705#05"] * 20, after=100 * MILLISECOND) == []
    assert bus.hear_all("705#05", "705#05", after=20 * MILLISECOND) == [], "one was late before"
    assert bus.hear_all(*["705#05"] * 9, after=40 * MILLISECOND) == [], "it has another time, which the recording lacks"
    words = "its heartbeats come 30 ms and 70 ms apart in turn, and it sends one in 100 ms: two nodes have one ID"
    assert _in_turn(bus) in ([f"double id 5: {words}"], [f"double id 5: {words.replace('30 ms and 70', '70 ms and 30')}"])
    assert bus.hears("705#00") == []
    assert _in_turn(bus) == [], "its period is not known any more"
    assert bus.hear_all(*written(5, 0x1017, 0, 0, 2)) == []
    assert _in_turn(bus) == []


def test_heartbeats_of_two_nodes_are_told_whether_or_not_the_recording_shows_their_period() -> None:
    """A service technician's bus: two devices with one node-ID, each with a heartbeat in 500 ms. Nobody reads 0x1017."""
    turns = [(20, 480), (480, 20)]
    for first, second in turns:
        bus = Bus()
        told = [each for pair in [(first, second)] * 9 for ms in pair for each in bus.hears("705#7F", after=ms * MILLISECOND)]
        assert len(told) == 1
        assert told[0].startswith("double id 5: its heartbeats come ")
        assert told[0].endswith(" apart in turn: two nodes have one ID")


@pytest.mark.parametrize("turn", [(10, 20), (64, 128), (40, 100), (100, 100), (20, 480, 500), (3, 497)])
def test_heartbeats_by_a_coarse_clock_or_late_ones_are_no_second_node(turn: tuple[int, ...]) -> None:
    bus = Bus()
    told = [each for pair in [turn] * 15 for ms in pair for each in bus.hears("705#7F", after=ms * MILLISECOND)]
    assert not any(each.startswith("double id") for each in told)


def test_two_guarding_masters_are_no_second_node() -> None:
    bus, told = Bus(), []
    for number in range(40):
        told += bus.hears("705#R1", after=(20, 480)[number % 2] * MILLISECOND)
        told += bus.hears(f"705#{5 + 0x80 * (number % 2):02X}", after=0)
    assert not any(each.startswith("double id") for each in told)


def _in_turn(bus: Bus) -> list[str]:
    return [found for each in (30, 70) * 7 for found in bus.hears("705#05", after=each * MILLISECOND)]


def test_heartbeats_that_were_held_back_are_no_second_node() -> None:
    bus = Bus()
    assert bus.hear_all(*written(5, 0x1017, 0, 100, 2)) == []
    assert bus.hear_all(*["705#05"] * 9, after=100 * MILLISECOND) == []
    assert [each[:16] for each in bus.hears("705#05", after=SECOND)] == ["late heartbeat 5"]
    assert bus.hear_all(*["705#05"] * 9, after=MILLISECOND // 10) == [
        "copied 5: heartbeats come at once: they are there twice, or were held back"
    ]
    assert bus.hear_all(*["705#05"] * 9, after=100 * MILLISECOND) == []


def test_answers_of_two_lss_services_are_two_requests() -> None:
    bus = Bus()
    for _ in range(9):
        (lacking,) = bus.hear_all("7E5#5A00000000000000", "7E4#5A01000000000000", "7E4#5B02000000000000", after=SECOND)
        assert lacking.startswith("missing 0: ")


def test_two_answers_to_one_lss_request() -> None:
    bus = Bus()
    assert bus.hear_all("7E5#5A", "7E4#5A01000000000000")[1:] == []
    twice = ["7E5#5A00000000000000", "7E4#5A01000000000000", "7E4#5A02000000000000"]
    words = "two answers to one LSS request: two devices are in LSS configuration state"
    assert bus.hear_all(*twice) == [f"missing 0: frames are missing here: {words}, or a request is missing"]
    assert bus.hear_all(*twice, after=SECOND) == [f"missing 0: frames are missing here: {words}, or a request is missing"]
    assert bus.hear_all(*twice, after=SECOND) == [f"double id 0: {words}"]
    assert bus.hear_all("7E5#5100000000000000", *["7E4#4F00000000000000"] * 3) == [], (
        "an identification has any number of answers"
    )


# ---- emergencies and PDOs: when they come ----


def test_the_inhibit_time_of_emergencies() -> None:
    bus = Bus()
    error = "085#0010010000000000"
    assert bus.hear_all(error, error, after=MILLISECOND) == []
    assert bus.hear_all(*written(5, 0x1015, 0, 1000, 2), error, after=60 * MILLISECOND) == []
    assert bus.hears(error, after=60 * MILLISECOND) == [], "the first one was held up"
    words = "an emergency 40 ms behind the last one; 0x1015 allows one in 100 ms"
    assert bus.hear_all(error, error, after=40 * MILLISECOND) == []
    assert bus.hears(error, after=40 * MILLISECOND) == [f"inhibit time 5: {words}"]
    assert bus.hear_all("705#00", error, error, after=MILLISECOND) == []
    assert bus.hear_all("705#00", *written(5, 0x1015, 0, 1000, 2)) == []
    assert bus.hears(error) == []
    assert bus.hear_all(error, error, after=40 * MILLISECOND) == [], "the first one is measured from nothing"
    assert bus.hears(error, after=40 * MILLISECOND) == [f"inhibit time 5: {words}"]


TPDO = "185#370210000000"


def test_the_inhibit_time_of_pdos() -> None:
    bus = Bus()
    assert bus.hear_all(TPDO, TPDO, "205#0600", "205#0600", after=MILLISECOND) == []
    assert bus.hear_all(*written(5, 0x1800, 3, 200, 2), *written(5, 0x1400, 3, 200, 2), "205#0600", "205#0600") == []
    assert bus.hear_all(TPDO, TPDO, after=15 * MILLISECOND) == []
    words = "inhibit time 5: TPDO 1 8 ms behind the last one; its inhibit time is 20 ms"
    assert bus.hear_all(TPDO, TPDO, after=8 * MILLISECOND) == []
    assert bus.hears(TPDO, after=8 * MILLISECOND) == [words]
    assert bus.hear_all(*written(5, 0x1800, 3, 0, 2), TPDO, TPDO, after=MILLISECOND) == []


def test_the_event_timer() -> None:
    late = ["late pdo 5: TPDO 1 does not come; its event timer is 100 ms"]
    bus = Bus()
    assert bus.hear_all(*written(5, 0x1800, 2, 254, 1), *written(5, 0x1800, 5, 100, 2), "705#05") == []
    assert bus.hear_all(*[TPDO] * 5, after=140 * MILLISECOND) == []
    assert bus.hears("080#", after=149 * MILLISECOND) == []
    assert bus.hears("080#", after=MILLISECOND) == late
    assert bus.hears("080#", after=SECOND) == [], "it is said once"
    assert bus.hear_all(TPDO, "080#", after=SECOND) == late
    assert bus.hear_all(TPDO, "000#8005", "080#", after=100 * MILLISECOND) == [], "it was told to stop"
    assert bus.hear_all("705#7F", "705#05", *written(5, 0x1800, 2, 1, 1), TPDO) == []
    assert bus.hears("080#", after=SECOND) == [], "synchronous PDOs have none"
    assert bus.hear_all("705#00", "705#05", TPDO, "080#", after=SECOND) == [], "it has its power-on values again"


@pytest.mark.parametrize("kind", [1, 3])
def test_synchronous_pdos(kind: int) -> None:
    twice = "synchronous pdo 5: TPDO 1 comes a second time behind one SYNC, 5 times in a row"
    missing = f"late pdo 5: TPDO 1 does not come, at a SYNC and at the next one; its transmission type is {kind}"
    bus = Bus()
    syncs = ["080#"] * kind
    assert bus.hear_all(*written(5, 0x1800, 2, kind, 1), "705#05", *syncs, TPDO, *syncs, TPDO) == []
    assert bus.hears(TPDO) == ["copied 5: TPDO 1 comes a second time behind one SYNC"]
    for number in range(5):
        assert bus.hear_all(*syncs, f"185#3702100000{number + 1:02X}") == []
        assert bus.hears(TPDO, after=MILLISECOND) == ([twice] if number == 4 else [])
    for number in range(9):
        again = [TPDO] * (number % 4 != 0)  # never five times in a row
        assert bus.hear_all(*syncs, "185#370210000001") == []
        assert [each for text in again for each in bus.hears(text, after=MILLISECOND)] == []
    assert bus.hear_all(*syncs, "080#", TPDO) == [], "it was late"
    assert bus.hear_all(*syncs, "080#", "080#", TPDO) == [missing]
    assert bus.hear_all(*syncs, "000#8005", "705#7F", "080#", "080#", "080#", "080#") == []
    assert bus.hear_all(*syncs, TPDO, "705#00", "705#05", *syncs * 4) == [], "its type is not known any more"
    assert bus.hear_all("705#00", "705#05", TPDO, TPDO) == []


def test_a_pdo_at_some_syncs_only() -> None:
    bus = Bus()
    assert bus.hear_all(*written(5, 0x1800, 2, 0, 1), "705#05", "080#", TPDO, *["080#"] * 5, TPDO) == []
    assert bus.hears("185#370210000001") == ["missing 5: frames are missing here: TPDO 1 comes a second time behind one SYNC"]
