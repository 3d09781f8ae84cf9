"""A World: time passes where it is let, each seed gives its own frames, and the same ones each time."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable

import pytest

from canopen_proto.abort import AbortCode
from canopen_proto.datatypes import DataType
from canopen_proto.declared import DeclaredDevice, Nameplate, variable
from canopen_proto.dictionary import Access, Object, ObjectNotFoundError, Variable
from canopen_proto.frame import Frame
from canopen_proto.local_node import LocalNode
from canopen_proto.machine import MILLISECOND, NEVER, SECOND, LocalProtocolError, Outbox
from canopen_proto.network import Network
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_proto.procedures import SdoTransferError, sleep
from canopen_proto.sdo.client import SdoClient
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.settings import Shape
from canopen_proto.testing import (
    BusOff,
    Copy,
    Corrupt,
    Delay,
    DidNotHappenError,
    Fault,
    Lie,
    Lose,
    Pause,
    Refuse,
    Reorder,
    Replace,
    Reset,
    SecondMaster,
    World,
    any_frame,
    boot_up,
    can_frame,
    emcy,
    heartbeat,
    nmt,
    sdo_abort,
    sdo_answer,
    sdo_read,
    sdo_request,
    sdo_write,
    tpdo,
)
from tests.core.full_device import full_device

STANDARD = drive_dictionary(Shape.STANDARD)


def full(out: Outbox) -> LocalNode:
    """A device with an object of each kind."""
    return LocalNode(out, 5, full_device())


def beating(*faults: Fault, seed: int = 0) -> World:
    """A drive that sends its heartbeat each 100 ms, for a second."""
    world = World(seed, faults)
    world.drive(5)
    world.master().write(5, "producer_heartbeat_time", 100)
    world.advance(SECOND)
    return world


def times(world: World, text: str) -> list[float]:
    """When frames came whose candump text begins so, in ms, to 10 ms."""
    return [round(each.time / MILLISECOND, -1) for each in world.bus().trace if str(each.frame).startswith(text)]


# ---- time, seeds, order ----


def test_an_hour_passes_at_once_and_exactly() -> None:
    world = beating()
    world.advance(3600 * SECOND)
    assert world.now >= 3601 * SECOND
    assert len(times(world, "705#7F")) == pytest.approx(36_010, abs=2)


LIFE = """
from canopen_proto.testing import *
from canopen_proto import SECOND, NmtCommand
world = World({seed}, [Lose(heartbeat(), chance=0.2), Corrupt(sdo_answer(), chance=0.1), Delay(tpdo(5), by=SECOND, chance=0.3)])
for node_id in (5, 6, 7):
    world.drive(node_id)
master = world.master()
for node_id in (5, 6, 7):
    try:
        master.write(node_id, "producer_heartbeat_time", 100)
    except Exception as error:
        print(error)
master.command(NmtCommand.START, 0)
world.advance(20 * SECOND)
for each in world.bus().trace:
    print(*each)
"""


def life(seed: int, hash_seed: str) -> str:
    environment = {**os.environ, "PYTHONHASHSEED": hash_seed, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", LIFE.format(seed=seed)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout


@pytest.mark.thorough
def test_a_seed_gives_the_same_frames_in_each_process() -> None:
    one, other = life(1, "0"), life(1, "1234")
    assert one == other
    assert one.count("\n") > 500
    assert one != life(2, "0")


def test_at_one_time_the_seed_says_who_acts_first() -> None:
    def order(seed: int) -> list[int]:
        world = World(seed)
        for node_id in range(1, 9):
            world.drive(node_id).set_value(0x1017, 0, 100, 0)
        world.advance(130 * MILLISECOND)
        return [each.frame.can_id for each in world.bus().trace[-8:]]

    assert order(1) == order(1)
    assert len({tuple(order(seed)) for seed in range(5)}) > 1


def test_what_does_not_come_is_told_with_the_last_frames() -> None:
    world = beating()
    with pytest.raises(DidNotHappenError, match=r"emergency of node 5 did not .*: 2 s are over.\n.*frames on can0(.|\n)*705#7F"):
        world.run_until(emcy(5), limit=2 * SECOND)
    empty = World()
    with pytest.raises(DidNotHappenError, match="nothing more will happen in this world"):
        empty.run_until(lambda: False)


def test_run_until_a_frame_comes() -> None:
    world = beating()
    began = world.now
    world.run_until(heartbeat(5), limit=SECOND)
    assert 0 < world.now - began <= 101 * MILLISECOND


def test_a_function_that_the_world_calls_cannot_let_time_pass() -> None:
    world = World()
    world.listener(lambda frame, now: world.advance(MILLISECOND))
    with pytest.raises(LocalProtocolError, match="time is passing already"):
        world.drive(5)
    world.bus().send("705#7F")
    with pytest.raises(LocalProtocolError, match="time is passing already"):
        world.advance(SECOND)


def test_machines_of_ones_own_are_a_participant() -> None:
    world = World()
    world.drive(5)
    network = Network()
    client = SdoClient(network.out, 5)
    network.attach(client)
    host = world.host(network)
    world.advance(MILLISECOND)
    client.upload(0x1000, 0, world.now)
    world.run_until(sdo_answer(5))
    world.advance(0)
    assert [type(event).__name__ for event in host.events] == ["SdoUploaded"]
    world.leave(host)
    client.upload(0x1000, 0, world.now)
    world.advance(SECOND)
    assert world.bus().participants == [world.bus().participants[0]]


def test_a_listener_hears_all_frames_but_its_own() -> None:
    heard: list[str] = []
    world = World()
    ear = world.listener(lambda frame, now: heard.append(str(frame)))
    drive = world.drive(5)
    world.send(ear, Frame.parse("000#0105"))
    world.advance(MILLISECOND)
    assert heard[0] == "705#00"
    assert "000#0105" not in heard
    assert drive.state is NmtState.OPERATIONAL


def test_each_bus_is_its_own() -> None:
    world = World()
    world.drive(5)
    world.drive(6, bus="can1")
    world.advance(MILLISECOND)
    assert [[str(each.frame) for each in bus.trace] for bus in world.buses.values()] == [["705#00"], ["706#00"]]


def test_what_a_device_stores_it_has_after_a_reset() -> None:
    world = World(faults=[Reset(5, on=nmt("start", 5))])
    world.device(full, bus="can0")
    master = world.master()
    master.write(5, "producer_heartbeat_time", 321)
    master.write(5, (0x1010, 1), 0x65766173)
    master.command(NmtCommand.START, 5)
    world.run_until(boot_up(5))
    assert master.read(5, "producer_heartbeat_time") == 321


def test_a_node_id_is_given_once() -> None:
    world = World()
    world.drive(5)
    with pytest.raises(LocalProtocolError, match="node 5 in this world already"):
        world.device(STANDARD, 5)
    with pytest.raises(LocalProtocolError, match="no node 9: give its dictionary"):
        world.master().node(9)


def test_a_procedure_that_takes_too_long_is_cancelled() -> None:
    world = World()
    master = world.master()
    with pytest.raises(DidNotHappenError, match="1 s are over"):
        master.run(sleep(2 * SECOND), limit=SECOND)
    world.advance(SECOND)
    assert not master.runs.runner.busy


# ---- faults ----


def test_by_position() -> None:
    assert times(beating(), "705#7F") == [0, 100, 200, 300, 400, 500, 600, 700, 800, 900, 1000]
    world = beating(Lose(heartbeat(5), nth=(3, 4)))
    assert [each.fate for each in world.bus().trace if str(each.frame) == "705#7F"] == ["", "", "lost", "lost", *[""] * 7]


def test_by_chance_and_by_predicate() -> None:
    def lost(fault: Fault, seed: int = 0) -> int:
        return sum(each.fate == "lost" for each in beating(fault, seed=seed).bus().trace)

    assert lost(Lose(heartbeat(5), chance=0.0)) == 0
    assert {lost(Lose(heartbeat(5), chance=0.5), seed) for seed in range(6)} > {4}
    assert lost(Lose(when=lambda frame: frame.data == b"\x7f")) == 11
    assert lost(Lose(heartbeat(5), since=250 * MILLISECOND, until=550 * MILLISECOND)) == 3
    assert lost(Lose(heartbeat(5), bus="can1")) == 0


def test_a_late_frame_holds_up_those_behind_it_and_a_loose_one_does_not() -> None:
    late = Delay(heartbeat(5), by=250 * MILLISECOND, nth=3)
    assert times(beating(late), "705#7F") == [0, 100, 450, 450, 450, 500, 600, 700, 800, 900, 1000]
    loose = Reorder(heartbeat(5), by=250 * MILLISECOND, nth=3, gateway="to Ethernet")
    assert times(beating(loose), "705#7F") == [0, 100, 300, 400, 450, 500, 600, 700, 800, 900, 1000]


def test_copies_and_changed_data() -> None:
    assert times(beating(Copy(heartbeat(5), nth=3, later=50 * MILLISECOND)), "705#7F")[2:5] == [200, 250, 300]
    assert times(beating(Replace(heartbeat(5), data=b"\x05", nth=3)), "705#05") == [200]
    assert times(beating(Corrupt(heartbeat(5), flip=b"\xff", nth=3)), "705#80") == [200]
    odd = [each.frame.data[0] for each in beating(Corrupt(heartbeat(5), nth=3)).bus().trace if each.fate == "corrupted"]
    assert [(byte ^ 0x7F).bit_count() for byte in odd] == [1]


def test_two_faults_meet_the_same_frame() -> None:
    world = beating(Copy(heartbeat(5), nth=3, later=50 * MILLISECOND), Delay(heartbeat(5), nth=3, by=20 * MILLISECOND))
    assert times(world, "705#7F")[2:5] == [220, 270, 300]


def test_one_receiver_alone_misses_a_frame() -> None:
    world = World(faults=[Lose(nmt("start"), to=5)])
    one, other = world.drive(5), world.drive(6)
    world.bus().send("000#0100")
    world.advance(MILLISECOND)
    assert (one.state, other.state) == (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)
    world.bus().saw(nmt("start"))


def test_a_device_refuses_and_does_not_execute() -> None:
    world = World(faults=[Refuse(5, "producer_heartbeat_time", AbortCode.LOCAL_CONTROL, nth=1)])
    drive, master = world.drive(5), world.master()
    with pytest.raises(SdoTransferError, match="0x08000021"):
        master.write(5, "producer_heartbeat_time", 100)
    assert drive.values.store[0x101700] == 0
    master.write(5, "producer_heartbeat_time", 100)
    world.bus().saw(sdo_abort(5, AbortCode.LOCAL_CONTROL)).times(1)
    assert "[node 5 answers otherwise]" in world.bus().saw(sdo_write(5, "producer_heartbeat_time", 100)).text


def test_only_what_begins_a_transfer_is_refused() -> None:
    world = World(faults=[Refuse(5, nth=2)])
    world.drive(5)
    world.advance(SECOND)
    for request in ("605#A008100002000000", "605#A300000000000000"):  # a block upload of 0x1008, and its start
        world.bus().send(request)
        world.advance(MILLISECOND)
    world.bus().never(sdo_abort(5))
    world.bus().send("605#4018100100000000")
    world.advance(MILLISECOND)
    world.bus().saw(sdo_abort(5)).times(1)


def test_frames_inside_of_a_block_transfer_begin_none() -> None:
    """Whatever their bytes look like: here a sub-block of 0x60 segments, of which 0x41 came, and a CRC."""
    assert not sdo_read(5, 0x6041).fits(Frame.parse("605#A241600000000000"))
    assert not sdo_write(5, 0x6041).fits(Frame.parse("605#C141600000000000"))
    assert sdo_read(5, 0x6041).fits(Frame.parse("605#A441600020000000"))
    assert sdo_write(5, 0x6041).fits(Frame.parse("605#C641600009000000"))


@pytest.mark.parametrize("text", ["123#11.22", " 123#1122 ", "123#1122"])
def test_a_frame_fits_however_candump_writes_it(text: str) -> None:
    """Else `never` would hold whatever comes."""
    assert can_frame(text).fits(Frame.parse("123#112233"))
    assert can_frame("705#R0").fits(Frame.parse("705#R"))
    world = World()
    world.bus().send("123#112233")
    world.advance(MILLISECOND)
    assert world.bus().saw(text).frame == Frame.parse("123#112233")
    with pytest.raises(AssertionError):
        world.bus().never(text)


def test_a_frame_that_is_meant_as_a_whole_is_no_beginning() -> None:
    """A device whose PDO has two bytes too many does not send this frame."""
    world = World()
    world.bus().send("181#01020304")
    world.advance(MILLISECOND)
    world.bus().never(Frame.parse("181#0102"))
    world.bus().never(Frame.parse("181#"))
    assert world.bus().saw(Frame.parse("181#01020304")).frame.data == bytes((1, 2, 3, 4))
    with pytest.raises(AssertionError, match="never saw the frame 181#0102"):
        world.bus().saw(Frame.parse("181#0102"))


@pytest.mark.parametrize(
    "frames",
    [
        ("605#2B4060000F000000", "585#6040600000000000"),
        ("605#224060000F000000", "585#6040600000000000"),  # it does not say how many bytes there are
        ("605#2140600002000000", "585#6040600000000000", "605#0B0F000000000000", "585#2000000000000000"),  # in segments
        (
            "605#C240600002000000", "585#A040600001000000", "605#810F000000000000",
            "585#A201010000000000", "605#D500000000000000", "585#A100000000000000",
        ),  # in a block
    ],
)  # fmt: skip
def test_a_value_is_seen_however_it_is_written(frames: tuple[str, ...]) -> None:
    """A program of another stack may write two bytes in segments: `never` must not hold then."""
    world = World()
    for text in frames:
        world.bus().send(text)
        world.advance(MILLISECOND)
    world.bus().saw(sdo_write(5, "controlword", 0x0F)).times(1)
    world.bus().never(sdo_write(5, "controlword", 0x06))
    world.bus().never(sdo_write(5, "statusword", 0x0F))
    with pytest.raises(AssertionError):
        world.bus().never(sdo_write(5, "controlword", 0x0F))


def test_nodes_that_fall_silent_together_are_late_each() -> None:
    """A world has no recorder that could have stood still."""
    world = World(faults=[Pause(each, at=SECOND, lasts=2 * SECOND) for each in (5, 6)])
    for node_id in (5, 6):
        world.drive(node_id)
        world.master().write(node_id, "producer_heartbeat_time", 100)
    world.advance(2 * SECOND)
    world.bus().send("080#")
    world.advance(MILLISECOND)
    assert sorted((each.finding.rule, each.finding.node_id) for each in world.bus().observer.findings) == [
        ("late heartbeat", 5),
        ("late heartbeat", 6),
    ]


def test_a_device_lies_about_its_identity() -> None:
    world = World(faults=[Lie(5, (0x1018, 1), 0x1234)])
    world.drive(5)
    assert world.master().read(5, (0x1018, 1)) == 0x1234


def test_a_device_that_pauses_is_late_and_loses_nothing() -> None:
    world = beating(Pause(5, at=250 * MILLISECOND, lasts=200 * MILLISECOND))
    assert times(world, "705#7F")[2:5] == [200, 450, 500]
    gone = beating(Pause(5, on=heartbeat(5), nth=3))
    assert times(gone, "705#7F") == [0, 100, 200]
    with pytest.raises(SdoTransferError, match="did not answer"):
        gone.master().read(5, "device_type")


def test_a_device_goes_bus_off_and_returns() -> None:
    world = beating(BusOff(5, at=250 * MILLISECOND, lasts=300 * MILLISECOND))
    assert times(world, "705#7F") == [0, 100, 200, 600, 700, 800, 900, 1000]
    world.bus().saw(emcy(5, 0x8140)).within(551 * MILLISECOND).then(emcy(5, 0))


def test_a_second_master_stops_all() -> None:
    world = beating(SecondMaster(("000#0200", "000#0100"), at=500 * MILLISECOND, apart=100 * MILLISECOND))
    world.bus().saw(nmt("stop")).then(nmt("start")).then(tpdo(5))
    assert world.bus().saw(can_frame("000#02")).frame == Frame.parse("000#0200")
    echo = beating(SecondMaster(("080#",), on=any_frame()))
    assert [each.sender for each in echo.bus().trace].count("2nd master") == len(echo.bus().trace) // 2


def test_faults_that_make_no_sense() -> None:
    for make in (
        lambda: Lose(chance=1.5),
        lambda: Lose(nth=0),
        lambda: Pause(5, on=heartbeat(5), at=1),
        lambda: Reset(128),
    ):
        with pytest.raises(LocalProtocolError):
            make()
    with pytest.raises(ValueError, match="candump"):
        SecondMaster(("nonsense",))


# ---- what was seen ----


def test_what_was_never_seen_is_told_with_what_came_nearest() -> None:
    bus = beating().bus()
    bus.saw(sdo_write(5, "producer_heartbeat_time", 100)).within(10 * MILLISECOND).then(heartbeat(5)).within(10 * MILLISECOND)
    with pytest.raises(AssertionError) as caught:
        bus.saw(sdo_write(5, "producer_heartbeat_time", 0x65))
    text = str(caught.value)
    assert text.startswith("can0 never saw SDO write of producer_heartbeat_time = 0x65 (101) to node 5")
    assert "What came nearest:" in text
    assert "write 1017:00 producer_heartbeat_time = 100" in text


def test_what_a_fault_took_is_told() -> None:
    bus = beating(Lose(boot_up(5))).bus()
    with pytest.raises(AssertionError, match=r"a fault took it:\n.*705#00.*\[lost\]"):
        bus.saw(boot_up(5))


def test_what_is_still_on_its_way_is_told() -> None:
    world = World()
    world.bus().send("000#0105")
    with pytest.raises(AssertionError, match="on its way: let time pass"):
        world.bus().saw(nmt("start", 5))
    world.advance(MILLISECOND)
    world.bus().saw(nmt("start", 5))


def test_too_late_too_often_and_never() -> None:
    bus = beating().bus()
    with pytest.raises(AssertionError, match=r"heartbeat of node 5 came 0\.\d+ ms behind .*, not within 0.1 ms"):
        bus.saw(heartbeat(5)).within(MILLISECOND // 10)
    with pytest.raises(AssertionError, match="heartbeat of node 5 came 11 times, not 3"):
        bus.saw(heartbeat(5)).times(3)
    with pytest.raises(AssertionError, match="can0 saw heartbeat of node 5:\n.*705#7F"):
        bus.never(heartbeat(5))
    bus.never(emcy())
    bus.mark()
    bus.never(heartbeat(5))
    bus.saw(heartbeat(5), after=0).times(11)


def test_a_value_of_several_segments_is_seen_with_the_frame_that_confirms_it() -> None:
    label = Object.of("label", [Variable(0x2100, 0, "label", DataType.VISIBLE_STRING, Access.RW)])
    world = World()
    world.device(full_device(label), 5)
    world.master().write(5, "label", "more than four")
    seen = world.bus().saw(sdo_write(5, "label", "more than four"))
    assert seen.frame.can_id == 0x585
    assert "written" in seen.text
    world.bus().never(sdo_write(5, "label", "another one"))


def test_patterns_are_values_and_say_what_they_mean() -> None:
    assert sdo_read(5, 0x6041) == sdo_read(5, 0x6041)
    assert str(sdo_read(5, 0x6041)) == "SDO read of 0x6041:00 of node 5"
    assert str(nmt("reset_node", 5)) == "NMT command reset node to node 5"
    assert str(sdo_request(5)) == "an SDO request to node 5"
    assert str(heartbeat(5, NmtState.STOPPED)) == "heartbeat of node 5, stopped"
    for wrong in (lambda: nmt("go"), lambda: tpdo(5, 5), lambda: sdo_read(0, 0x6041)):
        with pytest.raises(LocalProtocolError):
            wrong()


def test_the_observer_tells_what_was_wrong() -> None:
    beating().bus().observer.clean()
    doubled = beating(Copy(heartbeat(5), nth=4)).bus().observer
    with pytest.raises(AssertionError, match=r"What was wrong on can0:\n.* copied: node 5: "):
        doubled.clean()
    doubled.clean(but=["copied"])
    with pytest.raises(ValueError, match="no rule 'nonsense'"):
        doubled.clean(but=["nonsense"])


def test_a_new_heartbeat_time_and_a_pause_make_no_copy() -> None:
    """At every phase of the heartbeat."""
    for moment in range(0, 104, 4):
        world = beating()
        world.advance(moment * MILLISECOND)
        world.master().write(5, "producer_heartbeat_time", 90)
        world.advance(SECOND + moment * MILLISECOND)
        world.add_faults(Pause(5, at=world.now, lasts=120 * MILLISECOND))
        world.advance(SECOND)
        world.bus().observer.clean()


def test_a_node_that_falls_silent_is_told_as_often_as_it_is_asked() -> None:
    world = beating()
    world.add_faults(Pause(5, at=world.now))
    world.advance(SECOND)
    late = "late heartbeat: node 5: no heartbeat for more than 250 ms, and it sends one in 100 ms; the last one came"
    for _ in range(2):
        assert [late in str(found) for found in world.bus().observer.findings] == [True]
        with pytest.raises(AssertionError, match="late heartbeat: node 5"):
            world.bus().observer.clean()
    world.bus().send("080#")
    world.advance(SECOND)
    assert len(world.bus().observer.findings) == 1


def test_for_good_is_for_good() -> None:
    world = beating(BusOff(5, at=500 * MILLISECOND, lasts=NEVER))
    world.advance(3600 * SECOND)
    assert times(world, "705#7F")[-1] == 400


# ---- what is refused at once, and what is taken ----


class Station(DeclaredDevice):
    nameplate = Nameplate("Station")
    level = variable(0x2000, "Level", DataType.INTEGER16, 7)


@pytest.mark.parametrize(("wrong", "told"), [
    (lambda world: world.advance(0.5), r"advance is 0.5: times are nanoseconds here; 0.5 seconds are 0.5 \* SECOND"),
    (lambda world: world.advance(2), r"2 seconds are 2 \* SECOND"),
    (lambda world: world.advance(-SECOND), "advance is -1000000000: a time is never negative"),
    (lambda world: world.advance("2"), r"advance is '2': it takes nanoseconds, such as 100 \* MILLISECOND"),
    (lambda world: world.advance(True), "it takes nanoseconds"),
    (lambda world: world.advance(math.inf), "use NEVER"),
    (lambda world: world.after(0.1, print), r"after is 0.1: .* 0.1 \* SECOND"),
    (lambda world: world.run_until(lambda: True, limit=10), r"limit is 10: .* 10 \* SECOND"),
    (lambda world: world.run_until(heartbeat), r"heartbeat.* is no pattern of frames.*: call it, heartbeat\(...\)"),
    (lambda world: world.bus().saw(5), "5 is no pattern of frames"),
    (lambda world: world.bus().saw("605#4"), "not a classical CAN frame"),
    (lambda world: world.bus().saw("705#00").within(0.1), r"within is 0.1: .* 0.1 \* SECOND"),
    (lambda world: world.bus().saw("705#00", after=1.5), r"after is 1.5"),
    (lambda world: world.bus().saw(sdo_write(5, "controlwort")), "controlwort is no object of node 5 .*did you mean controlword"),
    (lambda world: world.bus().never(heartbeat(300)), "node-ID 300 is outside 1..127"),
    (lambda world: world.run_until(False), "a condition is a function"),
    (lambda world: world.bus().saw("705#00").times("3"), "times takes a number from 1 on, not '3'"),
    (lambda world: world.add_faults([Lose()]), r"give faults one by one: add_faults\(\*faults\)"),
    (lambda world: world.drive("my.eds"), "'my.eds' is no node-ID; a drive of a file is a device: sim_node"),
    (lambda world: Lose(test_what_is_clear_is_taken), "a marker takes faults, and no class of them"),
    (lambda world: world.add_faults("lose"), "'lose' is no fault, such as Lose"),
    (lambda world: world.add_faults(Refuse(5, "controlwort")), "did you mean controlword"),
    (lambda world: world.add_faults(Lose(sdo_read(5, "statuswort"))), "did you mean statusword"),
    (lambda world: world.add_faults(Lie(5, "controlword", 70_000)), "70000"),
    (lambda world: world.add_faults(Lie(5, "manufacturer_device_name", "longer")), "6 bytes; an answer of one frame has 1..4"),
    (lambda world: world.device(LocalNode, 6), "is no dictionary, no class of a DeclaredDevice, and no function"),
    (lambda world: world.device(5), "5 is no dictionary"),
    (lambda world: world.device(Station), "which node-ID is the device to have"),
    (lambda world: world.device(STANDARD), "which node-ID is the device to have"),
    (lambda world: world.device(lambda out: out), "the function that makes a device returned"),
    (lambda world: Lose(nth="3"), r"nth is a number from 1 on, or several: nth=3, nth=\(1, 3\), not nth='3'"),
    (lambda world: Lose(nth=(1, "3")), r"the first frame is number 1"),
    (lambda world: Lose(nth=0), "the first frame is number 1"),
    (lambda world: Lose(chance="0.5"), "a chance is 0 to 1, not '0.5'"),
    (lambda world: Lose(when=5), "when is a function of a frame, not 5"),
    (lambda world: Lose(heartbeat), "call it, heartbeat"),
    (lambda world: Lose(to=200), "node-ID 200 is outside"),
    (lambda world: Lose(since=-1), "since of Lose is -1"),
    (lambda world: Delay(by=-SECOND), "by of Delay is -1000000000: a time is never negative"),
    (lambda world: Delay(by=0.5), r"by of Delay is 0.5: .* 0.5 \* SECOND"),
    (lambda world: Copy(later=1), "later of Copy is 1"),
    (lambda world: Pause(5, at=-1), "at of Pause is -1"),
    (lambda world: Pause(5, lasts=1), "lasts of Pause is 1"),
    (lambda world: BusOff(5, lasts=2.5), "lasts of BusOff is 2.5"),
    (lambda world: Replace(data=bytes(9)), "data has 9 bytes; a CAN frame has 8 at most"),
    (lambda world: Replace(data="00"), r"data is bytes, such as data=bytes\(8\), not '00'"),
    (lambda world: Corrupt(flip=1), "flip is bytes"),
    (lambda world: Refuse(5, code="abort"), "an abort code is a number of 32 bits"),
    (lambda world: Refuse(0, 0x6040), "node-ID 0 is outside"),
    (lambda world: Lie(200, 0x6040, 1), "node-ID 200 is outside"),
    (lambda world: SecondMaster(at=SECOND), "what does the second master send"),
    (lambda world: SecondMaster("000#1"), "not a classical CAN frame"),
    (lambda world: Reorder(tpdo(5)), r'only a gateway does not. .* Reorder\(..., gateway="CAN to Ethernet"\)'),
])  # fmt: skip
def test_a_mistake_is_told_at_once_with_the_right_form(wrong: Callable[[World], object], told: str) -> None:
    world = World()
    world.drive(5)
    with pytest.raises((LocalProtocolError, ValueError), match=told):
        wrong(world)


def test_a_fault_for_a_device_that_comes_later_is_checked_when_it_comes() -> None:
    world = World(faults=[Refuse(5, "controlwort"), Refuse(6, "level")])
    world.device(Station, 6)
    with pytest.raises(ObjectNotFoundError, match="did you mean controlword"):
        world.drive(5)


def test_what_is_clear_is_taken() -> None:
    world = World(faults=[Lose("705#7F", nth=2), SecondMaster("000#0105", at=SECOND)])
    world.drive(5).set_value(0x1017, 0, 100, 0)
    made = [world.device(Station, 6), world.device(lambda out: Station(out, 7))]
    assert [type(each) for each in made] == [LocalNode, LocalNode]
    assert world.master().read(7, "level") == 7
    world.advance(0.5 * SECOND)
    assert world.now > SECOND // 2
    world.run_until("705#7F", limit=0.2 * SECOND)
    world.run_until(Frame.parse("705#05"))
    bus = world.bus()
    bus.saw("705#").then("000#0105").then("705#05").within(0.2 * SECOND)
    bus.never("123#")
    bus.observer.clean(but="late heartbeat")


def test_what_came_too_soon_is_told_and_what_is_on_its_way() -> None:
    world = beating()
    bus, master = world.bus(), world.master()
    with pytest.raises(AssertionError, match=r"It came before that:\n.* write 1017:00 producer_heartbeat_time = 100"):
        bus.saw(heartbeat(5)).then(sdo_write(5, "producer_heartbeat_time"))
    master.command(NmtCommand.START, 5)
    with pytest.raises(AssertionError, match="It was sent just now, and is on its way"):
        bus.saw(nmt("start", 5))


# ---- what the faults have done ----


def test_each_fault_tells_how_often_it_has_hit_and_when_last() -> None:
    faults = [
        Lose(heartbeat(5), nth=(2, 4)),
        Pause(5, at=450 * MILLISECOND, lasts=20 * MILLISECOND),
        Reset(5, on=nmt("start", 5)),
        BusOff(6, at=SECOND),
        SecondMaster(("000#0200", "000#0100"), at=800 * MILLISECOND),
        Refuse(5, (0x1018, 1)),
        Refuse(5, "controlword", AbortCode.LOCAL_CONTROL, since=SECOND),
        Lie(5, (0x1018, 2), 1),
        Corrupt(tpdo(5), flip=b"\x01", to=6),
        Delay(any_frame(), when=bool, by=SECOND, chance=0),
        Reorder(emcy(5), gateway="to Ethernet"),
    ]
    world = beating(*faults)
    with pytest.raises(SdoTransferError):
        world.master().read(5, (0x1018, 1))
    assert world.fault_lines == [
        "never hit: Reset node 5, on=NMT command start to node 5",
        "never hit: BusOff node 6, at=1 s",
        "never hit: Refuse controlword of node 5, since=1 s, code=0x08000021",
        "never hit: Lie about 0x1018:02 of node 5, value=1",
        "never hit: Corrupt TPDO 1 of node 5, to=6, flip=01",
        "never hit: Delay any frame, chance=0, when=bool",
        "never hit: Reorder an emergency of node 5, gateway=to Ethernet",
        "Lose heartbeat of node 5, nth=(2, 4): 2 times, last at 0.300208 s",
        "Pause node 5, at=0.45 s, lasts=0.02 s: once at 0.450000 s",
        "SecondMaster 000#0200 000#0100, at=0.8 s: once at 0.800000 s",
        "Refuse 0x1018:01 of node 5: once at 1.000624 s",
    ]
