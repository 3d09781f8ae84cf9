"""The bus machine under any sequence of commands, at any bit rate, driven in time or late: what holds always."""

from __future__ import annotations

from copy import deepcopy

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from canopen_proto import COMPILED
from canopen_proto.frame import Frame
from canopen_proto.machine import NEVER, SECOND, Time
from canopen_transports.errors import BusState
from canopen_transports.wire import FaultHappened, FaultKind, FaultRates, QueueOrder, Wire, WireMember, WireSettings
from tests.examples import examples

SOME = FaultRates(loss=0.1, repetition=0.1, corruption=0.3, delay=0.1)
CALM = FaultRates()
MEMBERS = 5


class AnyBus(RuleBasedStateMachine):
    """Each frame has the number of its sending in its data, so that each one's fate is known."""

    @initialize(
        bitrate=st.sampled_from([10_000, 83_333, 1_000_000]), seed=st.integers(0, 99), ack=st.booleans(), auto=st.booleans()
    )
    def begin(self, bitrate: int, seed: int, ack: bool, auto: bool) -> None:
        settings = WireSettings(bitrate=bitrate, seed=seed, acknowledge=ack, auto_recovery=auto)
        self.now: Time = SECOND
        self.wire = Wire(settings, self.now)
        self.auto = auto
        self.members: list[WireMember] = []
        self.sent: dict[int, WireMember] = {}
        self.heard: dict[int, set[int]] = {}
        self.lost: set[int] = set()
        self.last: Time = 0
        self.join(QueueOrder.FIFO)

    def pick(self, number: int) -> WireMember:
        return self.members[number % len(self.members)]

    @rule(order=st.sampled_from(QueueOrder))
    @precondition(lambda self: len(self.members) < MEMBERS)
    def join(self, order: QueueOrder) -> None:
        self.members.append(self.wire.join(self.now, order=order, queue_size=8))

    @rule(who=st.integers(0, MEMBERS))
    @precondition(lambda self: len(self.members) > 1)
    def leave(self, who: int) -> None:
        member = self.pick(who)
        self.members.remove(member)
        self.wire.leave(member, self.now)
        self.lost |= {number for number, sender in self.sent.items() if sender is member}

    @rule(who=st.integers(0, MEMBERS), can_id=st.integers(0, 15), size=st.integers(4, 8))
    def send(self, who: int, can_id: int, size: int) -> None:
        self.wire.handle_timeout(self.now)  # as a driver does, who then looks whether it may
        member = self.pick(who)
        if member.has_room and member.state is not BusState.BUS_OFF:
            number = len(self.sent)
            self.sent[number] = member
            self.wire.send(member, Frame(can_id, number.to_bytes(4, "little").ljust(size, b"\0")), self.now)

    @rule(who=st.integers(0, MEMBERS))
    def bus_off(self, who: int) -> None:
        self.wire.bus_off(self.pick(who), self.now)

    @rule(who=st.integers(0, MEMBERS))
    def restart(self, who: int) -> None:
        self.wire.restart(self.pick(who), self.now)

    @rule(half=st.sets(st.integers(0, MEMBERS)))
    def cut_or_mend(self, half: set[int]) -> None:
        if self.wire.is_cut:
            self.wire.mend(self.now)
        else:
            self.wire.cut([self.pick(number) for number in half], self.now)

    @rule(bits=st.integers(1, 1_000), can_id=st.sampled_from([0, 20]))
    def babble(self, bits: int, can_id: int) -> None:
        self.wire.babble(Frame(can_id, bytes(3)), self.now + self.wire.time_of(bits), self.now)

    @rule(rates=st.sampled_from([SOME, CALM]))
    def disturb(self, rates: FaultRates) -> None:
        self.wire.rates = rates

    @rule(bits=st.integers(0, 5_000), in_time=st.booleans())
    def let_time_pass(self, bits: int, in_time: bool) -> None:
        """Called whenever something is due, or only at the end."""
        end = self.now + self.wire.time_of(bits)
        while in_time and (due := self.wire.next_deadline()) <= end:
            before = self.progress()
            self.wire.handle_timeout(due)
            self.look()
            assert self.wire.next_deadline() > due or self.progress() != before
        self.now = end
        self.wire.handle_timeout(end)

    def progress(self) -> tuple[object, ...]:
        wire = self.wire
        states = [(member.state, member.recovery) for member in wire.members]
        return wire.frames, wire.error_frames, self.last, [segment.current for segment in wire._segments], states

    @invariant()
    def look(self) -> None:
        """Take what came out."""
        deliveries, events = self.wire.drain()
        for event in events:
            if isinstance(event, FaultHappened) and len(event.frame.data) > 3 and event.kind is FaultKind.NOT_SENT:
                self.lost.add(int.from_bytes(event.frame.data[:4], "little"))
        for delivery in deliveries:
            assert delivery.at >= self.last
            assert delivery.at >= delivery.queued
            assert not set(delivery.senders) & set(delivery.receivers)
            self.last = delivery.at
            if len(delivery.frame.data) > 3:
                number = int.from_bytes(delivery.frame.data[:4], "little")
                assert self.sent[number] in delivery.senders
                self.heard.setdefault(number, set()).update(member.number for member in delivery.receivers)

    @precondition(lambda self: not COMPILED)  # compiled frames cannot be copied
    @rule()
    def look_ahead(self) -> None:
        """Nothing comes out before the time that `next_output` says; of calm wires, something does then."""
        foreseen, copy = self.wire.next_output(), deepcopy(self.wire)
        assert foreseen >= self.wire.next_deadline()
        copy.drain()
        while (due := copy.next_deadline()) < foreseen:
            copy.handle_timeout(due)
            assert copy.drain() == ([], [])
        if due == foreseen < NEVER and foreseen > self.wire.next_deadline():
            copy.handle_timeout(due)
            assert copy.drain()[0]

    @invariant()
    def counters_and_states_agree(self) -> None:
        for member in self.wire.members:
            worst = max(member.transmit_errors, member.receive_errors)
            assert 0 <= member.receive_errors < 256
            if member.state is BusState.BUS_OFF:
                assert member.transmit_errors >= 256
                assert member.queued == 0
                assert member.recovery > 0 or not self.auto
            else:
                expected = BusState.ACTIVE if worst < 96 else BusState.WARNING if worst < 128 else BusState.PASSIVE
                assert (member.state, member.recovery) == (expected, 0)

    @invariant()
    def nobody_who_has_something_to_say_is_forgotten(self) -> None:
        for segment in self.wire._segments:
            wanting = {member for member in segment.members if member.queued}
            assert wanting == set(segment.wanting)
            if wanting and segment.unheard_since is None:
                assert segment.current is not None or segment.begins < NEVER

    def teardown(self) -> None:
        """In the end, with all faults over, all that was sent and not lost got out."""
        if not hasattr(self, "wire"):
            return
        self.wire.rates = CALM
        self.wire.mend(self.now)
        for _ in range(2):
            self.members.append(self.wire.join(self.now))
        for _ in range(2):  # what waits may drive one bus-off once more: by a collision
            for member in self.members:
                self.wire.restart(member, self.now)
            self.let_time_pass(100_000, True)
        self.look()
        assert all(member.queued == 0 for member in self.wire.members)
        assert {member.state for member in self.members} <= {BusState.ACTIVE, BusState.WARNING, BusState.PASSIVE}
        assert set(self.sent) - self.lost <= set(self.heard)
        assert 0 <= self.wire.load(self.now) <= 2.0  # two halves


TestAnyBus = AnyBus.TestCase
TestAnyBus.settings = examples(60, steps=40)
