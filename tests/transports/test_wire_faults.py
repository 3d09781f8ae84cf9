"""The bus machine with faults: what each of them does, a babbling node, a cut cable."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import MICROSECOND, MILLISECOND, SECOND, LocalProtocolError
from canopen_transports.errors import BusState
from canopen_transports.wire import (
    Delivery,
    FaultHappened,
    FaultKind,
    FaultRates,
    StateReported,
    Wire,
    WireEvent,
    WireSettings,
)
from tests.examples import examples
from tests.transports.test_wire_arbitration import BIT, PDO, SYNC, made, order, play, play_length


def kinds(events: list[WireEvent]) -> list[FaultKind]:
    return [each.kind for each in events if isinstance(each, FaultHappened)]


def states(events: list[WireEvent]) -> list[tuple[int, BusState]]:
    return [(each.member.number, each.state) for each in events if isinstance(each, StateReported)]


def test_a_frame_is_lost_at_one_receiver() -> None:
    wire, (one, two, three) = made(3, rates=FaultRates(loss=1.0))
    wire.send(one, PDO, 0)
    (delivery,), (fault,) = play(wire)
    assert isinstance(fault, FaultHappened)
    assert (fault.kind, fault.frame, fault.at) == (FaultKind.LOSS, PDO, delivery.at)
    assert {fault.member, *delivery.receivers} == {two, three}
    assert len(delivery.receivers) == 1
    assert one.sent == 1


def test_a_frame_is_repeated() -> None:
    wire, (one, two) = made(2, rates=FaultRates(repetition=1.0))
    wire.send(one, PDO, 0)
    wire.handle_timeout(0)
    wire.rates = FaultRates()  # what is on the wire is decided
    deliveries, events = play(wire)
    assert [(each.frame, each.receivers) for each in deliveries] == [(PDO, (two,))] * 2
    assert kinds(events) == [FaultKind.REPETITION]
    assert one.transmit_errors == 7
    assert (wire.frames, wire.error_frames) == (2, 1)


def test_a_frame_is_corrupted_and_sent_again() -> None:
    wire, (one, two, three) = made(3, rates=FaultRates(corruption=1.0), seed=4)
    wire.send(one, PDO, 0)
    wire.handle_timeout(0)
    broken = wire.next_deadline()
    wire.rates = FaultRates()
    (delivery,), events = play(wire)
    assert kinds(events) == [FaultKind.CORRUPTION]
    assert delivery.receivers == (two, three)
    # The error frame of 20 bits and the intermission, then the whole frame but for its own intermission.
    assert delivery.at == broken + 23 * BIT + play_length(PDO) - 3 * BIT
    assert one.transmit_errors == 7
    assert sorted((two.receive_errors, three.receive_errors)) in ([0, 0], [0, 8])


def test_a_frame_is_late_and_what_follows_does_not_overtake_it() -> None:
    wire, (one, two, three) = made(3, rates=FaultRates(delay=1.0, delay_time=10 * MILLISECOND))
    wire.send(one, Frame.parse("201#01"), 0)
    wire.handle_timeout(0)
    for number in range(2, 9):
        wire.send(one, Frame(0x201, bytes((number,))), 0)
    deliveries, events = play(wire, 100 * MICROSECOND)
    wire.rates = FaultRates()
    later, more = play(wire)
    deliveries += later
    assert kinds([*events, *more]).count(FaultKind.DELAY) in (1, 2)
    for member in (two, three):
        assert [each.frame.data[0] for each in deliveries if member in each.receivers] == list(range(1, 9))
    assert [each.at for each in deliveries] == sorted(each.at for each in deliveries)


def test_with_nobody_to_hear_it_nothing_is_lost_or_late() -> None:
    wire, (one,) = made(1, acknowledge=False, rates=FaultRates(loss=0.5, delay=0.5))
    for _ in range(10):
        wire.send(one, SYNC, 0)
    deliveries, events = play(wire)
    assert len(deliveries) == 10
    assert events == []


@pytest.mark.parametrize("rates", [{"loss": -0.1}, {"loss": 0.6, "delay": 0.6}, {"delay_time": 0}])
def test_rates_make_sense(rates: dict[str, float]) -> None:
    with pytest.raises(LocalProtocolError):
        FaultRates(**rates)  # type: ignore[arg-type]


# ---- babbling ----


def test_a_babbling_node_takes_what_is_below_it() -> None:
    wire, (one, two) = made(2)
    babbler = wire.babble(Frame.parse("100#"), 10 * MILLISECOND, 0)
    wire.send(one, SYNC, MILLISECOND)
    wire.send(two, PDO, MILLISECOND)
    deliveries, events = play(wire)
    assert events == []
    texts = order(deliveries)
    assert texts[-1] == str(PDO)
    assert texts.index("080#") < 30
    assert Counter(texts)["100#"] > 150
    assert babbler not in wire.members
    assert not any(babbler in each.receivers for each in deliveries)
    assert wire.load(deliveries[-1].at + 3 * BIT) == 1.0


def test_a_babbling_node_that_is_disturbed_ends_bus_off() -> None:
    wire, (_, _) = made(2, rates=FaultRates(corruption=1.0))
    babbler = wire.babble(SYNC, SECOND, 0)
    _, events = play(wire, SECOND)
    assert babbler not in wire.members
    assert (babbler.number, BusState.BUS_OFF) in states(events)


# ---- a cut cable ----


def test_a_cut_cable_makes_two_buses() -> None:
    wire, (one, two, three, four) = made(4)
    wire.cut((one, two), 0)
    assert wire.is_cut
    wire.send(one, SYNC, 0)
    wire.send(three, PDO, 0)
    deliveries, _ = play(wire)
    assert {(each.frame, each.receivers) for each in deliveries} == {(SYNC, (two,)), (PDO, (four,))}
    with pytest.raises(LocalProtocolError, match="cut already"):
        wire.cut((one,), SECOND)
    wire.mend(SECOND)
    wire.mend(SECOND)
    assert not wire.is_cut
    wire.send(one, SYNC, SECOND)
    assert play(wire)[0][0].receivers == (two, three, four)


def test_what_is_on_the_wire_when_it_is_cut_or_mended_is_sent_again() -> None:
    wire, (one, two, three) = made(3)
    wire.send(one, PDO, 0)
    wire.handle_timeout(0)
    wire.cut((one,), 20 * BIT)
    deliveries, events = play(wire, MILLISECOND)
    assert deliveries == []  # nobody is left to acknowledge it
    assert kinds(events) == [FaultKind.CUT]
    assert (0, BusState.NO_ACKNOWLEDGE) in states(events)
    wire.mend(MILLISECOND)
    deliveries, events = play(wire, 3 * MILLISECOND)
    assert [(each.frame, each.receivers) for each in deliveries] == [(PDO, (two, three))]


def test_a_member_leaves_just_before_the_cut() -> None:
    wire, (one, two, three) = made(3)
    wire.send(one, PDO, 0)
    wire.handle_timeout(0)
    wire.leave(one, 5 * BIT)
    wire.cut((two,), 6 * BIT)
    assert wire.members == (two, three)
    assert play(wire)[0] == []


def test_recovery_goes_on_when_the_cable_is_cut() -> None:
    wire, (one, two, three) = made(3)
    wire.bus_off(one, 0)
    wire.cut((one,), 50 * 11 * BIT)
    wire.join(51 * 11 * BIT)
    reports = [each for each in play(wire)[1] if isinstance(each, StateReported)]
    assert reports[-1].at == 128 * 11 * BIT + 0 * BIT
    assert (two.state, three.state) == (BusState.ACTIVE, BusState.ACTIVE)


# ---- one seed, one trace ----


def trace(seed: int, rates: FaultRates, load: list[tuple[int, int, int]]) -> list[object]:
    wire = Wire(WireSettings(bitrate=500_000, rates=rates, seed=seed))
    members = [wire.join(0) for _ in range(4)]
    told: list[object] = []
    for number, (time, member, size) in enumerate(sorted(load)):
        sender = members[member]
        wire.handle_timeout(time * 50 * MICROSECOND)
        if sender.has_room and sender.state is not BusState.BUS_OFF:
            wire.send(sender, Frame(0x100 * member + number % 8, bytes((number % 256,)) * size), time * 50 * MICROSECOND)
    deliveries, events = wire.drain()
    more, later = play(wire, SECOND)
    told += [(each.at, each.frame, [member.number for member in each.receivers]) for each in [*deliveries, *more]]
    told += [(each.at, each[1], each.member.number) for each in [*events, *later]]
    return told


LOAD = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 3), st.integers(0, 8)), max_size=80)
SOME = FaultRates(loss=0.1, repetition=0.1, corruption=0.2, delay=0.1)


@examples(30)
@given(st.integers(0, 100), LOAD)
def test_one_seed_gives_one_trace(seed: int, load: list[tuple[int, int, int]]) -> None:
    assert trace(seed, SOME, load) == trace(seed, SOME, load)


@examples(30)
@given(st.integers(0, 100), LOAD)
def test_every_frame_that_does_not_arrive_once_everywhere_is_told_of(seed: int, load: list[tuple[int, int, int]]) -> None:
    wire = Wire(WireSettings(rates=SOME, seed=seed))
    members = [wire.join(0) for _ in range(4)]
    sent: list[tuple[int, Frame]] = []
    deliveries: list[Delivery] = []
    events: list[WireEvent] = []
    for number, (time, member, size) in enumerate(sorted(load)):
        now = time * 50 * MICROSECOND
        wire.handle_timeout(now)
        if members[member].has_room and members[member].state is not BusState.BUS_OFF:
            frame = Frame(0x100 * member + number % 8, number.to_bytes(2, "little") + bytes(size)[:6])
            wire.send(members[member], frame, now)
            sent.append((member, frame))
    some, more = play(wire)
    first, second = wire.drain()
    deliveries += [*some, *first]
    events += [*more, *second]
    heard = Counter((each.frame, member.number) for each in deliveries for member in each.receivers)
    told: Counter[tuple[Frame, int]] = Counter()
    repeated: Counter[Frame] = Counter()
    for event in events:
        if isinstance(event, FaultHappened):
            if event.kind is FaultKind.LOSS:
                told[event.frame, event.member.number] += 1
            elif event.kind is FaultKind.REPETITION:
                repeated[event.frame] += 1
            elif event.kind is FaultKind.NOT_SENT:
                repeated[event.frame] -= 1
    for sender, frame in sent:
        for member in range(4):
            expected = 0 if member == sender else 1 + repeated[frame] - told[frame, member]
            assert heard[frame, member] == expected
    for sender in range(4):
        for member in members:
            numbers = [each.frame.data[0] for each in deliveries if member in each.receivers and each.frame.can_id >> 8 == sender]
            assert numbers == sorted(numbers)
