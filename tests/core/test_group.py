"""Group and Members: routes, deadlines, reactions."""

from __future__ import annotations

import pytest

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.frame import KEY_EXTENDED, KEY_REMOTE, Frame
from canopen_proto.group import SPARE_WAKES, Members
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import NEVER, Event, LocalProtocolError, Outbox, Time
from canopen_proto.network import Network
from canopen_proto.nmt import NmtState
from tests.core.machines import Alarm, Box, Heard, Rang


def names(events: list[Event]) -> str:
    """The names in reports, in order; the events are taken."""
    text = " ".join(report.name for report in events if isinstance(report, Heard | Rang))
    events.clear()
    return text


# ---- frames ----


def test_a_frame_goes_to_all_that_want_its_key_in_the_order_of_attachment() -> None:
    box = Box(Outbox())
    wanted = {"a": [0x80], "b": [0x80, 0x705], "c": [0x705], "d": [0x80]}
    box.put(*(Alarm(box.inner, name, keys) for name, keys in wanted.items()))
    box.receive(Frame.parse("080#"), 0)
    assert names(box.out.events) == "a b d"
    box.receive(Frame.parse("705#05"), 0)
    assert names(box.out.events) == "b c"
    box.receive(Frame.parse("706#05"), 0)
    assert box.out.events == []


def test_flags_belong_to_the_key() -> None:
    box = Box(Outbox())
    box.put(Alarm(box.inner, "data", [0x705]), Alarm(box.inner, "remote", [0x705 | KEY_REMOTE]))
    box.put(Alarm(box.inner, "extended", [0x705 | KEY_EXTENDED]), Alarm(box.inner, "both", [0x705 | KEY_EXTENDED | KEY_REMOTE]))
    for text, wanted in [("705#00", "data"), ("705#R1", "remote"), ("00000705#00", "extended"), ("00000705#R", "both")]:
        box.receive(Frame.parse(text), 0)
        assert names(box.out.events) == wanted


def test_a_key_that_is_asked_for_twice_is_heard_once() -> None:
    box = Box(Outbox())
    box.put(Alarm(box.inner, "a", [5, 5]))
    box.receive(Frame(5), 0)
    assert names(box.out.events) == "a"


def test_a_change_of_can_ids_keeps_the_order_of_attachment() -> None:
    box = Box(Outbox())
    a, b, c = (Alarm(box.inner, name, [1]) for name in "abc")
    box.put(a, b, c)
    a.listen(2)
    box.receive(Frame(1), 0)
    a.listen(1)
    b.listen(2)
    b.listen(1)
    box.receive(Frame(1), 0)
    assert names(box.out.events) == "b c a b c"


def test_a_member_that_changes_its_can_ids_while_it_receives() -> None:
    box = Box(Outbox())
    a, b = Alarm(box.inner, "a", [1]), Alarm(box.inner, "b", [1])
    a.on_frame = lambda _: (a.listen(2), b.listen(2))
    box.put(a, b)
    box.receive(Frame(1), 0)
    assert names(box.out.events) == "a b"  # the frame that was under way is still handed to both
    box.receive(Frame(1), 0)
    assert names(box.out.events) == ""
    box.receive(Frame(2), 0)
    assert names(box.out.events) == "a b"
    assert set(box.can_ids()) == {2}


def test_a_key_that_a_group_keeps_goes_to_those_who_want_it_now() -> None:
    """The members around the group hold where its frames go in; they ask again for what changed inside, however deep."""
    network = Network()
    outer = Box(network.out)
    inner = Box(outer.inner)
    a, b = (Alarm(inner.inner, name, [1]) for name in "ab")
    outer.put(inner)
    network.attach(outer)

    def heard() -> str:
        network.receive(Frame(1), 0)
        return names(network.out.events)

    inner.put(a)
    assert heard() == "a"
    inner.put(b)
    assert heard() == "a b"
    inner.take(a)
    assert heard() == "b"
    a.listen(1)
    b.listen(2)
    inner.put(a)
    assert heard() == "a"
    a.listen(2)
    b.listen(1)
    assert heard() == "b"
    network.detach(outer)
    inner.take(b)
    inner.put(b, a)
    a.listen(1)
    network.attach(outer)
    assert heard() == "a b"


def test_a_group_keeps_note_of_no_more_than_its_routes() -> None:
    box = Box(Outbox())
    nested = Box(box.inner)
    alarm = Alarm(nested.inner, "a", [1])
    nested.put(alarm)
    for key in range(100):
        alarm.listen(key)
        nested.can_ids()
    assert set(nested.take_changed()) == {99}
    assert set(nested.take_changed()) == set()


def test_a_standing_alone_group_hears_at_once_what_a_command_to_a_member_asked_for() -> None:
    box = Box(Outbox())
    alarm = Alarm(box.inner, "a", [1])
    box.put(alarm)
    alarm.listen(2)
    box.receive(Frame(2), 0)
    assert names(box.out.events) == "a"


def test_the_timestamp_of_a_frame_reaches_all_levels_and_is_gone_with_it() -> None:
    outer = Box(Outbox())
    inner = Box(outer.inner)
    alarm = Alarm(inner.inner, "a", [1], deadline=10)
    inner.put(alarm)
    outer.put(inner)
    outer.out.timestamp = 77
    outer.receive(Frame(1), 0)
    assert outer.out.events == [Heard(0, "a", Frame(1), 77)]
    outer.out.timestamp = None
    assert inner.inner.timestamp is None
    assert outer.inner.timestamp is None


def test_a_group_may_have_a_receive_of_its_own() -> None:
    """A group is not passed over by those around it, however deep it stands."""

    class Deaf(Box):
        def receive(self, frame: Frame, now: Time) -> None:
            if frame.data != b"drop":
                super().receive(frame, now)

    outer = Box(Outbox())
    middle = Box(outer.inner)
    deaf = Deaf(middle.inner)
    deaf.put(Alarm(deaf.inner, "a", [1], deadline=10))
    middle.put(deaf)
    outer.put(middle)
    outer.receive(Frame(1, b"drop"), 0)
    outer.receive(Frame(1, b"take"), 0)
    assert outer.out.events == [Heard(0, "a", Frame(1, b"take"), None)]


def test_a_local_node_may_have_a_receive_of_its_own_too() -> None:
    """A LocalNode's `receive` is passed over for data frames, but not that of a class which inherits from it."""
    taken: list[Frame] = []

    class Recorder(LocalNode):
        def receive(self, frame: Frame, now: Time) -> None:
            taken.append(frame)
            super().receive(frame, now)

    network = Network()
    node = Recorder(network.out, 5, ObjectDictionary([]))
    network.attach(node)
    node.boot(0)
    start = Frame(0, b"\x01\x05")
    network.receive(start, 1)
    assert (taken, node.nmt.state) == ([start], NmtState.OPERATIONAL)


# ---- attaching ----


def test_a_machine_with_another_outbox_is_refused() -> None:
    box = Box(Outbox())
    with pytest.raises(LocalProtocolError, match="Alarm was made with another Outbox"):
        box.put(Alarm(box.out, "a", [1]))
    assert list(box._members) == []
    assert box.can_ids() == ()


def test_attached_twice_is_attached_once() -> None:
    box = Box(Outbox())
    alarm = Alarm(box.inner, "a", [1], deadline=10)
    box.put(alarm, alarm)
    box.receive(Frame(1), 0)
    box.handle_timeout(10)
    assert names(box.out.events) == "a a"
    assert list(box._members) == [alarm]


def test_a_detached_machine_gets_nothing_and_may_come_back() -> None:
    box = Box(Outbox())
    alarm, other = Alarm(box.inner, "a", [1], deadline=10), Alarm(box.inner, "b", [1], deadline=20)
    box.put(alarm, other)
    box.take(alarm)
    box.take(alarm)
    box.receive(Frame(1), 0)
    box.handle_timeout(10)
    assert names(box.out.events) == "b"
    alarm.set(5)  # what it does meanwhile is its own affair
    alarm.listen(3)
    box.handle_timeout(11)
    assert box.can_ids() == (1,)
    box.put(alarm)
    assert box.deadline == 5
    box.receive(Frame(3), 12)
    box.handle_timeout(12)
    assert names(box.out.events) == "a a"


@pytest.mark.parametrize("refreshed", [False, True])
def test_detached_while_it_is_announced(refreshed: bool) -> None:
    out = Outbox()
    members = Members(out)
    alarm = Alarm(out, "a", [1])
    members.attach(alarm)
    alarm.set(10)
    alarm.listen(2)
    if refreshed:
        assert members.next_deadline() == 10
        alarm.set(9)
    members.detach(alarm)
    assert out.armed == []
    assert out.rerouted == []
    members.handle_timeout(20)
    assert alarm.rang_at == []
    members.attach(alarm)
    members.handle_timeout(21)
    members.handle_timeout(21)
    assert alarm.rang_at == [21]
    assert members.routes == {2: (alarm,)}


def test_detached_by_another_that_is_due_at_the_same_time() -> None:
    out = Outbox()
    members = Members(out)

    class Killer(Alarm):
        def handle_timeout(self, now: Time) -> None:
            super().handle_timeout(now)
            members.detach(b)

    a, b = Killer(out, "a", deadline=10), Alarm(out, "b", deadline=10)
    members.attach(a)
    members.attach(b)
    members.handle_timeout(10)
    assert names(out.events) == "a"
    assert members.next_deadline() == NEVER


def test_attached_to_a_group_that_is_attached_already() -> None:
    outer = Box(Outbox())
    inner = Box(outer.inner)
    outer.put(inner)
    alarm = Alarm(inner.inner, "a", [1], deadline=10)
    inner.put(alarm)
    assert outer.deadline == 10
    outer.receive(Frame(1), 0)
    assert names(outer.out.events) == "a"
    inner.take(alarm)
    assert outer.can_ids() == ()
    outer.handle_timeout(10)
    assert alarm.rang_at == []
    assert outer.deadline == NEVER


# ---- deadlines ----


def test_due_members_are_woken_in_the_order_of_their_deadlines() -> None:
    box = Box(Outbox())
    box.put(*(Alarm(box.inner, name, deadline=time) for name, time in [("a", 30), ("b", 10), ("c", 20), ("d", 10), ("e", 31)]))
    assert box.deadline == 10
    box.handle_timeout(9)
    assert names(box.out.events) == ""
    box.handle_timeout(30)
    assert names(box.out.events) == "b d c a"
    assert box.deadline == 31


def test_a_deadline_that_moved_later_waits_for_the_early_wake() -> None:
    box = Box(Outbox())
    alarm = Alarm(box.inner, "a", deadline=10)
    box.put(alarm)
    alarm.set(20)
    assert box.deadline == 10  # early is allowed
    box.handle_timeout(10)
    assert alarm.rang_at == []
    assert box.deadline == 20
    alarm.set(NEVER)
    box.handle_timeout(20)
    assert alarm.rang_at == []
    assert box.deadline == NEVER


def test_a_superseded_wake_wakes_nobody() -> None:
    out = Outbox()
    members = Members(out)
    alarm = Alarm(out, "a", deadline=20)
    members.attach(alarm)
    assert members.next_deadline() == 20
    alarm.set(10)
    assert members.next_deadline() == 10
    members.handle_timeout(10)
    alarm.set(30)
    assert members.next_deadline() == 20
    members.handle_timeout(20)
    assert alarm.rang_at == [10]
    members.handle_timeout(30)
    assert alarm.rang_at == [10, 30]


@pytest.mark.parametrize("levels", [1, 2, 3])
@pytest.mark.parametrize("again", [10, 9, 0])
def test_a_deadline_that_is_over_already_is_not_lost(levels: int, again: Time) -> None:
    # The wake of the group was used up; its new deadline is the old one, and must be held anew all the same.
    outermost = group = Box(Outbox())
    for _ in range(levels - 1):
        nested = Box(group.inner)
        group.put(nested)
        group = nested
    alarm = Alarm(group.inner, "a", deadline=10)
    alarm.then = [NEVER, again]
    group.put(alarm)
    members = Members(outermost.out)
    members.attach(outermost)
    assert members.next_deadline() == 10
    members.handle_timeout(10)
    assert members.next_deadline() == again
    members.handle_timeout(10)
    assert alarm.rang_at == [10, 10]
    assert members.next_deadline() == NEVER


def test_a_command_to_the_innermost_member_moves_the_outermost_deadline() -> None:
    outer = Box(Outbox())
    inner = Box(outer.inner)
    alarm, other = Alarm(inner.inner, "a"), Alarm(inner.inner, "b", deadline=50)
    inner.put(alarm, other)
    outer.put(inner)
    members = Members(outer.out)
    members.attach(outer)
    assert members.next_deadline() == 50
    for deadline in (40, 45, 30):
        alarm.set(deadline)
        assert members.next_deadline() <= deadline
    members.handle_timeout(30)
    assert alarm.rang_at == [30]
    assert members.next_deadline() <= 50
    alarm.listen(0x123)
    members.refresh()
    assert members.routes == {0x123: (outer,)}


def test_the_heap_is_bounded_however_often_a_deadline_moves_nearer() -> None:
    out = Outbox()
    members = Members(out)
    alarms = [Alarm(out, str(number)) for number in range(4)]  # the last one never has a deadline
    for alarm in alarms:
        members.attach(alarm)
    for time in range(10_000, 0, -1):
        alarms[time % 3].set(time)
        assert members.next_deadline() == time
        assert len(members.heap) <= SPARE_WAKES + 2 * len(alarms)
    members.detach(alarms[0])
    members.handle_timeout(10_000)
    assert [alarm.rang_at for alarm in alarms] == [[], [10_000], [10_000], []]


def test_announcements_are_bounded_though_nobody_takes_them() -> None:
    out = Outbox()
    alarm = Alarm(out, "a")
    for time in range(100, 0, -1):
        alarm.set(time)
        alarm.listen(time)
    assert out.armed == [alarm]
    assert out.rerouted == [alarm]


# ---- reactions ----


def test_what_follows_from_a_report_is_done_before_the_next_input() -> None:
    box = Box(Outbox())
    a, b, c = (Alarm(box.inner, name, [key]) for key, name in enumerate("abc"))
    box.put(a, b, c)
    seen: list[str] = []

    def react(heard: Heard, now: Time) -> None:
        seen.append(f"{heard.name} at {now}")
        if heard.name == "a":
            b.set(now)  # a command to a sibling
            c.receive(heard.frame, now)  # which reports in turn

    box.react(Heard, react)
    box.receive(Frame(0), 3)
    assert seen == ["a at 3", "c at 3"]
    assert box.deadline == 3
    box.out.events.clear()
    box.receive(Frame(1), 4)
    assert seen == ["a at 3", "c at 3", "b at 4"]


def test_a_reaction_sees_the_reports_of_its_own_input_only() -> None:
    out = Outbox()
    first, second = Box(out), Box(out)
    seen: list[str] = []
    for box, name in ((first, "a"), (second, "b")):
        box.put(Alarm(box.inner, name, [1]))
        box.react(Heard, lambda heard, now: seen.append(heard.name))
        box.receive(Frame(1), 0)
    assert seen == ["a", "b"]


def test_a_report_of_a_nested_group_is_reacted_to_at_each_level_inner_first() -> None:
    outer = Box(Outbox())
    inner = Box(outer.inner)
    inner.put(Alarm(inner.inner, "a", deadline=10))
    outer.put(inner)
    seen: list[str] = []
    outer.react(Rang, lambda rang, now: seen.append("outer"))
    inner.react(Rang, lambda rang, now: seen.append("inner"))
    outer.handle_timeout(10)
    assert seen == ["inner", "outer"]
