"""What happened on a bus: emergencies, faults, silent nodes, aborts, on one timeline."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND, Time
from canopen_proto.observer.observer import Observer
from canopen_proto.observer.story import KINDS, MAX_KINDS, Story
from canopen_testing.strategies import near_valid_frames, random_frames
from tests.examples import examples

STATUSWORDS = ["605#40001A0000000000", "585#4F001A0001000000", "605#40001A0100000000", "585#43001A0110004160"]
"""The mapping of TPDO 1 of node 5 is read: 0x6041."""


class Heard:
    """A story that is told by frames; `after` ns each."""

    def __init__(self) -> None:
        self.story, self.observer = Story(), Observer()
        self.now: Time = 0

    def tells(self, *texts: str, after: Time = MILLISECOND) -> list[str]:
        told = []
        for text in texts:
            self.now += after
            frame = Frame.parse(text)
            events = self.story.add(frame, self.observer.observe(frame, self.now), self.now)
            assert all(event.kind in KINDS and event.time == self.now for event in events)
            told += [f"{event.kind} {event.node_id}: {event.text}" for event in events]
        return told


def test_emergencies_are_told_with_their_text_and_once() -> None:
    heard = Heard()
    assert heard.tells("085#0000000000000000") == [], "the end of errors that were not"
    (told,) = heard.tells(*["085#1023030000000000"] * 9)
    assert told.startswith("EMCY 5: 0x2310 continuous over-current")
    assert heard.story.repeated == {"EMCY": 8}
    (told,) = heard.tells("085#0000000000000000")
    assert "0x0000" in told
    assert heard.tells("086#1023030000000000")[0].startswith("EMCY 6: 0x2310")


def test_each_boot_up_is_told_and_is_nothing_wrong() -> None:
    heard = Heard()
    assert heard.tells("000#8105", "705#00", "705#7F") == ["boot 5: it boots, as it was told to"]
    assert heard.tells("706#00", "000#8200", "706#00") == ["boot 6: it boots", "boot 6: it boots, as it was told to"]
    assert not heard.story.is_wrong
    assert heard.tells("705#05", "000#8106", "705#00", "705#05") == ["boot 5: it boots, as it was told to"], "by 82 00"
    assert heard.tells("705#00") == [], "in the middle of operation: that is a finding"


@pytest.mark.parametrize(
    ("frames", "is_wrong"),
    [
        (("605#4000200000000000", "585#8000200000000206"), False),
        (("605#4018100900000000", "585#8018100911000906"), False),
        (("605#4000100000000000", "605#8000100000000405"), False),  # a scan: nobody is there
        (("705#05", "605#4000100000000000", "605#8000100000000405"), True),
        (("605#2B00100002000000", "585#8000100002000106"), True),
        (("605#2B17100012000000", "585#8017100012000706"), True),
    ],
)
def test_an_abort_is_wrong_unless_a_program_looked_for_what_is_missing(frames: tuple[str, ...], is_wrong: bool) -> None:
    heard = Heard()
    (told,) = heard.tells(*frames)
    assert (told[:8], heard.story.is_wrong) == ("abort 5:", is_wrong)


def test_a_drive_falls_into_fault_and_leaves_it() -> None:
    heard = Heard()
    assert heard.tells(*STATUSWORDS, "185#3706", "185#3706") == []
    assert heard.tells("185#0F02", "185#0802", "185#0802") == ["fault 5: the drive is in fault (statusword 0x020F)"]
    assert heard.tells("185#4002") == ["fault 5: the drive has left fault: switch on disabled (statusword 0x0240)"]
    assert heard.tells("606#4041680000000000", "586#4B41680008020000") == [
        "fault 6: the drive of statusword 6841 is in fault (statusword 0x0208)"
    ], "by SDO, of the second axis"
    assert heard.tells("605#2B41600008020000") == [], "a write that nobody has confirmed tells nothing"


def test_a_node_falls_silent_and_comes_back() -> None:
    """Its heartbeats have no even rhythm: so the observer does not find one late."""
    heard = Heard()
    for after in (50, 20) * 9:
        assert heard.tells("705#05", after=after * MILLISECOND) + heard.tells("706#05", after=10 * MILLISECOND) == []
    (told,) = heard.tells(*["706#05"] * 9, after=50 * MILLISECOND)
    assert told == "silent 5: no heartbeat any more; it had one in 60 ms at most; the last one came 210 ms before"
    (told,) = heard.tells("705#05", after=50 * MILLISECOND)
    assert told == "back 5: it is back 510 ms behind its last heartbeat"
    assert heard.tells("000#8205", *["706#05"] * 20, after=20 * MILLISECOND) == [], "somebody has reset it"


def test_a_silence_that_the_observer_finds_is_not_told_once_more() -> None:
    heard = Heard()
    assert heard.tells(*["705#05", "706#05"] * 9, after=50 * MILLISECOND) == []
    assert heard.tells(*["706#05"] * 20, after=50 * MILLISECOND) == []
    assert heard.tells("705#05", after=50 * MILLISECOND) == ["back 5: it is back 1.1 s behind its last heartbeat"]


def test_where_no_frame_comes_at_all_no_node_is_blamed() -> None:
    """Their heartbeats have no even rhythm: so the observer does not find that none came."""
    heard = Heard()
    for after in (50, 20) * 9:
        assert heard.tells("705#05", after=after * MILLISECOND) + heard.tells("706#05", after=10 * MILLISECOND) == []
    assert heard.tells("705#05", after=3 * SECOND) == ["silent 0: the recording has no frame at all for 3 s before this one"]
    assert heard.tells("706#05", *["705#05", "706#05"] * 9, after=50 * MILLISECOND) == []


def test_a_gap_that_the_observer_finds_is_not_told_once_more() -> None:
    heard = Heard()
    assert heard.tells(*["705#05", "706#05"] * 9, after=50 * MILLISECOND) == []
    assert heard.tells("705#05", after=3 * SECOND) == []
    assert heard.tells("706#05", *["705#05", "706#05"] * 9, after=50 * MILLISECOND) == []


def test_aborts_are_told_by_kind() -> None:
    heard = Heard()
    refused = ["605#4000200000000000", "585#8000200000000206"]
    (told,) = heard.tells(*refused * 5)
    assert told.startswith("abort 5: aborted by the server, 2000:00")
    assert heard.story.repeated == {"abort": 4}
    assert len(heard.tells("605#4000200000000000", "585#8000200011000906")) == 1


@given(st.lists(st.tuples(near_valid_frames() | random_frames(), st.integers(0, SECOND)), max_size=60))
@examples(60)
def test_any_frames_are_told_of_and_nothing_grows(entries: list[tuple[Frame, int]]) -> None:
    story, observer, now = Story(), Observer(), 0
    for frame, after in entries:
        now += after
        for event in story.add(frame, observer.observe(frame, now), now):
            assert event.kind in KINDS
            assert event.text


def test_kinds_of_events_are_bounded() -> None:
    heard = Heard()
    for code in range(MAX_KINDS + 10):
        heard.tells("605#4000200000000000", f"585#80002000{code.to_bytes(4, 'little').hex()}")
    assert heard.story.told == {"abort": MAX_KINDS}
    assert heard.story.repeated == {"abort": 10}
