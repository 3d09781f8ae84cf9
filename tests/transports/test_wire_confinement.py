"""The bus machine's fault confinement: error counters, error-passive, bus-off and the way back."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator

import pytest

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, LocalProtocolError
from canopen_transports.errors import BusState
from canopen_transports.wire import FaultHappened, FaultKind, FaultRates, StateReported, Wire, WireMember, frame_bits
from tests.transports.test_wire_arbitration import BIT, PDO, SYNC, made, order, play, play_length
from tests.transports.test_wire_faults import kinds, states

# ---- error counters ----


def test_a_bus_that_is_disturbed_all_the_time() -> None:
    """The sender's counter rises by 8 each time: at 96 warning, at 128 passive, at 256 bus-off. The others are not to blame."""
    wire, (one, two, three) = made(3, rates=FaultRates(corruption=1.0), seed=1)
    wire.send(one, PDO, 0)
    wire.send(one, SYNC, 0)
    deliveries, events = play(wire, 10 * MILLISECOND)
    assert deliveries == []
    assert [state for number, state in states(events) if number == 0] == [
        BusState.WARNING,
        BusState.PASSIVE,
        BusState.BUS_OFF,
        BusState.ACTIVE,
    ]
    assert Counter(kinds(events)) == {FaultKind.CORRUPTION: 32, FaultKind.NOT_SENT: 2}
    assert [str(each.frame) for each in events if isinstance(each, FaultHappened) and each.kind is FaultKind.NOT_SENT] == [
        str(PDO),
        "080#",
    ]
    assert max(two.receive_errors, three.receive_errors) > 96


def blame(wire: Wire, member: WireMember, *, transmit: int = 0, receive: int = 0) -> None:
    """Give a member such error counters, as that many errors would."""
    wire._confinement.count(wire._segments[0], member, 0, transmit=transmit, receive=receive)
    wire.drain()


def counters(*members: WireMember) -> list[tuple[int, int]]:
    """TEC and REC of each."""
    return [(member.transmit_errors, member.receive_errors) for member in members]


def hit_at(victim: int) -> Iterator[tuple[Wire, list[WireMember]]]:
    """Wires of four members on which the first error of a frame of member 0 is seen first by that member."""
    for seed in range(100):
        wire, members = made(4, rates=FaultRates(corruption=1.0), seed=seed)
        wire.send(members[0], PDO, 0)
        wire.handle_timeout(0)
        sending = wire._segments[0].current
        assert sending is not None
        if sending.victim is members[victim]:
            yield wire, members


def test_who_sees_an_error_first_counts_9_and_the_others_1() -> None:
    """A receiver's flag makes the others send theirs behind it; that is how it knows that it was the first (rule b, +8)."""
    wire, members = next(hit_at(2))
    wire.handle_timeout(wire.next_deadline())
    assert counters(*members) == [(8, 0), (0, 1), (0, 9), (0, 1)]


def test_an_error_of_the_sender_is_the_sender_s() -> None:
    """All receivers see its flag at the same bit, and send theirs together: nobody was the first."""
    wire, members = next(hit_at(0))
    wire.handle_timeout(wire.next_deadline())
    assert counters(*members) == [(8, 0), (0, 1), (0, 1), (0, 1)]


def test_a_frame_takes_one_away_from_all() -> None:
    wire, members = made(3)
    blame(wire, members[0], transmit=8, receive=5)
    blame(wire, members[1], transmit=8, receive=5)
    wire.send(members[0], PDO, 0)
    play(wire)
    assert counters(*members) == [(7, 5), (8, 4), (0, 0)]


@pytest.mark.parametrize(
    ("transmit", "receive", "state"),
    [
        (95, 95, BusState.ACTIVE),
        (96, 0, BusState.WARNING),
        (0, 96, BusState.WARNING),
        (127, 127, BusState.WARNING),
        (128, 0, BusState.PASSIVE),
        (0, 128, BusState.PASSIVE),
        (0, 1000, BusState.PASSIVE),
        (255, 255, BusState.PASSIVE),
        (256, 0, BusState.BUS_OFF),
    ],
)
def test_the_limits_of_the_counters(transmit: int, receive: int, state: BusState) -> None:
    wire, (one, _) = made(2)
    blame(wire, one, transmit=transmit, receive=receive)
    assert one.state is state


def test_an_error_passive_receiver_disturbs_nobody_but_misses_the_frame() -> None:
    """Its flag is recessive. It counts the error, and what it missed takes nothing away."""
    missed = 0
    for seed in range(20):
        wire, (one, two, three) = made(3, rates=FaultRates(corruption=1.0), seed=seed)
        blame(wire, two, receive=130)
        wire.send(one, PDO, 0)
        wire.handle_timeout(0)
        wire.handle_timeout(wire.next_deadline())
        deliveries, events = wire.drain()
        if kinds(events) == [FaultKind.LOSS]:  # else somebody else saw the error
            missed += 1
            assert [each.receivers for each in deliveries] == [(three,)]
            assert (two.receive_errors, two.state) == (131, BusState.PASSIVE)
    assert missed > 3


def test_an_error_passive_receiver_that_takes_a_frame_is_error_active_again() -> None:
    wire, (one, two) = made(2)
    blame(wire, two, receive=200)
    wire.send(one, PDO, 0)
    (report,) = play(wire)[1]
    assert isinstance(report, StateReported)
    assert (two.receive_errors, report.state) == (119, BusState.WARNING)


def test_a_repeated_frame_was_taken_all_the_same() -> None:
    wire, (one, two) = made(2, rates=FaultRates(repetition=1.0))
    blame(wire, two, receive=7)
    wire.send(one, PDO, 0)
    wire.handle_timeout(0)
    wire.rates = FaultRates()
    wire.handle_timeout(wire.next_deadline())
    assert counters(one, two) == [(8, 0), (0, 6)]


def test_counters_return() -> None:
    wire, (one, two, three) = made(3, rates=FaultRates(corruption=1.0), seed=1)
    wire.send(one, PDO, 0)
    play(wire, 2 * MILLISECOND)
    assert one.state is BusState.PASSIVE
    wire.rates = FaultRates()
    for number in range(300):
        wire.send(one, PDO, SECOND + number * MILLISECOND)
    _, events = play(wire)
    assert (one.transmit_errors, two.receive_errors, three.receive_errors) == (0, 0, 0)
    assert [state for number, state in states(events) if number == 0] == [BusState.WARNING, BusState.ACTIVE]


def test_an_error_passive_member_waits_8_bits_after_it_has_sent() -> None:
    wire, (one, two) = made(2)
    blame(wire, one, transmit=200)
    for _ in range(3):
        wire.send(one, SYNC, 0)
    first, second, _ = play(wire)[0]
    assert second.at - first.at == play_length(SYNC) + 8 * BIT
    wire.send(one, SYNC, SECOND)
    wire.send(one, SYNC, SECOND)
    wire.send(two, Frame.parse("7FF#"), SECOND)
    assert order(play(wire)[0]) == ["080#", "7FF#", "080#"]  # the other one uses the gap


def test_the_frame_that_makes_it_error_active_again_is_the_last_to_be_waited_for() -> None:
    wire, (one, _) = made(2)
    blame(wire, one, transmit=129)
    for _ in range(3):
        wire.send(one, SYNC, 0)
    first, second, third = play(wire)[0]
    assert (second.at - first.at, third.at - second.at) == (play_length(SYNC) + 8 * BIT, play_length(SYNC))


def test_an_error_passive_member_waits_before_it_repeats() -> None:
    """Error flags 12 bits, delimiter 8, intermission 3, suspend transmission 8: the 31 bits that the analysis counts."""
    wire, (one, two) = made(2, rates=FaultRates(corruption=1.0))
    blame(wire, one, transmit=128)
    wire.send(one, PDO, 0)
    wire.handle_timeout(0)
    broken = wire.next_deadline()
    wire.rates = FaultRates()
    (delivery,), _ = play(wire)
    assert delivery.at - broken == 31 * BIT + play_length(PDO) - 3 * BIT
    assert delivery.receivers == (two,)


def test_a_frame_without_acknowledge_ends_with_its_ack_slot() -> None:
    """All its stuffed bits, CRC delimiter and ACK slot; then the flag of its sender 6, delimiter 8, intermission 3."""
    wire, (one,) = made(1)
    wire.send(one, SYNC, 0)
    wire.handle_timeout(0)
    end = (frame_bits(SYNC) - 13 + 2) * BIT
    for attempt in range(3):
        assert wire.next_deadline() == end + attempt * (end + 17 * BIT)
        wire.handle_timeout(wire.next_deadline())
        assert counters(one) == [((attempt + 1) * 8, 0)]
        assert wire.next_deadline() == (attempt + 1) * (end + 17 * BIT)
        wire.handle_timeout(wire.next_deadline())


# ---- bus-off ----


def test_bus_off_and_back_after_128_times_11_recessive_bits() -> None:
    wire, (one, two, three) = made(3)
    blame(wire, one, receive=50)
    wire.send(one, PDO, 0)
    wire.send(one, SYNC, 0)
    wire.handle_timeout(0)
    wire.bus_off(one, 10 * BIT)
    assert one.state is BusState.BUS_OFF
    with pytest.raises(LocalProtocolError, match="bus-off"):
        wire.send(one, SYNC, 10 * BIT)
    wire.send(two, SYNC, 10 * BIT)
    deliveries, events = play(wire)
    assert [each.receivers for each in deliveries] == [(three,)]
    assert kinds(events) == [FaultKind.CORRUPTION, FaultKind.NOT_SENT, FaultKind.NOT_SENT]
    reports = [each for each in events if isinstance(each, StateReported)]
    assert [(each.member, each.state) for each in reports] == [(one, BusState.BUS_OFF), (one, BusState.ACTIVE)]
    # The frame of `two` ends with 11 recessive bits; the other 127 times are waited for.
    assert reports[1].at == deliveries[0].at + 3 * BIT + 127 * 11 * BIT
    assert counters(one) == [(0, 0)]
    wire.send(one, SYNC, SECOND)
    assert len(play(wire)[0]) == 1


def test_on_a_bus_that_was_idle_for_long_recovery_takes_its_time_all_the_same() -> None:
    wire, (one, two, _) = made(3)
    wire.bus_off(one, SECOND)
    wire.bus_off(two, SECOND + 64 * 11 * BIT)
    reports = [each for each in play(wire)[1] if isinstance(each, StateReported)]
    assert [(each.at - SECOND, each.member.number, each.state) for each in reports] == [
        (0, 0, BusState.BUS_OFF),
        (64 * 11 * BIT, 1, BusState.BUS_OFF),
        (128 * 11 * BIT, 0, BusState.ACTIVE),
        (192 * 11 * BIT, 1, BusState.ACTIVE),
    ]


def test_on_a_busy_bus_recovery_counts_frames() -> None:
    wire, (one, two, _) = made(3)
    wire.bus_off(one, 0)
    frames = 0
    for number in itertools.count():
        if one.state is BusState.ACTIVE:
            break
        wire.send(two, SYNC, number * (play_length(SYNC) + 5 * BIT))
        frames += len(play(wire, number * (play_length(SYNC) + 5 * BIT) + play_length(SYNC))[0])
    assert frames in (128, 129)


def test_recovery_may_be_left_to_the_host() -> None:
    wire, (one, _) = made(2, auto_recovery=False)
    wire.bus_off(one, 0)
    assert wire.next_deadline() == NEVER
    assert states(wire.drain()[1]) == [(0, BusState.BUS_OFF)]
    wire.restart(one, SECOND)
    wire.restart(one, SECOND)
    (report,) = play(wire)[1]
    assert report.at == SECOND + 128 * 11 * BIT
    wire.restart(one, 2 * SECOND)  # of one that is not bus-off: nothing
    assert wire.next_deadline() == NEVER


def test_a_member_leaves_while_it_is_bus_off() -> None:
    wire, (one, _) = made(2)
    wire.bus_off(one, 0)
    wire.leave(one, 1)
    assert play(wire)[1][1:] == []
