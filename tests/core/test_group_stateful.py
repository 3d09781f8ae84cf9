"""A Group in any situation, against a model that looks at everything."""

from __future__ import annotations

from typing import cast

from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, invariant, precondition, rule

from canopen_proto.frame import Frame
from canopen_proto.group import SPARE_WAKES, Members
from canopen_proto.machine import NEVER, Event, Machine, Outbox, Time
from tests.core.machines import Alarm, Box, Heard, Rang
from tests.examples import examples


def names(events: list[Event]) -> str:
    """The names in reports, in order; the events are taken."""
    text = " ".join(report.name for report in events if isinstance(report, Heard | Rang))
    events.clear()
    return text


KEYS = st.integers(0, 5)
DELAYS = st.integers(0, 20) | st.just(NEVER)


class Nest(RuleBasedStateMachine):
    """Alarms in groups in groups. The model is the definition: the nearest deadline of all that hang together with the root."""

    alarms = Bundle("alarms")
    boxes = Bundle("boxes")

    def __init__(self) -> None:
        super().__init__()
        self.now = 0
        self.root = Box(Outbox())
        self.members = Members(self.root.out)
        self.members.attach(self.root)
        self.boxes_made = [self.root]
        self.made = 0
        self.last_order: dict[Box, list[Machine]] = {self.root: []}

    def attached(self) -> list[Alarm]:
        """All alarms that a frame or wake can reach, in the order in which a frame meets them."""
        found: list[Alarm] = []

        def visit(box: Box) -> None:
            for machine in self.last_order[box]:
                if isinstance(machine, Box):
                    visit(machine)
                else:
                    found.append(cast(Alarm, machine))

        visit(self.root)
        return found

    @rule(target=boxes)
    def the_root(self) -> Box:
        return self.root

    @precondition(lambda self: len(self.boxes_made) < 5)
    @rule(target=boxes, box=boxes)
    def make_box(self, box: Box) -> Box:
        nested = Box(box.inner)
        self.boxes_made.append(nested)
        self.last_order[nested] = []
        box.put(nested)
        self.last_order[box].append(nested)
        return nested

    @rule(target=alarms, box=boxes, keys=st.lists(KEYS, max_size=3), delay=DELAYS)
    def make_alarm(self, box: Box, keys: list[int], delay: Time) -> Alarm:
        self.made += 1
        alarm = Alarm(box.inner, str(self.made), keys, min(self.now + delay, NEVER))
        box.put(alarm)
        self.last_order[box].append(alarm)
        return alarm

    def owner(self, machine: Machine) -> Box:
        return next(box for box in self.boxes_made if box.inner is machine.out)

    @rule(machine=alarms | boxes)
    def detach(self, machine: Alarm | Box) -> None:
        if machine is not self.root:
            owner = self.owner(machine)
            owner.take(machine)
            if machine in self.last_order[owner]:
                self.last_order[owner].remove(machine)

    @rule(machine=alarms | boxes)
    def attach(self, machine: Alarm | Box) -> None:
        if machine is not self.root:
            owner = self.owner(machine)
            owner.put(machine)
            if machine not in self.last_order[owner]:
                self.last_order[owner].append(machine)

    @rule(alarm=alarms, delays=st.lists(DELAYS, min_size=1, max_size=3), then=st.lists(st.integers(-5, 20), max_size=3))
    def command(self, alarm: Alarm, delays: list[Time], then: list[int]) -> None:
        for delay in delays:
            alarm.set(min(self.now + delay, NEVER))
        alarm.then = [max(0, self.now + delays[-1] + later) for later in then]

    @rule(alarm=alarms, keys=st.lists(KEYS, max_size=3))
    def listen(self, alarm: Alarm, keys: list[int]) -> None:
        alarm.listen(*keys)

    @rule(alarm=alarms, keys=st.lists(KEYS, max_size=3), delay=DELAYS)
    def act_when_it_receives(self, alarm: Alarm, keys: list[int], delay: Time) -> None:
        alarm.on_frame = lambda _: (alarm.listen(*keys), alarm.set(min(self.now + delay, NEVER)))

    @rule(key=KEYS)
    def receive(self, key: int) -> None:
        self.root.out.events.clear()
        wanted = [alarm.name for alarm in self.attached() if key in alarm.keys]
        self.root.receive(Frame(key), self.now)
        assert names(self.root.out.events).split() == wanted

    @rule(delay=st.integers(0, 25))
    def pass_time(self, delay: Time) -> None:
        self.now += delay
        due = {alarm for alarm in self.attached() if alarm.deadline <= self.now}
        before = {alarm: len(alarm.rang_at) for box in self.boxes_made for alarm in box._members if isinstance(alarm, Alarm)}
        self.members.handle_timeout(self.now)
        for alarm, count in before.items():
            assert len(alarm.rang_at) - count == (alarm in due), "each that is due is woken once, and nobody else"
        for _ in range(100):
            if self.members.next_deadline() > self.now:
                break
            self.members.handle_timeout(self.now)
        assert all(alarm.deadline > self.now for alarm in self.attached()), "a wake was lost"

    @invariant()
    def a_deadline_is_never_late(self) -> None:
        assert self.members.next_deadline() <= min((alarm.deadline for alarm in self.attached()), default=NEVER)

    @invariant()
    def routes_are_those_of_the_machines(self) -> None:
        self.members.refresh()
        assert set(self.members.routes) == {key for alarm in self.attached() for key in alarm.keys}

    @invariant()
    def memory_is_bounded(self) -> None:
        for box in self.boxes_made:
            assert box.wakes_held <= SPARE_WAKES + 2 * self.made
            assert len(box.inner.armed) + len(box.inner.rerouted) <= 2 * (self.made + len(self.boxes_made))

    def teardown(self) -> None:
        for _ in range(1000):
            time = self.members.next_deadline()
            if time == NEVER:
                break
            self.members.handle_timeout(time)
        assert self.members.next_deadline() == NEVER


TestNest = Nest.TestCase
TestNest.settings = examples(60, steps=40)


def test_a_machine_that_arms_itself_for_a_past_time_is_woken_once_a_turn() -> None:
    """An older entry of the heap for just that time must not wake it again in the same turn."""
    out = Outbox()
    members = Members(out)
    alarm = Alarm(out)
    members.attach(alarm)
    alarm.set(1)
    members.refresh()
    alarm.set(0)
    alarm.then = [1]
    members.handle_timeout(1)
    assert alarm.rang_at == [1]
    assert members.next_deadline() == 1
    members.handle_timeout(1)
    assert alarm.rang_at == [1, 1]
