"""A device's account of its communication errors, beside CiA 301's rules as some lines: whatever is lost, and however late it is
looked at, 0x1001, the NMT state and the last emergency say what is so."""

from __future__ import annotations

from typing import Any

from hypothesis import example, given
from hypothesis import strategies as st

from canopen_proto.frame import Frame
from canopen_proto.machine import MILLISECOND
from tests.core.device_bench import PRE_OPERATIONAL, RESET_COMMUNICATION, RESET_NODE, START, STOP, DeviceBench
from tests.examples import examples

Cause = tuple[str, int]
PREOP, OPERATIONAL, STOPPED = 127, 5, 4


class Account:
    """7.2.8.3.2.2 and 7.5.2.19 (heartbeats), 7.5.2.35 (RPDO), 7.5.2.32 (0x1029), 7.3.2.2 (NMT). Times in ms."""

    def __init__(self) -> None:
        self.now = 0
        self.reset()

    def reset(self) -> None:
        self.state, self.behaviour, self.rpdo_time = PREOP, 0, 0
        self.errors: set[Cause] = set()
        self.entries = {1: (0, 0), 2: (0, 0)}  # 0x1016: node-ID and time
        self.last: dict[int, int] = {}  # a heartbeat or boot-up of a node whose watch has begun
        self.rpdo_at: int | None = None

    def enter(self, state: int) -> None:
        if state != OPERATIONAL or self.state != OPERATIONAL:
            self.rpdo_at = None
        self.state = state

    def watched(self) -> dict[int, int]:
        return {node_id: time for node_id, time in self.entries.values() if time}

    def poll(self) -> None:
        """All that is due by now, in the order in which it fell due."""
        due = [(self.last[each] + time, "lost", each) for each, time in self.watched().items() if each in self.last]
        if self.rpdo_at is not None and self.rpdo_time:
            due.append((self.rpdo_at + self.rpdo_time, "overdue", 1))
        for when, what, which in sorted(due):
            if when > self.now:
                continue
            if what == "overdue":
                if self.rpdo_at is not None:  # else it left Operational by what was due before
                    self.errors.add((what, which))
                    self.rpdo_at = None
                continue
            self.errors.add((what, which))
            del self.last[which]
            if self.behaviour == 2:
                self.enter(STOPPED)
            elif self.behaviour == 0 and self.state == OPERATIONAL:
                self.enter(PREOP)

    def heartbeat(self, node_id: int) -> None:
        if node_id in self.watched():
            self.last[node_id] = self.now
            self.errors.discard(("lost", node_id))

    def boot_up(self, node_id: int) -> None:
        if node_id in self.last:
            self.last[node_id] = self.now

    def rpdo(self, length: int) -> None:
        if self.state != OPERATIONAL:
            return
        if length < 2:
            self.errors.add(("short", 1))
            return
        self.errors -= {("short", 1), ("overdue", 1)}
        self.rpdo_at = self.now

    def watch(self, place: int, node_id: int, time: int) -> bool:
        """Whether the device takes the entry: a node is watched once."""
        if time and any(other != place and entry[1] and entry[0] == node_id for other, entry in self.entries.items()):
            return False
        before = self.watched()
        self.entries[place] = (node_id, time)
        for each in before.keys() - self.watched().keys():
            self.errors.discard(("lost", each))
            self.last.pop(each, None)
        for each, new in self.watched().items():
            if each in self.last and before.get(each) != new:
                self.last[each] = self.now
        return True

    def set_rpdo_time(self, time: int) -> None:
        self.errors -= {("short", 1), ("overdue", 1)}
        if time != self.rpdo_time:
            self.rpdo_at = None  # watched from the next one on
        self.rpdo_time = time


COMMANDS = {START: OPERATIONAL, STOP: STOPPED, PRE_OPERATIONAL: PREOP}
STEPS = st.one_of(
    st.tuples(st.just("wait"), st.integers(1, 120)),
    st.tuples(st.just("wait"), st.integers(1, 120)),
    st.tuples(st.just("late"), st.integers(1, 400)),
    st.tuples(st.just("heartbeat"), st.sampled_from([9, 10])),
    st.tuples(st.just("heartbeat"), st.sampled_from([9, 10])),
    st.tuples(st.just("boot_up"), st.sampled_from([9, 10])),
    st.tuples(st.just("rpdo"), st.sampled_from([0, 1, 2, 2, 3])),
    st.tuples(st.just("watch"), st.integers(1, 2), st.sampled_from([9, 10]), st.sampled_from([0, 50, 100])),
    st.tuples(st.just("watch"), st.integers(1, 2), st.sampled_from([9, 10]), st.sampled_from([50, 100])),
    st.tuples(st.just("rpdo_time"), st.sampled_from([0, 40, 70])),
    st.tuples(st.just("behaviour"), st.integers(0, 2)),
    st.tuples(st.just("command"), st.sampled_from([START, START, STOP, PRE_OPERATIONAL])),
    st.tuples(st.just("command"), st.sampled_from([RESET_COMMUNICATION, RESET_NODE])),
)


@examples(2000, least=60)
@given(st.lists(STEPS, max_size=40))
@example([("wait", 120), ("watch", 1, 9, 0), ("watch", 2, 9, 50), ("heartbeat", 9), ("wait", 60)])
@example([("wait", 60), ("boot_up", 9), ("wait", 60), ("wait", 60), ("heartbeat", 9)])
@example([("rpdo", 2), ("wait", 60), ("rpdo_time", 70), ("wait", 60), ("rpdo", 1), ("rpdo", 2)])
@example([("rpdo", 2), ("late", 301), ("command", STOP), ("command", PRE_OPERATIONAL), ("command", START), ("wait", 120)])
def test_whatever_is_lost_and_however_late_errors_and_states_are_those_that_are_so(steps: list[tuple[Any, ...]]) -> None:
    bench, account = DeviceBench(), Account()
    told: int | None = None
    for name, *values in [("watch", 1, 9, 100), ("heartbeat", 9), ("rpdo_time", 70), ("command", START), *steps]:
        sent: list[str] = []
        match name:
            case "wait":  # in time
                sent = [each.split()[1] for each in bench.wait(values[0])]
                for _ in range(values[0]):
                    account.now += 1
                    account.poll()
            case "late":  # a busy computer: what has come is handled first, then the time
                bench.now += values[0] * MILLISECOND
                account.now += values[0]
                sent = bench.tell(*(f"70{each:X}#05" for each in (9,) if values[0] % 2))
                if values[0] % 2:
                    account.heartbeat(9)
                bench.network.handle_timeout(bench.now)
                sent += bench.take()
                account.poll()
            case "heartbeat":
                sent = bench.tell(f"70{values[0]:X}#05")
                account.heartbeat(values[0])
            case "boot_up":
                sent = bench.tell(f"70{values[0]:X}#00")
                account.boot_up(values[0])
            case "rpdo":
                sent = bench.tell(f"205#{bytes(values[0]).hex()}")
                account.rpdo(values[0])
            case "command":
                sent = bench.tell(values[0])
                if values[0] in COMMANDS:
                    account.enter(COMMANDS[values[0]])
                else:
                    account.reset()
                    told = told if values[0] == RESET_COMMUNICATION else None  # error free without a frame: 7.2.7.1, transition 0
            case _ if account.state != STOPPED:
                if name == "watch":
                    place, node_id, time = values
                    is_taken = bench.write(0x1016, place, node_id << 16 | time, 4) is None
                    assert is_taken == account.watch(place, node_id, time)
                elif name == "rpdo_time":
                    assert bench.write(0x1400, 5, values[0], 2) is None
                    account.set_rpdo_time(values[0])
                else:
                    assert bench.write(0x1029, 1, values[0], 1) is None
                    account.behaviour = values[0]
                sent = bench.others
        for frame in sent:
            if frame.startswith("085#"):
                told = int.from_bytes(Frame.parse(frame).data[:2], "little")
        assert int(bench.node.state) == account.state, (name, *values)
        assert bench.node.communication.emcy.error_register == (0x11 if account.errors else 0), (name, *values, account.errors)
        if account.state != STOPPED:
            assert bool(told) == bool(account.errors), (name, *values, told, account.errors)
