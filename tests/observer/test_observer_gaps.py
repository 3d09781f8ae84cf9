"""The observer accuses nobody because of its recorder: a clean recording, however damaged, shows only that it is damaged."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.machine import SECOND
from canopen_proto.observer.finding import BusFinding
from canopen_proto.observer.observer import Observer
from tests.examples import examples
from tests.observer.observer_sessions import CLEAN, NODE, OF_THE_RECORDER, Session, clean, damaged


def findings(session: Session) -> list[BusFinding]:
    observer = Observer(bitrate=1_000_000)
    return [finding for at, frame in session for finding in observer.observe(frame, at).findings]


@pytest.mark.parametrize("number", [*range(4), *range(4, CLEAN, 7)])
def test_nothing_is_found_in_a_clean_recording(number: int) -> None:
    assert findings(clean(number)) == []


@given(st.integers(0, CLEAN - 1), st.integers(0, 10**9))
@example(6, 600766789)  # a segment that is 30 frames late, in a block of another transfer, before the one with its number
@examples(300)
def test_a_damaged_recording_shows_that_it_is_damaged_and_nothing_else(number: int, seed: int) -> None:
    judge(number, seed)


def judge(number: int, seed: int) -> None:
    """Nothing else but a size or a toggle bit that is said to be likely: the loss of most of two transfers can look like one."""
    session = damaged(clean(number), seed)
    told = findings(session)
    accused = [each for each in told if each.rule not in OF_THE_RECORDER and each.rule != "boot-up"]
    assert [each for each in accused if each.is_certain or each.rule not in ("size", "toggle")] == []
    assert len([each for each in told if each.rule == "boot-up"]) == boot_ups_without_a_reason(session)


def boot_ups_without_a_reason(session: Session) -> int:
    """How often node 12 boots behind a frame of its own without a reset command in between, as this recording has it."""
    count, is_up, is_reset = 0, False, False
    for text in (str(frame) for _, frame in session):
        if text == f"70{NODE:X}#00":
            count += is_up and not is_reset
            is_up = is_reset = False
        elif text == f"000#81{NODE:02X}":
            is_reset = True
        elif text[:3] in (f"70{NODE:X}", f"58{NODE:X}"):
            is_up = True
    return count


@given(st.integers(0, CLEAN - 1), st.integers(0, 10**9))
@examples(60)
def test_what_an_overrun_has_cost_is_told_by_the_overrun_alone(number: int, place: int) -> None:
    """A frame is lost, and the receiver says so: nothing else is found within a second."""
    session = clean(number)
    place %= len(session)
    at = session.pop(place)[0]
    observer = Observer(bitrate=1_000_000)
    told = [finding for now, frame in session[:place] for finding in observer.observe(frame, now).findings]
    told.append(observer.lost("overrun", at))
    told += [
        finding
        for now, frame in session[place:]
        if now <= at + SECOND
        for finding in observer.observe(frame, now).findings
        if finding.rule != "boot-up"
    ]
    assert told == [BusFinding("missing", 0, "frames are missing here: overrun")]


@given(st.integers(0, CLEAN - 1), st.integers(0, 10**9))
@examples(60)
def test_one_lost_frame_is_told_once_at_most(number: int, place: int) -> None:
    session = clean(number)
    del session[place % len(session)]
    assert len([each for each in findings(session) if each.rule == "missing"]) <= 1
