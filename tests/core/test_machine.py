"""The contract between machines, their outbox and whoever wakes them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.group import Group
from canopen_proto.machine import (
    NEVER,
    Event,
    FrameIgnored,
    LocalProtocolError,
    Machine,
    Outbox,
    Outcome,
    Time,
    check_node_id,
    fields_of,
)


class Rang(Event):
    __slots__ = ("at",)
    __match_args__ = ("node_id", "at")

    def __init__(self, node_id: int, at: Time) -> None:
        self.node_id = node_id
        self.at = at


class Alarm(Machine):
    """Does what a machine does, and no more: rings at each of its times; wants the frames of one CAN-ID."""

    __slots__ = ("can_id", "times")

    def __init__(self, out: Outbox, can_id: int = 0x100) -> None:
        super().__init__(out)
        self.can_id = can_id
        self.times: list[Time] = []

    def can_ids(self) -> Iterable[int]:
        return (self.can_id,)

    def set(self, times: list[Time]) -> None:
        self.times = sorted(times)
        self._arm(self.times[0] if self.times else NEVER)

    def move_to(self, can_id: int) -> None:
        self.can_id = can_id
        self._reroute()

    def handle_timeout(self, now: Time) -> None:
        if now < self.deadline:
            return
        self.out.events.append(Rang(self.can_id, self.deadline))
        self.set(self.times[1:])


# events


def test_events_are_readable_by_keyword_comparable_and_matchable() -> None:
    rang = Rang(5, at=7)
    assert rang == Rang(node_id=5, at=7)
    assert rang != Rang(6, 7)
    assert repr(rang) == "Rang(node_id=5, at=7)"
    match rang:
        case Rang(node_id=5, at=at):
            assert at == 7
        case _:
            pytest.fail("a class pattern does not match")
    assert fields_of(rang) == {"node_id": 5, "at": 7}


def test_events_of_two_kinds_differ_and_have_no_room_for_more() -> None:
    ignored = FrameIgnored(5, Frame(0x705), "why")
    different: Event = Outcome(5, 1)
    assert ignored != different
    assert fields_of(ignored) == {"node_id": 5, "frame": Frame(0x705), "reason": "why"}
    with pytest.raises(AttributeError):
        ignored.colour = "red"  # type: ignore[attr-defined]


# node-IDs


@pytest.mark.parametrize("node_id", [1, 12, 127])
def test_node_ids(node_id: int) -> None:
    assert check_node_id(node_id) == node_id


@pytest.mark.parametrize("node_id", [-1, 0, 128, 1000])
def test_other_node_ids(node_id: int) -> None:
    with pytest.raises(LocalProtocolError, match=f"node-ID {node_id} is outside 1..127"):
        check_node_id(node_id)


@pytest.mark.parametrize("node_id", ["5", b"\x05", 5.0, None, True, [5]])
def test_a_node_id_that_is_no_integer_is_our_callers_fault(node_id: Any) -> None:
    with pytest.raises(LocalProtocolError, match="is not an integer"):
        check_node_id(node_id)


# a bare machine


def test_a_machine_that_wants_nothing() -> None:
    machine = Machine(Outbox())
    assert (list(machine.can_ids()), machine.deadline) == ([], NEVER)
    machine.receive(Frame.parse("705#05"), 0)
    machine.handle_timeout(10**18)
    assert (machine.out.frames, machine.out.events, machine.deadline) == ([], [], NEVER)


def test_a_machine_enters_armed_once_and_only_for_a_nearer_deadline() -> None:
    out = Outbox()
    alarm, other = Alarm(out), Alarm(out)
    alarm.set([100])
    other.set([50])
    alarm.set([30])
    alarm.set([200])
    assert out.armed == [alarm, other]
    assert alarm.deadline == 200  # the held wake, 30, is early: the holder arms anew from the deadline
    alarm.set([])
    assert (alarm.deadline, out.armed) == (NEVER, [alarm, other])


def test_never_arms_nobody() -> None:
    alarm = Alarm(Outbox())
    alarm.set([])
    assert alarm.out.armed == []


def test_rerouted_holds_a_machine_once() -> None:
    alarm = Alarm(Outbox())
    alarm.move_to(0x101)
    alarm.move_to(0x102)
    assert alarm.out.rerouted == [alarm]


# nested outboxes


def test_a_nested_outbox_shares_frames_events_and_request_ids_in_order() -> None:
    outer = Outbox()
    group = Group(outer)
    inner = group.inner
    deepest = Outbox(within=inner, owner=None)
    outer.events.append(Rang(1, 1))
    deepest.events.append(Rang(2, 2))
    inner.frames.append(Frame(1))
    outer.frames.append(Frame(2))
    assert [rang.node_id for rang in inner.events] == [1, 2]
    assert outer.frames == deepest.frames == [Frame(1), Frame(2)]
    assert [box.next_request_id() for box in (outer, inner, deepest, outer)] == [1, 2, 3, 4]
    assert Outbox().next_request_id() == 1


def test_a_member_that_arms_or_reroutes_makes_its_group_do_so() -> None:
    outer = Outbox()
    group = Group(outer)
    alarm = Alarm(group.inner)
    alarm.set([100])
    assert group.inner.armed == [alarm]
    assert (outer.armed, group.deadline) == ([group], 100)
    alarm.set([40])
    assert (outer.armed, group.deadline) == ([group], 40)
    alarm.move_to(0x200)
    assert (group.inner.rerouted, outer.rerouted) == ([alarm], [group])


# who wakes machines: never late, whatever they do

TIMES = st.lists(st.integers(1, 60), max_size=4, unique=True)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 20), TIMES), max_size=25))
def test_nested_alarms_ring_at_their_time(commands: list[tuple[int, int, list[Time]]]) -> None:
    """Four alarms, two groups deep, set anew at any time: a driver that waits for the group's deadline is never late for any."""
    outer = Outbox()
    top = Group(outer)
    low = Group(top.inner)
    alarms = [Alarm(top.inner, 1), Alarm(low.inner, 2), Alarm(low.inner, 3), Alarm(top.inner, 4)]
    for machine, group in zip([*alarms, low], [top, low, low, top, top], strict=True):
        group._members.attach(machine)
    now = 0

    def pass_time(until: Time) -> None:
        nonlocal now
        while top.deadline <= until:
            now = max(now, top.deadline)
            top.handle_timeout(now)
            for rang in outer.events:
                assert isinstance(rang, Rang)
                assert rang.at == now
            outer.events.clear()
            assert all(alarm.deadline > now for alarm in alarms)
        now = until

    for which, step, times in commands:
        pass_time(now + step)
        alarms[which].set([now + time for time in times])
    pass_time(now + 100)
    assert all(alarm.deadline == NEVER for alarm in alarms)


@given(st.lists(st.tuples(st.integers(0, 2), st.integers(0x100, 0x103)), max_size=20))
def test_frames_find_machines_that_change_their_identifiers(moves: list[tuple[int, int]]) -> None:
    outer = Outbox()
    top = Group(outer)
    low = Group(top.inner)
    alarms: list[Any] = [Alarm(top.inner), Alarm(low.inner), Alarm(low.inner)]
    for machine, group in zip([*alarms, low], [top, low, low, top], strict=True):
        group._members.attach(machine)
    for which, can_id in moves:
        alarms[which].move_to(can_id)
        assert sorted(top.can_ids()) == sorted({alarm.can_id for alarm in alarms})
        assert sorted(low.can_ids()) == sorted({alarm.can_id for alarm in alarms[1:]})
