"""The observer accuses nobody because of its recorder: a clean recording, however damaged, shows only that it is damaged."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, SECOND
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


# ---- where nothing was heard at all ----

NODES = (3, 4, 5)


def beats(begin: int, end: int, nodes: tuple[int, ...] = NODES, each: int = 100) -> Session:
    """Heartbeats of operational nodes, from one ms to another."""
    return [
        ((at + node) * MILLISECOND, Frame.parse(f"{0x700 + node:03X}#05")) for at in range(begin, end, each) for node in nodes
    ]


def test_a_pause_of_the_whole_bus_accuses_no_node() -> None:
    """A recorder that stood still looks the same: one cause, told once."""
    (told,) = findings(beats(0, 3000) + beats(13_000, 16_000))
    assert (told.rule, told.node_id, told.is_certain) == ("missing", 0, False)
    assert "no frame at all for 10.1 s, and nodes 3, 4, 5 were due" in told.text


def test_nodes_that_stay_silent_behind_a_pause_are_late() -> None:
    """Two drives with one supply: a third node, which is slow, speaks for itself all the time."""
    told = findings(beats(0, 3000) + beats(4000, 9000, (5,), 1000))
    assert [each.rule for each in told[:1]] == ["missing"]
    assert sorted(each.node_id for each in told if each.rule == "late heartbeat" and each.node_id != 5) == [3, 4]


def test_a_pause_is_no_excuse_for_a_node_that_was_late_before_it() -> None:
    told = findings(beats(0, 3000) + beats(3000, 3300, (4, 5)) + beats(13_000, 16_000))
    assert [(each.rule, each.node_id) for each in told] == [("late heartbeat", 3), ("missing", 0)]


def test_pdos_that_a_pause_of_the_whole_bus_lacks_are_not_late() -> None:
    writes = ("2F001802FE000000", "2B00180564000000", "23001A0110004160", "2F001A0001000000")  # each 100 ms, a statusword
    texts = [f"60{node}#{write} 58{node}#60{write[2:8]}00000000" for node in (3, 4) for write in writes]
    session = [(at * MILLISECOND, Frame.parse(text)) for at, text in enumerate(" ".join(texts).split())]
    sent = [Frame.parse(text) for text in ("703#05", "704#05", "184#3702", "183#3702")]
    session += [((at + 2 * place) * MILLISECOND, frame) for at in range(100, 3000, 100) for place, frame in enumerate(sent)]
    later = [(at + 10 * SECOND, frame) for at, frame in session if at >= 100 * MILLISECOND]
    assert [each.rule for each in findings(session + later)] == ["missing"]
    going_on = [(at + 2900 * MILLISECOND, frame) for at, frame in session if at >= 100 * MILLISECOND and frame is not sent[3]]
    assert [(each.rule, each.node_id) for each in findings(session + going_on)] == [("late pdo", 3)]


@pytest.mark.parametrize("nodes", [(3,), NODES])
def test_what_an_overrun_may_have_cost_makes_no_node_late(nodes: tuple[int, ...]) -> None:
    """The process was stopped for ten seconds, and its queue was full: who was silent then, nobody knows."""
    observer = Observer()
    heard = [each for at, frame in beats(0, 3000, nodes) for each in observer.observe(frame, at).findings]
    assert heard == []
    observer.lost("the receive queue was full", 13 * SECOND)
    assert [each for at, frame in beats(13_050, 16_000, nodes) for each in observer.observe(frame, at).findings] == []
    assert [each.rule for each in observer.observe(Frame.parse("080#"), 20 * SECOND).findings][-1:] in (
        ["late heartbeat"] if nodes == (3,) else ["missing"],
    )
