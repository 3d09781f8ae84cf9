"""The bus machine without faults: who sends when, who hears it, queues, acknowledge, load."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import NEVER, SECOND, LocalProtocolError, Time
from canopen_transports.errors import BusState
from canopen_transports.wire import (
    Delivery,
    FaultHappened,
    FaultKind,
    QueueFullError,
    QueueOrder,
    StateReported,
    Wire,
    WireEvent,
    WireMember,
    WireSettings,
    frame_bits,
)
from canopen_transports.wire.member import arbitration
from canopen_transports.wire.wire import MAX_STEPS

BIT = 1_000
SYNC = Frame.parse("080#")
PDO = Frame.parse("201#0011223344556677")


def play(wire: Wire, until: Time = NEVER - 1) -> tuple[list[Delivery], list[WireEvent]]:
    """Let happen what comes until then."""
    deliveries: list[Delivery] = []
    events: list[WireEvent] = []
    while (due := wire.next_deadline()) <= until:
        wire.handle_timeout(due)
        some, more = wire.drain()
        deliveries += some
        events += more
    return deliveries, events


def made(members: int, **settings: object) -> tuple[Wire, list[WireMember]]:
    wire = Wire(WireSettings(**settings))  # type: ignore[arg-type]
    return wire, [wire.join(0) for _ in range(members)]


def order(deliveries: list[Delivery]) -> list[str]:
    return [str(each.frame) for each in deliveries]


def play_length(frame: Frame) -> Time:
    wire, (one, _) = made(2)
    wire.send(one, frame, 0)
    return play(wire)[0][0].at + 3 * BIT


def test_a_frame_takes_its_bits_and_is_there_before_the_intermission() -> None:
    wire, (one, two, three) = made(3)
    wire.send(one, PDO, 500)
    deliveries, events = play(wire)
    assert deliveries == [Delivery(500 + (frame_bits(PDO) - 3) * BIT, PDO, 500, (one,), (two, three))]
    assert events == []
    assert wire.next_deadline() == NEVER
    assert (wire.frames, wire.error_frames, one.sent) == (1, 0, 1)


def test_the_lowest_identifier_goes_first_and_no_frame_is_interrupted() -> None:
    wire, (one, two, three) = made(3)
    wire.send(three, Frame.parse("7FF#"), 0)
    wire.handle_timeout(0)
    wire.send(one, Frame.parse("201#"), 1)
    wire.send(two, Frame.parse("181#"), 2)
    wire.send(three, Frame.parse("080#"), 3)
    assert order(play(wire)[0]) == ["7FF#", "080#", "181#", "201#"]


def test_frames_of_one_time_take_part_together() -> None:
    wire, members = made(3)
    for member, text in zip(members, ("201#", "181#", "080#"), strict=True):
        wire.send(member, Frame.parse(text), 0)
    assert order(play(wire)[0]) == ["080#", "181#", "201#"]


def test_the_next_one_begins_behind_the_intermission() -> None:
    wire, (one, two) = made(2)
    wire.send(one, SYNC, 0)
    wire.send(one, PDO, 0)
    first, second = play(wire)[0]
    assert second.at - first.at == frame_bits(PDO) * BIT
    # One that comes in the intermission waits for its end.
    wire.send(two, SYNC, second.at + BIT)
    assert play(wire)[0][0].at == second.at + (3 + frame_bits(SYNC) - 3) * BIT


ARBITRATION = [
    "000#",
    "000#R",
    "00000000#",
    "00000000#R",
    "001#",
    "0FF#",
    "100#",
    "100#R",
    "04000001#",
    "101#",
    "7FF#",
    "7FF#R",
    "1FFFFFFF#",
]


def test_the_order_of_arbitration() -> None:
    """A data frame before a remote frame, 11 bits before 29 that begin with them."""
    frames = [Frame.parse(text) for text in ARBITRATION]
    assert sorted(frames, key=arbitration) == frames
    for one, other in itertools.pairwise(frames):
        wire, members = made(3)
        wire.send(members[0], other, 0)
        wire.send(members[1], one, 0)
        assert [each.frame for each in play(wire)[0]] == [one, other]


@given(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF), st.booleans(), st.booleans())
def test_arbitration_is_bitwise(short: int, long: int, short_remote: bool, long_remote: bool) -> None:
    """As on the wire, where a dominant 0 wins: 11 bits, RTR 0/1, IDE 0; 11 bits, SRR 1, IDE 1, 18 bits, RTR."""
    standard = Frame(short, b"", 1 if short_remote else 0)
    extended = Frame(long, b"", 3 if long_remote else 2)
    bits = f"{long:029b}"
    on_wire = {
        standard: f"{short:011b}{int(short_remote)}0",
        extended: f"{bits[:11]}11{bits[11:]}{int(long_remote)}",
    }
    assert min(on_wire, key=lambda frame: on_wire[frame]) == min(on_wire, key=arbitration)


def test_equal_frames_go_out_as_one() -> None:
    wire, (one, two, three) = made(3)
    wire.send(one, Frame.parse("705#R1"), 0)
    wire.send(two, Frame.parse("705#R1"), 0)
    deliveries, events = play(wire)
    assert [(each.senders, each.receivers) for each in deliveries] == [((one, two), (three,))]
    assert events == []
    assert (one.queued, two.queued) == (0, 0)


def test_two_producers_of_one_identifier_drive_each_other_bus_off() -> None:
    wire, (one, two, three) = made(3, auto_recovery=False)
    wire.send(one, Frame.parse("181#00"), 0)
    wire.send(two, Frame.parse("181#01"), 0)
    deliveries, events = play(wire)
    assert deliveries == []
    collisions = [each for each in events if isinstance(each, FaultHappened) and each.kind is FaultKind.COLLISION]
    assert len(collisions) == 32  # times 8 is 256
    assert (one.state, two.state) == (BusState.BUS_OFF, BusState.BUS_OFF)
    # 0 00110000001 000 0001 0000000x: they differ in the 27th bit. Stuff bits stand behind the zeros of the ID, those from RTR to
    # the DLC, and those of the data.
    assert collisions[0].at == (27 + 3) * BIT
    lost = [each for each in events if isinstance(each, FaultHappened) and each.kind is FaultKind.NOT_SENT]
    assert [each.frame.data for each in lost] == [b"\0", b"\1"]
    assert three.state is BusState.ACTIVE


def test_frames_of_different_length_collide_in_the_dlc() -> None:
    wire, (one, two, _) = made(3)
    wire.send(one, Frame.parse("555#"), 0)
    wire.send(two, Frame.parse("555#01020304"), 0)
    wire.handle_timeout(0)
    assert wire.next_deadline() == 17 * BIT  # SOF, ID 11, RTR, IDE, r0 and then 0 or 01


# ---- queues ----


def test_a_fifo_keeps_the_order_and_a_priority_queue_does_not() -> None:
    texts = ["601#00", "080#", "201#", "080#"]
    for kind, expected in ((QueueOrder.FIFO, texts), (QueueOrder.PRIORITY, ["080#", "080#", "201#", "601#00"])):
        wire = Wire()
        sender = wire.join(0, order=kind)
        wire.join(0)
        for text in texts:
            wire.send(sender, Frame.parse(text), 0)
        assert sender.order is kind
        assert order(play(wire)[0]) == expected


def test_what_is_on_the_wire_is_not_overtaken_in_its_own_queue() -> None:
    wire = Wire()
    sender = wire.join(0, order=QueueOrder.PRIORITY)
    wire.join(0)
    wire.send(sender, Frame.parse("601#"), 0)
    wire.handle_timeout(0)
    wire.send(sender, SYNC, 1)
    assert order(play(wire)[0]) == ["601#", "080#"]


def test_a_queue_is_bounded() -> None:
    wire = Wire()
    sender = wire.join(0, queue_size=2)
    wire.join(0)
    for _ in range(2):
        wire.send(sender, SYNC, 0)
    assert not sender.has_room
    with pytest.raises(QueueFullError, match="member 0 is full: 2 frames"):
        wire.send(sender, SYNC, 0)
    wire.handle_timeout(0)
    assert not sender.has_room  # the one that is being sent still needs its place
    play(wire)
    assert sender.has_room
    assert sender.sent == 2
    assert repr(sender) == "<WireMember 0: error-active, TEC 0, REC 0, 0 queued>"
    with pytest.raises(LocalProtocolError, match="0 frames"):
        wire.join(0, queue_size=0)


# ---- acknowledge ----


def test_a_lone_sender_repeats_for_ever_and_becomes_error_passive() -> None:
    wire, (one,) = made(1)
    wire.send(one, SYNC, 0)
    deliveries, events = play(wire, SECOND)
    assert deliveries == []
    assert [each.state for each in events if isinstance(each, StateReported)] == [
        BusState.NO_ACKNOWLEDGE,
        BusState.WARNING,
        BusState.PASSIVE,
    ]
    assert one.transmit_errors == 128
    # Each attempt lasts until the ACK slot is over, then flag 6, delimiter 8, intermission 3. The last ones are not computed.
    assert wire.error_frames == 16
    assert wire.next_deadline() == NEVER
    assert wire.load(SECOND) == 1.0
    wire.begin_load(SECOND)
    assert wire.load(2 * SECOND) == 1.0
    other = wire.join(SECOND)
    deliveries, events = play(wire, 2 * SECOND)
    assert [(each.at, each.frame, each.receivers) for each in deliveries] == [
        (SECOND + (frame_bits(SYNC) - 3) * BIT, SYNC, (other,))
    ]
    assert one.state is BusState.WARNING
    assert one.transmit_errors == 127


def test_a_bus_on_which_somebody_unseen_acknowledges() -> None:
    wire, (one,) = made(1, acknowledge=False)
    wire.send(one, SYNC, 0)
    deliveries, events = play(wire)
    assert [each.receivers for each in deliveries] == [()]
    assert events == []


# ---- members, time, load ----


def test_members_come_and_go() -> None:
    wire, (one, two, three) = made(3)
    wire.send(one, PDO, 0)
    wire.send(two, SYNC, 0)
    wire.leave(two, 0)  # before it began: nothing of it goes out
    wire.handle_timeout(0)
    wire.send(one, SYNC, BIT)
    wire.leave(one, 2 * BIT)  # in the middle: this frame still gets out, the next one not
    wire.leave(one, 2 * BIT)
    assert order(play(wire)[0]) == [str(PDO)]
    assert wire.members == (three,)
    with pytest.raises(LocalProtocolError, match="gone"):
        wire.send(one, SYNC, SECOND)
    with pytest.raises(LocalProtocolError, match="not on this wire"):
        wire.bus_off(one, SECOND)


def test_a_late_driver_loses_nothing() -> None:
    runs = []
    for portions in (1, 1000):
        wire, members = made(3)
        for number in range(30):
            wire.send(members[number % 3], Frame(0x100 + number), 0)
        deliveries: list[Delivery] = []
        for step in range(1, portions + 1):
            wire.handle_timeout(step * SECOND // portions)
            deliveries += wire.drain()[0]
        runs.append([(each.at, each.frame) for each in deliveries])
    assert runs[0] == runs[1]
    assert len(runs[0]) == 30


def test_a_command_lets_happen_what_was_due_before_it() -> None:
    wire, (one, two) = made(2)
    wire.send(one, PDO, 0)
    wire.send(two, SYNC, SECOND)  # the PDO is long out
    assert order(wire.drain()[0]) == [str(PDO)]
    assert order(play(wire)[0]) == ["080#"]
    wire.send(two, SYNC, 0)  # a clock that ran back counts as the last time seen
    assert play(wire)[0][0].at > SECOND


def test_early_calls_do_nothing() -> None:
    wire, (one, _) = made(2)
    wire.handle_timeout(5)
    wire.send(one, PDO, 10)
    wire.handle_timeout(10)
    wire.handle_timeout(wire.next_deadline() - 1)
    assert wire.drain() == ([], [])


def test_a_driver_that_is_hours_late_gets_it_in_portions() -> None:
    wire, _ = made(2)
    wire.babble(SYNC, 3600 * SECOND, 0)
    wire.handle_timeout(3600 * SECOND)
    assert len(wire.drain()[0]) <= MAX_STEPS
    assert wire.next_deadline() < 3600 * SECOND


def test_load() -> None:
    wire, (one, _) = made(2, bitrate=500_000)
    assert wire.load(0) == 0.0
    wire.send(one, PDO, 0)
    play(wire)
    busy = frame_bits(PDO) * 2_000
    assert wire.load(4 * busy) == 0.25
    wire.begin_load(4 * busy)
    assert wire.load(5 * busy) == 0.0


def test_a_bit_rate_is_positive() -> None:
    with pytest.raises(LocalProtocolError, match="bit rate"):
        Wire(WireSettings(bitrate=0))
