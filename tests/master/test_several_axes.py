"""Several drives on one node: the master's devices, a chain with two joints on one node, the machine file, the blocking API."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial

import pytest

from canopen_data import DictionaryError, load_dictionary
from canopen_master import AxisSettings, Chain, ChainFaultError, ChainSettings, Host, Master, Watchdog, open_master
from canopen_master.direct.drive import DirectDrive
from canopen_master.machine_file.toml_text import machine_text, parse_machine
from canopen_master.motion.chain_file import ChainDescription, JointDescription
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402.modes import Mode
from canopen_proto.drives.cia402.states import State, state_of
from canopen_proto.machine import LocalProtocolError, Outbox
from canopen_proto.multiplexer import mux
from canopen_proto.nmt import NmtState
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings
from tests.loops import loop
from tests.master.world import BUS, drives, simulated, virtual_time

TWO = drive_dictionary(axes=2)
ONE = drive_dictionary()
SETTINGS = AxisSettings(counts_per_unit=1_000.0, homing_method=35)
BOTH = DriveSettings(further_axes=(DriveSettings(),))
SHOULDER = (("one", 3, 0), ("two", 3, 1))


def chain_of(master: Master, *joints: tuple[str, int, int], name: str = "arm", mode: Mode | None = None) -> Chain:
    """A chain of joints: name, node-ID, axis. Node 3 has two axes, node 4 one."""
    for node_id, dictionary in ((3, TWO), (4, ONE)):
        master.node(node_id, dictionary)
    bus = next(iter(master.buses))
    described = tuple(JointDescription(each, bus, node_id, axis=axis) for each, node_id, axis in joints)
    return master.chain(ChainDescription(name, described), ChainSettings(mode=mode, own_pdos=True), axes=SETTINGS)


def two_axes(out: Outbox) -> DriveNode:
    return DriveNode(out, 3, BOTH)


def one_axis(out: Outbox) -> DriveNode:
    return DriveNode(out, 4, DriveSettings())


@asynccontextmanager
async def cell(**options: float) -> AsyncIterator[tuple[Host, Master]]:
    async with simulated(makers=[two_axes, one_axis]) as host, open_master(BUS, **options) as master:  # type: ignore[arg-type]
        yield host, master


async def follow_path(arm: Chain, way: float = 2.0) -> None:
    """Each joint its own way: the second twice that of the first, backwards, and so on."""
    start = arm.desired_positions
    async for cycle in arm.cycles():
        share = (1 - math.cos(math.pi * min(cycle.time, 1.0))) / 2
        arm.set_positions([each + way * share * (-1) ** place * (place + 1) for place, each in enumerate(start)])
        if cycle.time >= 2.0:
            return


@pytest.mark.thorough(5)
@pytest.mark.parametrize("mode", [Mode.CYCLIC_SYNCHRONOUS_POSITION, Mode.INTERPOLATED_POSITION, Mode.PROFILE_POSITION])
@virtual_time
async def test_a_chain_with_two_joints_on_one_node_and_one_on_another_follows(mode: Mode) -> None:
    async with cell() as (host, master):
        arm = chain_of(master, *SHOULDER, ("three", 4, 0), mode=mode)
        await arm.initialise()
        await arm.home()
        await arm.follow()
        start = arm.positions
        await follow_path(arm)
        await loop.sleep(1.0)
        assert [here - there for here, there in zip(arm.positions, start, strict=True)] == pytest.approx([2, -4, 6], abs=0.1)
        assert [each.drive.mode for each in drives(host)] == [mode, mode]
        assert drives(host)[0].drives[1].mode == mode
        assert all(joint.is_homed for joint in arm.devices)
        assert [joint.where for joint in arm.devices][1] == "two (node 3 on virtual:test, axis 1)"
        await arm.shut_down()
        assert {each.state for node in drives(host) for each in node.drives} == {State.SWITCH_ON_DISABLED}
        assert [node.state for node in drives(host)] == [NmtState.STOPPED] * 2


@virtual_time
async def test_a_fault_of_one_axis_stops_the_chain_and_names_that_joint() -> None:
    async with cell() as (host, master):
        arm = chain_of(master, *SHOULDER)
        await arm.initialise()
        await arm.follow()
        node = drives(host)[0]
        node.raise_fault(0x3210, master.now(), axis=1)
        with pytest.raises(ChainFaultError) as caught:
            await follow_path(arm)
        assert caught.value.joint == "two"
        assert arm.devices[0].state is State.OPERATION_ENABLED
        assert arm.devices[1].state is State.FAULT
        await arm.recover()
        await follow_path(arm)


@virtual_time
async def test_an_axis_that_does_not_follow_is_the_one_that_is_named() -> None:
    async with cell() as (host, master):
        arm = chain_of(master, *SHOULDER)
        await arm.initialise()
        await arm.follow()
        drives(host)[0].block(True, master.now(), axis=1)
        with pytest.raises(ChainFaultError) as caught:
            await follow_path(arm, way=8.0)
        assert caught.value.joint == "two"


@virtual_time
async def test_a_lost_node_names_each_of_its_joints() -> None:
    async with cell(heartbeat_timeout=0.3) as (host, master):
        arm = chain_of(master, *SHOULDER, ("three", 4, 0))
        await arm.initialise()
        drives(host)[0].communication.heartbeat.set_period(0, host.now())
        await loop.sleep(1.0)
        with pytest.raises(
            ChainFaultError, match=r"was lost: no heartbeat for 0.3 s; and with it two, on the same node"
        ) as caught:
            await arm.home()
        assert caught.value.joint == "one"


@virtual_time
async def test_two_chains_on_one_node_leave_each_other_alone() -> None:
    async with cell() as (host, master):
        first, second = chain_of(master, SHOULDER[0], name="a"), chain_of(master, SHOULDER[1], name="b")
        await first.initialise()
        await first.follow()
        await second.initialise()
        await second.follow()
        start = first.positions
        await follow_path(first)
        await second.shut_down()
        node = drives(host)[0]
        assert node.state is NmtState.OPERATIONAL
        await follow_path(first)
        assert first.positions == pytest.approx([start[0] + 4.0], abs=0.1)
        await first.shut_down()
        assert node.state is NmtState.STOPPED


@virtual_time
async def test_devices_of_one_node_have_their_own_names_and_settings() -> None:
    async with cell() as (_, master):
        node = master.node(3, TWO)
        first, second = master.device(node), master.device(node, axis=1)
        assert (first.name, second.name) == ("node 3", "node 3, axis 1")
        assert master.device(node, "elbow", axis=1) is second
        assert (first.name, second.name, node.name) == ("node 3", "elbow", "node 3")
        with pytest.raises(LocalProtocolError, match="no axis 2 by"):
            master.device(node, axis=2)
        with pytest.raises(LocalProtocolError, match="drive 3, axis 1 is in use with other settings"):
            master.device(node, axis=1, settings=SETTINGS)


@virtual_time
async def test_two_axes_move_at_once_and_the_master_halts_both_when_it_is_left() -> None:
    async with simulated(makers=[two_axes]) as host:
        async with open_master(BUS) as master:
            node = master.node(3, TWO)
            await node.start()
            joints = [master.device(node, settings=SETTINGS, axis=axis) for axis in (0, 1)]
            async with loop.open_nursery() as nursery:
                for joint, target in zip(joints, (5.0, -5.0), strict=True):
                    nursery.start_soon(partial(master.run, drive.move_to(joint.axis, target, timeout=20 * 10**9)))
            assert [await node.read("0x6064"), await node.read("0x6864")] == pytest.approx([5_000, -5_000], abs=20)
            for joint in joints:
                await master.run(drive.set_mode(joint.axis, 3))
            await node.write("0x68FF", 2_000)
        moved = drives(host)[0].drives
        places = [f"node 3{axis} (node 3 on virtual:test{axis})" for axis in ("", ", axis 1")]
        assert sorted(halt.where for halt in master.halts) == places
        assert not any(halt.problem for halt in master.halts)
        assert not any(each._servo.is_moving for each in moved)


@virtual_time
async def test_the_watchdog_holds_each_axis_until_the_last_one_is_shut_down() -> None:
    async with simulated(makers=[two_axes]) as host, open_master(BUS, watchdog=Watchdog(required=True)) as master:
        node = master.node(3, TWO)
        await node.start()
        first, second = (master.device(node, axis=axis) for axis in (0, 1))
        store = drives(host)[0].values.store
        await master.run(drive.enable(first.axis))
        assert (store[mux(0x6007)], store[mux(0x6807)]) == (3, 0)
        await master.run(drive.enable(second.axis))
        assert (store[mux(0x6007)], store[mux(0x6807)]) == (3, 3)
        await master.run(drive.shut_down(first.axis))
        assert store[mux(0x1016, 1)] == Watchdog().entry, "the other axis still needs it"
        await master.run(drive.shut_down(second.axis))
        assert (store[mux(0x6007)], store[mux(0x6807)], store[mux(0x1016, 1)]) == (0, 0, 0)


@virtual_time
async def test_a_controlword_by_hand_enables_the_axis_that_it_is_for() -> None:
    async with simulated(makers=[two_axes]) as host, open_master(BUS) as master:
        node = master.node(3, TWO)
        await node.start()
        for word in (6, 7, 15):
            await node.write("controlword_axis_1", word)
        assert node.axes_enabled == (1,)
        assert drives(host)[0].values.store[mux(0x6807)] == 3
        assert state_of(await node.read_int("statusword_axis_1")) is State.OPERATION_ENABLED
        await node.write(0x6840, 0)
        assert not node.was_enabled


@virtual_time
async def test_the_blocking_api_gives_a_further_axis_no_set_points_of_the_first_one() -> None:
    dictionary = TWO.with_names_of(load_dictionary()[0])
    names = [each.name for each in dictionary.pdos]
    assert "schunk_default_rPDO" in names
    async with simulated(makers=[two_axes]) as host, open_master(BUS) as master:
        node = master.node(3, dictionary)
        await node.start()
        second = DirectDrive(master, master.device(node, settings=SETTINGS, axis=1), "schunk_default_rPDO", "schunk_default_tPDO")
        assert not node.remote.rpdos
        await second.change_state(State.OPERATION_ENABLED)
        await second.set_interval(10)
        assert [each.state for each in drives(host)[0].drives] == [State.SWITCH_ON_DISABLED, State.OPERATION_ENABLED]
        for refused in (second.follow(), second.define(dictionary.pdo("schunk_default_rPDO"), None, 1)):
            with pytest.raises(LocalProtocolError, match=r"drive 3, axis 1. Try: a chain"):
                await refused


MACHINE = """
[buses.can0]
locator = "{bus}"
[nodes.shoulder]
id = 3
file = "two.eds"
[joints.one]
node = "shoulder"
unit = "degree"
counts_per_unit = 1000.0
[joints.two]
node = "shoulder"
axis = 1
unit = "degree"
counts_per_unit = 1000.0
[chains.arm]
joints = ["one", "two"]
"""


def test_a_machine_file_has_joints_on_the_axes_of_a_node() -> None:
    machine = parse_machine(MACHINE.format(bus=BUS))
    assert [(each.node, each.axis) for each in machine.joints.values()] == [("shoulder", 0), ("shoulder", 1)]
    assert machine.joint_on(machine.nodes["shoulder"], 1) is machine.joints["two"]
    assert parse_machine(machine_text(machine)) == machine
    twice = MACHINE.format(bus=BUS).replace("axis = 1", "axis = 0")
    with pytest.raises(DictionaryError, match="joints.two: it has node and axis of 'one'"):
        parse_machine(twice)
    for wrong in ("8", "-1", "true", '"1"'):
        with pytest.raises(DictionaryError, match="axis.*of 0..7"):
            parse_machine(MACHINE.format(bus=BUS).replace("axis = 1", f"axis = {wrong}"))
