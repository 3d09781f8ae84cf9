"""Node guarding and life guarding: both roles alone, on one bus, and in a device (CiA 301 v4.2.0, 7.2.8.3.2.1)."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.dictionary.standard import standard_object
from canopen_proto.frame import Frame
from canopen_proto.guarding import (
    GuardingAnswered,
    GuardingMaster,
    GuardingRequestsSkipped,
    GuardingSlave,
    GuardingStateUnexpected,
    GuardingToggleRepeated,
    LifeGuardingLost,
    LifeGuardingRecovered,
    NodeGuardingLost,
    NodeGuardingRecovered,
)
from canopen_proto.heartbeat import HeartbeatReceived
from canopen_proto.machine import MILLISECOND, NEVER, FrameIgnored, LocalProtocolError, Outbox
from canopen_proto.nmt import NmtState
from canopen_proto.sdo.client import SdoAborted
from tests.core.bus import Bus, take_events, take_frames
from tests.core.device_bench import RESET_COMMUNICATION, RESET_NODE, START, STOP, DeviceBench
from tests.core.devices import Pair, io_device

MS = MILLISECOND
ASK = "705#R1"


# ---- the slave alone ----


def slave(life_time: int = 0) -> GuardingSlave:
    made = GuardingSlave(Outbox(), 5)
    made.set_enabled(True)
    made.set_life_time(life_time, 0)
    made.set_state(NmtState.PRE_OPERATIONAL)
    return made


def ask(machine: GuardingSlave, now: int = 0) -> list[str]:
    machine.receive(Frame.parse(ASK), now)
    return take_frames(machine.out)


def test_answers_bear_the_state_and_a_toggle_bit_that_begins_with_0() -> None:
    machine = slave()
    assert list(machine.can_ids()) == [Frame.parse(ASK).key]
    assert ask(machine) == ["705#7F"]
    assert ask(machine) == ["705#FF"]
    machine.set_state(NmtState.OPERATIONAL)
    assert ask(machine) == ["705#05"]
    machine.set_state(NmtState.STOPPED)
    assert ask(machine) == ["705#84"]
    assert machine.deadline == NEVER
    assert machine.out.events == []


def test_only_a_reset_of_communication_resets_the_toggle_bit() -> None:
    machine = slave()
    ask(machine)
    machine.set_state(NmtState.INITIALISING)
    assert ask(machine) == []  # not on the bus
    machine.set_state(NmtState.PRE_OPERATIONAL)
    assert ask(machine) == ["705#7F"]


def test_a_slave_without_guarding_is_mute() -> None:
    machine = slave(100 * MS)
    ask(machine)
    machine.set_enabled(False)
    assert machine.out.rerouted == [machine]
    assert list(machine.can_ids()) == []
    assert ask(machine) == []
    assert machine.deadline == NEVER
    machine.set_enabled(True)
    assert ask(machine) == ["705#7F"]


def test_life_guarding_begins_with_the_first_request() -> None:
    machine = slave(100 * MS)
    assert machine.deadline == NEVER
    ask(machine, 10 * MS)
    ask(machine, 60 * MS)
    assert machine.deadline == 160 * MS
    machine.handle_timeout(159 * MS)
    assert machine.out.events == []
    machine.handle_timeout(161 * MS)
    assert take_events(machine.out) == [LifeGuardingLost(5, 100 * MS)]
    assert machine.lost
    assert machine.deadline == NEVER  # told once
    assert ask(machine, 500 * MS) == ["705#7F"]
    assert take_events(machine.out) == [LifeGuardingRecovered(5)]
    assert machine.deadline == 600 * MS


def test_a_life_time_that_changes() -> None:
    machine = slave()
    machine.set_life_time(50 * MS, 0)
    assert machine.deadline == NEVER  # nobody asked yet
    ask(machine, 0)
    machine.set_life_time(80 * MS, 20 * MS)
    assert machine.deadline == 100 * MS
    machine.handle_timeout(100 * MS)
    machine.set_life_time(70 * MS, 200 * MS)
    assert machine.lost
    assert machine.deadline == NEVER
    machine.set_life_time(0, 200 * MS)
    assert not machine.lost
    ask(machine, 300 * MS)
    assert machine.deadline == NEVER
    with pytest.raises(LocalProtocolError, match="less than 0"):
        machine.set_life_time(-1, 0)


# ---- the master alone ----


def master(guard_time: int = 100 * MS, factor: int = 3, now: int = 0) -> GuardingMaster:
    made = GuardingMaster(Outbox(), 5)
    made.start(guard_time, factor, now)
    return made


def hear(machine: GuardingMaster, frame: str, now: int = 0) -> list[object]:
    machine.receive(Frame.parse(frame), now)
    return list(take_events(machine.out))


def run(machine: GuardingMaster, until: int) -> list[str]:
    """Wake it at its deadlines; what it sent and then what it reported, with the millisecond."""
    log = []
    while machine.deadline <= until:
        now = machine.deadline
        machine.handle_timeout(now)
        log += [f"{now // MS} {each}" for each in (*take_frames(machine.out), *map(type_name, take_events(machine.out)))]
    return log


def type_name(each: object) -> str:
    return type(each).__name__


def test_a_master_asks_once_per_guard_time() -> None:
    machine = master()
    assert take_frames(machine.out) == [ASK]
    machine.out.timestamp = 77
    assert hear(machine, "705#7F") == [GuardingAnswered(5, NmtState.PRE_OPERATIONAL, 77)]
    assert machine.state is NmtState.PRE_OPERATIONAL
    assert run(machine, 250 * MS) == ["100 705#R1", "200 705#R1"]
    machine.stop()
    assert machine.deadline == NEVER
    assert hear(machine, "705#FF") == []
    assert list(machine.can_ids()) == [0x705]


def test_a_repeated_toggle_bit_counts_as_no_answer() -> None:
    machine = master(factor=1)
    assert hear(machine, "705#FF") == [GuardingAnswered(5, NmtState.PRE_OPERATIONAL, None)]  # somebody asked before us
    run(machine, 100 * MS)
    (report,) = hear(machine, "705#FF", 101 * MS)
    assert isinstance(report, GuardingToggleRepeated)
    assert isinstance(report, FrameIgnored)
    assert run(machine, 200 * MS) == ["200 705#R1", "200 NodeGuardingLost"]
    assert [type_name(each) for each in hear(machine, "705#7F", 201 * MS)] == ["GuardingAnswered", "NodeGuardingRecovered"]


def test_a_node_is_lost_when_a_request_is_not_answered_within_its_life_time() -> None:
    machine = master()
    hear(machine, "705#05", MS)
    take_frames(machine.out)
    assert run(machine, 600 * MS) == [
        "100 705#R1",  # the first that is not answered
        "200 705#R1",
        "300 705#R1",
        "400 705#R1",
        "400 NodeGuardingLost",
        "500 705#R1",  # it goes on asking
        "600 705#R1",
    ]
    assert machine.lost
    assert hear(machine, "705#85", 601 * MS) == [
        GuardingAnswered(5, NmtState.OPERATIONAL, None),
        NodeGuardingRecovered(5, NmtState.OPERATIONAL),
    ]
    assert not machine.lost


def test_a_node_that_never_answers() -> None:
    machine = master(factor=2)
    take_frames(machine.out)
    machine.handle_timeout(100 * MS)
    machine.handle_timeout(200 * MS)
    assert take_events(machine.out) == [NodeGuardingLost(5, None, 200 * MS)]


def test_a_late_master_sends_one_request_and_keeps_its_phase() -> None:
    machine = master()
    hear(machine, "705#05")
    take_frames(machine.out)
    machine.handle_timeout(99 * MS)
    assert take_frames(machine.out) == []
    machine.handle_timeout(355 * MS)
    assert take_frames(machine.out) == [ASK]
    assert take_events(machine.out) == [GuardingRequestsSkipped(5, 2)]
    assert machine.deadline == 400 * MS


def test_a_request_that_went_out_late_has_its_full_life_time() -> None:
    machine = master(factor=1)
    hear(machine, "705#05")
    machine.handle_timeout(130 * MS)
    take_frames(machine.out)
    assert run(machine, 240 * MS) == ["200 705#R1", "230 NodeGuardingLost"]


def test_an_answer_that_waited_to_be_handled_is_in_time() -> None:
    machine = master(factor=1)
    hear(machine, "705#05", 0)
    machine.handle_timeout(100 * MS)
    hear(machine, "705#85", 900 * MS)  # the driver slept, and hands over the frame first
    machine.handle_timeout(900 * MS)
    assert [type_name(each) for each in take_events(machine.out)] == ["GuardingRequestsSkipped"]


def test_a_boot_up_frame_begins_the_toggle_bit_anew_and_is_no_answer() -> None:
    machine = master(factor=1)
    hear(machine, "705#05")
    run(machine, 100 * MS)
    assert hear(machine, "705#00", 150 * MS) == []
    assert run(machine, 200 * MS) == ["200 705#R1"]  # the request from before the boot-up is forgotten
    assert [type_name(each) for each in hear(machine, "705#FF")] == ["GuardingToggleRepeated"]
    assert [type_name(each) for each in hear(machine, "705#7F")] == ["GuardingAnswered"]


def test_what_is_no_answer() -> None:
    machine = master()
    for frame in ("705#", "705#0505", "705#03", "705#80"):
        (report,) = hear(machine, frame)
        assert type(report) is FrameIgnored
    assert machine.state is None


def test_an_unexpected_state_is_reported_once() -> None:
    machine = master()
    machine.expect(NmtState.OPERATIONAL)
    assert hear(machine, "705#7F")[1:] == [GuardingStateUnexpected(5, NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)]
    assert hear(machine, "705#FF")[1:] == []
    assert hear(machine, "705#04")[1:] == [GuardingStateUnexpected(5, NmtState.STOPPED, NmtState.OPERATIONAL)]
    assert hear(machine, "705#85")[1:] == []
    machine.expect(None)
    assert hear(machine, "705#04")[1:] == []


def test_another_expectation_forgets_no_state() -> None:
    machine = master()
    hear(machine, "705#05")
    machine.expect(NmtState.STOPPED)
    assert machine.state is NmtState.OPERATIONAL
    machine.handle_timeout(100 * MS)
    machine.handle_timeout(400 * MS)
    assert NodeGuardingLost(5, NmtState.OPERATIONAL, 300 * MS) in take_events(machine.out)
    hear(machine, "705#85", 410 * MS)
    machine.expect(NmtState.PRE_OPERATIONAL)  # what is unexpected now is reported, though it was before
    unexpected = GuardingStateUnexpected(5, NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL)
    assert hear(machine, "705#05", 420 * MS)[1:] == [unexpected]


@pytest.mark.parametrize(("guard_time", "factor"), [(0, 1), (MS - 1, 1), (MS, 0), (MS, 256)])
def test_times_that_there_are_not(guard_time: int, factor: int) -> None:
    machine = GuardingMaster(Outbox(), 5)
    with pytest.raises(LocalProtocolError):
        machine.start(guard_time, factor, 0)
    assert machine.out.frames == []
    assert machine.deadline == NEVER


@pytest.mark.parametrize("node_id", [0, 128])
def test_node_ids(node_id: int) -> None:
    for kind in (GuardingMaster, GuardingSlave):
        with pytest.raises(LocalProtocolError):
            kind(Outbox(), node_id)


# ---- both on one bus ----


@given(st.integers(0, 1000), st.integers(1, 5))
def test_on_a_bus_without_loss_nobody_is_lost(seed: int, factor: int) -> None:
    bus = Bus(seed, delay=(0, 10 * MS))
    asking = bus.attach(GuardingMaster(Outbox(), 5))
    answering = bus.attach(slave(30 * MS * factor + 20 * MS))
    asking.start(30 * MS, factor, bus.now)
    bus.run(1000 * MS)
    kinds = {type(each) for each in bus.events}
    assert kinds == {GuardingAnswered}
    assert len(bus.events) >= 32
    asking.stop()
    bus.run(1000 * MS)
    assert [each for each in bus.events if not isinstance(each, GuardingAnswered)] == [LifeGuardingLost(5, answering.life_time)]


@given(st.integers(0, 1000))
def test_loss_is_noticed_only_as_loss(seed: int) -> None:
    """Each NodeGuardingLost has its recovery, unless it is the last; answers that are taken alternate."""
    bus = Bus(seed, delay=(0, 10 * MS), loss=0.4, copies=0.2)
    asking = bus.attach(GuardingMaster(Outbox(), 5))
    bus.attach(slave())
    asking.start(30 * MS, 2, bus.now)
    bus.run(3000 * MS)
    turns = [type(each) for each in bus.events if isinstance(each, NodeGuardingLost | NodeGuardingRecovered)]
    assert turns == [NodeGuardingLost, NodeGuardingRecovered] * (len(turns) // 2) + [NodeGuardingLost] * (len(turns) % 2)


# ---- in a device ----


def guarded_device(guard_time: int = 0, factor: int = 0, heartbeat_ms: int = 0) -> ObjectDictionary:
    own = [standard_object(0x100C, guard_time), standard_object(0x100D, factor)]
    return io_device(heartbeat_ms=heartbeat_ms).with_objects(own)


def test_a_device_answers_in_every_state_that_is_on_the_bus() -> None:
    bench = DeviceBench(guarded_device())
    assert bench.tell(ASK, ASK) == ["705#7F", "705#FF"]
    assert bench.tell(START, ASK) == ["705#05"]
    assert bench.tell(STOP, ASK) == ["705#84"]
    assert bench.tell(RESET_COMMUNICATION, ASK) == ["705#00", "705#7F"]
    assert bench.tell(RESET_NODE, ASK) == ["705#00", "705#7F"]


def test_a_device_whose_dictionary_has_no_guarding_does_not_answer() -> None:
    bench = DeviceBench()
    assert bench.tell(ASK) == []
    assert Frame.parse(ASK).key not in bench.network.can_ids()


def test_a_heartbeat_excludes_guarding() -> None:
    bench = DeviceBench(guarded_device(heartbeat_ms=100))
    assert bench.tell(ASK) == []
    assert bench.write(0x100C, 0, 50, 2) is None
    assert bench.write(0x100D, 0, 2, 1) is None
    assert bench.wait(100) == ["100 705#7F"]
    assert bench.tell(ASK) == []
    assert bench.write(0x1017, 0, 0, 2) is None
    assert bench.tell(ASK, ASK) == ["705#7F", "705#FF"]
    assert bench.write(0x1017, 0, 100, 2) is None
    assert bench.others == ["705#7F"]
    assert bench.tell(ASK) == []
    assert bench.wait(200) == ["200 705#7F", "300 705#7F"]  # nobody guards, and that is no error


def test_a_device_that_nobody_asks_any_more() -> None:
    bench = DeviceBench(guarded_device())
    assert bench.write(0x100C, 0, 50, 2) is None
    assert bench.write(0x100D, 0, 3, 1) is None
    bench.tell(START)
    assert bench.wait(1000) == []  # it has not begun
    assert bench.tell(ASK) == ["705#05"]
    assert bench.wait(200) == ["1150 085#3081110000000000"]
    assert bench.node.state is NmtState.PRE_OPERATIONAL
    assert [event.life_time for event in bench.seen(LifeGuardingLost)] == [150 * MS]
    assert bench.number(0x1001) == 0x11
    assert bench.number(0x1003, 1) == 0x8130
    assert bench.tell(ASK) == ["705#FF", "085#0000000000000000"]
    assert bench.number(0x1001) == 0


@pytest.mark.parametrize(
    ("behaviour", "state"), [(0, NmtState.PRE_OPERATIONAL), (1, NmtState.OPERATIONAL), (2, NmtState.STOPPED)]
)
def test_error_behaviour(behaviour: int, state: NmtState) -> None:
    bench = DeviceBench(guarded_device(50, 2))
    bench.write(0x1029, 1, behaviour, 1)
    bench.tell(START, ASK)
    bench.wait(200)
    assert bench.node.state is state


@pytest.mark.parametrize(("index", "value", "size"), [(0x100C, 0, 2), (0x100D, 0, 1), (0x1017, 500, 2)])
def test_the_error_ends_when_guarding_does(index: int, value: int, size: int) -> None:
    bench = DeviceBench(guarded_device(50, 2))
    bench.tell(ASK)
    assert bench.wait(100) == ["100 085#3081110000000000"]
    assert bench.write(index, 0, value, size) is None
    assert "085#0000000000000000" in bench.others
    assert bench.number(0x1001) == 0


def test_the_error_ends_with_a_reset_and_life_guarding_begins_anew() -> None:
    bench = DeviceBench(guarded_device(50, 2))
    bench.tell(ASK)
    bench.wait(100)
    assert bench.tell(RESET_COMMUNICATION) == ["705#00", "085#0000000000000000"]
    assert bench.wait(1000) == []
    assert bench.tell(ASK) == ["705#7F"]
    assert bench.wait(100) == ["1200 085#3081110000000000"]


def test_an_unrelated_write_leaves_the_life_time_running() -> None:
    bench = DeviceBench(guarded_device(50, 2))
    bench.tell(ASK)
    bench.wait(90)
    bench.write(0x100C, 0, 50, 2)
    assert bench.wait(10) == ["100 085#3081110000000000"]


# ---- from a RemoteNode ----


def test_a_remote_node_guards_a_device() -> None:
    pair = Pair(guarded_device(50, 3))
    pair.remote.start_guarding(50 * MS, 3, pair.bus.now)
    pair.bus.run(200 * MS)
    assert len(pair.bus.take_events(GuardingAnswered)) == 4
    assert pair.remote.nmt_state is NmtState.PRE_OPERATIONAL
    assert [each.state for each in pair.bus.take_events(HeartbeatReceived)] == [NmtState.PRE_OPERATIONAL] * 4
    pair.remote.stop_guarding()
    pair.bus.run(200 * MS)
    assert len(pair.bus.take_events(LifeGuardingLost)) == 1
    assert pair.bus.take_events(GuardingAnswered) == []


def test_a_lost_node_answers_no_sdo() -> None:
    pair = Pair(guarded_device(), boot=False)
    pair.remote.start_guarding(20 * MS, 2, pair.bus.now)
    request = pair.remote.read(0x1000, pair.bus.now)
    pair.bus.run(100 * MS)
    assert len(pair.bus.take_events(NodeGuardingLost)) == 1
    assert [each.request_id for each in pair.bus.take_events(SdoAborted)] == [request]
    pair.local.boot(pair.bus.now)
    pair.bus.run(100 * MS)
    assert len(pair.bus.take_events(NodeGuardingRecovered)) == 1
