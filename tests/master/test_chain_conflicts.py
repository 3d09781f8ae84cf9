"""A chain does one thing at a time; and what a joint may lack or refuse."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from canopen_master import (
    Chain,
    ChainDescription,
    ChainError,
    ChainHaltedError,
    ChainSettings,
    ChainState,
    JointDescription,
    open_master,
)
from canopen_proto.dictionary import ObjectDictionary
from canopen_proto.drives import axis as drive
from canopen_proto.drives.cia402.states import State
from canopen_proto.frame import Frame
from canopen_proto.machine import SECOND, Outbox
from canopen_proto.nmt import NmtState
from canopen_proto.simulation.drive.dictionary import drive_dictionary
from canopen_proto.simulation.drive.node import DriveNode
from canopen_proto.simulation.drive.settings import DriveSettings, Shape
from canopen_transports import Transport, open_transport
from tests.master.loops import loop, settled
from tests.master.world import (
    BUS,
    arm_of,
    assert_all_halted,
    assert_all_stand,
    chain_text,
    drives,
    following_arm,
    simulated,
    virtual_time,
)

# ---- one thing at a time ----


@virtual_time
async def test_what_a_chain_is_not_ready_for() -> None:
    async with simulated(3), open_master(BUS) as master:
        arm = arm_of(master, 3)
        for call in (arm.home, arm.enable_interpolated_position):
            with pytest.raises(ChainError, match="it is off") as caught:
                await call()
            assert caught.value.code == "CO404"
            assert caught.value.tries == ("await chain.initialise()",)
        await arm.initialise()
        with pytest.raises(ChainError, match="it is ready") as caught:
            arm.set_positions([0])
        assert caught.value.tries == ("await chain.follow()",)
        async with loop.open_nursery() as nursery:
            nursery.start_soon(arm.home)
            await settled()
            with pytest.raises(ChainError, match="it is busy: home"):
                await arm.initialise()
        await arm.halt()
        assert arm.state is ChainState.HALTED
        await arm.home()  # from a halt


@virtual_time
async def test_halt_ends_what_is_under_way() -> None:
    async with simulated(3, 4) as host, open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        await arm.halt()
        assert arm.state is ChainState.OFF
        await arm.initialise()
        ended = []

        async def homing() -> None:
            with pytest.raises(ChainHaltedError, match=r"halted by halt\(\)"):
                await arm.home()
            ended.append("home")

        async with loop.open_nursery() as nursery:
            nursery.start_soon(homing)
            await loop.sleep(0.3)
            nursery.start_soon(arm.halt)
            await arm.halt()
            assert_all_halted(host)
        assert ended == ["home"]
        assert arm.state is ChainState.HALTED
        await assert_all_stand(host)
        await arm.recover()
        assert arm.state is ChainState.READY


@virtual_time
async def test_shut_down_ends_what_is_under_way() -> None:
    async with simulated(3) as host, open_master(BUS) as master:
        arm = arm_of(master, 3)
        await arm.initialise()

        async def homing() -> None:
            with pytest.raises(ChainError):
                await arm.home()

        async with loop.open_nursery() as nursery:
            nursery.start_soon(homing)
            await loop.sleep(0.3)
            await arm.shut_down()
        assert drives(host)[0].drive.state is State.SWITCH_ON_DISABLED
        assert arm.state is ChainState.OFF


@virtual_time
async def test_a_joint_that_cannot_be_shut_down_does_not_keep_the_others_from_it() -> None:
    async with simulated(3, 4) as host:
        with pytest.raises(ChainError, match="could not shut down: joint1") as caught:
            async with open_master(BUS) as master:
                arm = arm_of(master, 3, 4)
                await arm.initialise()
                master.sync_stop()
                await loop.sleep(0.2)
                host.nodes[0].sdo.disable()
                await arm.shut_down()
        assert caught.value.code == "CO201"
        assert drives(host)[1].drive.state is State.SWITCH_ON_DISABLED
        assert host.nodes[1].state is NmtState.STOPPED


@virtual_time
async def test_two_joints_that_cannot_be_halted_are_both_told() -> None:
    async with simulated(3, 4) as host:
        with pytest.raises(ChainError, match="could not halt: joint1") as caught:
            async with open_master(BUS) as master:
                arm = arm_of(master, 3, 4)
                await arm.initialise()
                master.sync_stop()
                await loop.sleep(0.2)
                for node in host.nodes:
                    node.sdo.disable()
                await arm.halt()
        assert any("joint2" in note for note in caught.value.__notes__)


@virtual_time
async def test_two_chains_share_one_sync() -> None:
    async with simulated(3, 4), open_master(BUS) as master:
        one = arm_of(master, 3)
        description = ChainDescription("other", (JointDescription("j", BUS, 4),))
        other = master.chain(description, ChainSettings(cycle_time=0.02))
        await one.initialise()
        with pytest.raises(ChainError, match="SYNC runs with 0.01 s for arm"):
            await other.initialise()
        await one.shut_down()
        await other.initialise()
        assert master.sync_period == 20_000_000
        await other.shut_down()
        assert master.sync_period == 0


@virtual_time
async def test_a_chain_that_stays_keeps_sync_running() -> None:
    async with simulated(3, 4), open_master(BUS) as master:
        chains = master.load_chains(text="one j can0 3\ntwo j can0 4\n")
        for chain in chains.values():
            await chain.initialise()
        await chains["one"].shut_down()
        assert master.sync_period == 10_000_000


@virtual_time
async def test_a_joint_that_is_not_there() -> None:
    async with simulated(3) as host, open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        with pytest.raises(ChainError) as caught:
            await arm.initialise()
        error = caught.value
        assert (error.chain, error.joint, error.code) == ("arm", "joint2", "CO201")
        assert "could not initialise: joint2 (node 4 on virtual:test): node 4 did not answer" in str(error)
        assert "nothing was heard of it" in error.seen
        assert drives(host)[0].drive.state is State.SWITCH_ON_DISABLED


def powerball_without(index: int, node_id: int) -> Callable[[Outbox], DriveNode]:
    objects = [each for each in drive_dictionary(Shape.SCHUNK_POWERBALL).objects.values() if each.index != index]
    settings = DriveSettings(shape=Shape.SCHUNK_POWERBALL)
    return lambda out: DriveNode(out, node_id, settings, ObjectDictionary(objects))


@virtual_time
async def test_a_device_without_a_heartbeat_is_taken_as_it_is() -> None:
    async with simulated(makers=[powerball_without(0x1017, 3)]), open_master(BUS, heartbeat_timeout=1) as master:
        joint = master.device(master.node(3))
        arm = Chain(master, "arm", [joint], ChainSettings())
        await arm.initialise()
        assert arm.state is ChainState.READY


@virtual_time
async def test_a_drive_that_lacks_the_mode() -> None:
    async with simulated(3) as host, open_master(BUS) as master:
        arm = arm_of(master, 3)
        await arm.initialise()
        drives(host)[0].values.store[0x6502_00] = 1
        with pytest.raises(ChainError, match="does not support interpolated position") as caught:
            await arm.enable_interpolated_position()
        assert caught.value.code == "CO401"
        assert arm.state is ChainState.READY


@virtual_time
async def test_a_device_that_refuses_what_initialise_asks() -> None:
    async with simulated(4, makers=[powerball_without(0x1000, 3)]), open_master(BUS) as master:
        with pytest.raises(ChainError, match="node 3 refused reading 0x1000:00") as caught:
            await arm_of(master, 3, 4).initialise()
        assert (caught.value.code, caught.value.joint) == ("CO202", "joint1")


@virtual_time
async def test_a_device_whose_answer_is_not_taken() -> None:
    async def answer(transport: Transport) -> None:
        while True:
            frame, _ = await transport.receive()
            if frame.can_id == 0x603:
                await transport.send(Frame.parse("583#41001000FFFFFFFF"))  # 4 GB are to follow

    async with await open_transport(BUS) as device, loop.open_nursery() as nursery, open_master(BUS) as master:
        nursery.start_soon(answer, device)
        with pytest.raises(ChainError, match="of node 3 was given up: 0x05040005") as caught:
            await arm_of(master, 3).initialise()
        assert caught.value.code == "CO203", "nobody refused"
        nursery.cancel_scope.cancel()


@virtual_time
async def test_a_device_that_does_not_take_a_pdo() -> None:
    async with simulated(3), open_master(BUS) as master:
        settings = ChainSettings(rpdo="csv_rPDO", define_pdos=True)
        arm = master.load_chains(text=chain_text(3), settings=settings)["arm"]
        with pytest.raises(ChainError, match="RPDO 1 of node 3") as caught:
            await arm.initialise()
        assert caught.value.code == "CO401"


@virtual_time
async def test_cancelled_while_waiting_for_a_cycle() -> None:
    async with following_arm(3) as (_, _, arm):
        start = arm.positions
        with loop.move_on_after(0.123) as scope:
            async for _cycle in arm.cycles():
                arm.set_positions(start)
        assert scope.cancelled_caught
        assert arm.state is ChainState.FOLLOWING
        cycles = arm.cycles()
        assert (await cycles.__anext__()).number == 0


# ---- a joint of it, commanded by hand ----


@virtual_time
async def test_a_joint_that_follows_set_points_takes_no_other_motion() -> None:
    async with following_arm(3, 4) as (_, master, arm):
        axis = arm.devices[0].axis
        for command in (drive.home(axis), drive.move_to(axis, 0.1, timeout=SECOND), drive.set_mode(axis, 1), drive.enable(axis)):
            with pytest.raises(drive.AxisBusyError, match="chain arm is under way; nothing was sent"):
                await master.run(command)
        async for cycle in arm.cycles():
            arm.hold()
            if cycle.number == 5:
                break
        assert arm.state is ChainState.FOLLOWING
        await arm.halt()
        await master.run(drive.set_mode(axis, 1))


@virtual_time
async def test_a_joint_that_is_stopped_by_hand_halts_its_chain() -> None:
    async with following_arm(3, 4) as (host, master, arm):
        await master.run(drive.engage_brake(arm.devices[0].axis))
        with pytest.raises(ChainHaltedError, match=r"another command took over joint1 \(node 3 .*\): engage_brake"):
            arm.set_positions(arm.positions)
        await arm.halt()
        assert drives(host)[0].drive.state is State.READY_TO_SWITCH_ON
        await assert_all_stand(host)
        await arm.recover()
        assert arm.state is ChainState.FOLLOWING


@virtual_time
async def test_a_joint_that_is_moved_by_hand_refuses_the_chains_homing_and_its_halt_ends_it() -> None:
    async with simulated(3) as host, open_master(BUS) as master, loop.open_nursery() as nursery:
        arm = arm_of(master, 3)
        await arm.initialise()
        ended = []

        async def moving() -> None:
            with pytest.raises(drive.TakenOverError, match="was taken from home: halt took over"):
                await master.run(drive.home(arm.devices[0].axis))
            ended.append("home")

        nursery.start_soon(moving)
        await loop.sleep(0.3)
        with pytest.raises(ChainError, match="cannot home now") as caught:
            await arm.home()
        assert caught.value.cause == "home is under way; nothing was sent"
        assert not ended
        await arm.halt()
        assert ended
        await assert_all_stand(host)


@virtual_time
async def test_a_follow_that_fails_leaves_no_joint_occupied() -> None:
    async with simulated(3, 4) as host, open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        await arm.initialise()
        drives(host)[1].values.store[0x6502_00] = 1
        with pytest.raises(ChainError, match="does not support interpolated position"):
            await arm.follow()
        assert [device.axis.occupancy.occupant for device in arm.devices] == [None, None]
