"""The test bus itself: order, faults, time."""

from __future__ import annotations

import pytest

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, Event, Machine, Outbox, Time
from canopen_proto.network import Network
from tests.core.bus import CAN_FATES, Bus, Fate


class Heard(Event):
    __slots__ = ("at", "text")
    __match_args__ = ("node_id", "text", "at")

    def __init__(self, node_id: int, text: str, at: Time) -> None:
        self.node_id = node_id
        self.text = text
        self.at = at


class Ear(Machine):
    """Hears two CAN-IDs, speaks when told, wakes when armed."""

    def __init__(self, out: Outbox, keys: tuple[int, ...] = (0x123, 0x456)) -> None:
        super().__init__(out)
        self.keys = keys

    def can_ids(self) -> tuple[int, ...]:
        return self.keys

    def receive(self, frame: Frame, now: Time) -> None:
        self.out.events.append(Heard(0, str(frame), now))

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        self.deadline = NEVER
        self.out.frames.append(Frame(0x123, b"\x01"))

    def say(self, *texts: str) -> None:
        self.out.frames += [Frame.parse(text) for text in texts]

    def arm(self, deadline: Time) -> None:
        self._arm(deadline)


def heard(bus: Bus) -> list[str]:
    return [report.text for report in bus.take_events(Heard)]


def test_every_participant_but_the_sender_hears_what_it_asked_for() -> None:
    bus = Bus()
    speaker = bus.attach(Ear(Outbox()))
    other = bus.attach(Ear(Outbox()))
    bus.attach(Ear(Outbox(), keys=(0x456,)))
    speaker.say("123#01", "456#02", "789#")
    bus.settle()
    assert heard(bus) == ["123#01", "456#02", "456#02"]
    bus.detach(other)
    bus.send("123#03")
    bus.settle()
    assert heard(bus) == ["123#03"]
    assert bus.trace() == ["123#01", "456#02", "789#", "123#03"]


def test_a_network_is_a_participant() -> None:
    network = Network()
    network.attach(Ear(network.out))
    bus = Bus()
    bus.attach(network)
    bus.send("123#01")
    bus.settle()
    assert heard(bus) == ["123#01"]


def test_deadlines_are_met_and_frames_come_before_deadlines_of_the_same_time() -> None:
    bus = Bus(delay=(MILLISECOND, MILLISECOND))
    first = bus.attach(Ear(Outbox()))
    bus.attach(Ear(Outbox()))
    first.arm(MILLISECOND)
    bus.send("456#")
    bus.run(10 * MILLISECOND)
    assert bus.now == 10 * MILLISECOND
    assert [(report.text, report.at) for report in bus.take_events(Heard)] == [
        ("456#", MILLISECOND),
        ("456#", MILLISECOND),
        ("123#01", 2 * MILLISECOND),
    ]


def test_order_is_kept_within_a_can_id_whatever_the_delay() -> None:
    texts = [f"{can_id}#{n:02X}" for n in range(30) for can_id in ("123", "456")]
    bus = Bus(seed=3, delay=(0, 50 * MILLISECOND))
    bus.attach(Ear(Outbox()))
    for text in texts:
        bus.send(text)
    bus.settle()
    arrived = heard(bus)
    assert arrived != texts
    for can_id in ("123", "456"):
        assert [text for text in arrived if text.startswith(can_id)] == [text for text in texts if text.startswith(can_id)]


def test_fates_are_told_frame_by_frame() -> None:
    bus = Bus(fates=[Fate.LOST, Fate.COPIED, Fate.LATE, Fate.COPIED_LATE], late=(SECOND, SECOND))
    bus.attach(Ear(Outbox()))
    for n in range(5):
        bus.send(f"123#{n:02X}")
    bus.settle()
    assert heard(bus) == ["123#01", "123#01", "123#03", "123#04", "123#02", "123#03"]


def test_fates_by_chance_follow_the_seed() -> None:
    def run(seed: int) -> list[str]:
        bus = Bus(seed, loss=0.2, copies=0.2, late_copies=0.2, reordering=0.2)
        bus.attach(Ear(Outbox()))
        for n in range(50):
            bus.send(f"123#{n:02X}")
        bus.settle()
        return heard(bus)

    assert run(1) == run(1) != run(2)
    assert set(CAN_FATES) == {Fate.DELIVERED, Fate.LOST, Fate.COPIED}


def test_the_host_may_command_machines_when_it_hears_of_an_event() -> None:
    bus = Bus()
    ear = bus.attach(Ear(Outbox()))
    bus.on_event = lambda report: ear.say("456#") if isinstance(report, Heard) else None
    bus.send("123#")
    bus.run_until(lambda: "456#" in bus.trace())
    assert bus.now > 0


def test_a_bus_that_does_not_come_to_rest_is_an_error() -> None:
    bus = Bus()
    ear = bus.attach(Ear(Outbox()))
    ear.arm(2 * SECOND)
    with pytest.raises(AssertionError, match="still busy"):
        bus.settle(SECOND)
    bus.settle()
    with pytest.raises(AssertionError, match="idle"):
        bus.run_until(lambda: False)
