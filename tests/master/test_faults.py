"""A joint that fails stops its whole chain, and the error says which one, and why."""

import dataclasses
import re
from collections.abc import Callable
from typing import Any

import pytest

from canopen_master import Chain, ChainError, ChainFaultError, ChainState, Host, open_master, powerballs, simulate
from canopen_proto.drives.axis.axis import SCHUNK_POWERBALL
from canopen_proto.drives.cia402.states import State
from canopen_proto.nmt import NmtCommand, NmtState
from canopen_transports import ReceiveOverrun, open_transport
from tests.loops import jump, loop
from tests.master.world import (
    BUS,
    arm_of,
    assert_all_halted,
    assert_all_stand,
    chain_text,
    drives,
    following_arm,
    position_of,
    simulated,
    value,
    virtual_time,
)


async def follow(arm: Chain, cycles: int = 1000, at: int = -1, do: Callable[[], object] = lambda: None) -> int:
    """Move along; in cycle `at`, do something."""
    start = arm.positions
    number = 0
    async for cycle in arm.cycles():
        arm.set_positions([position + 0.001 * cycle.number for position in start])
        number = cycle.number
        if number == at:
            do()
        if number >= cycles:
            break
    return number


def fault(host: Host, index: int, code: int = 0x3220) -> None:
    drives(host)[index].raise_fault(code, host.now())
    host.pump()


@virtual_time
async def test_a_fault_in_the_middle_of_a_move() -> None:
    async with following_arm(3, 4, 5) as (host, _, arm):
        with pytest.raises(ChainFaultError) as caught:
            await follow(arm, at=50, do=lambda: fault(host, 1))
        error = caught.value
        assert (error.chain, error.joint, error.node_id, error.bus) == ("arm", "joint2", 4, BUS)
        assert error.code == "CO402"
        assert error.state is State.FAULT
        assert error.statusword & 0x4F == 0x08
        assert error.error_code == 0x3220
        assert error.emcy is not None
        assert error.emcy.code == 0x3220
        text = str(error)
        assert "chain arm was stopped: joint2 (node 4 on virtual:test) fell into fault" in text
        assert f"statusword 0x{error.statusword:04X}: fault" in text
        assert "last EMCY 0x3220" in text
        assert "s ago" in text
        assert "chain.recover()" in text
        assert arm.state is ChainState.FAULT
        assert_all_halted(host)
        await assert_all_stand(host)
        for call in (arm.home, arm.enable_interpolated_position):
            with pytest.raises(ChainFaultError):
                await call()
        with pytest.raises(ChainFaultError):
            arm.set_positions([0, 0, 0])
        await arm.halt()  # allowed, and done
        assert arm.state is ChainState.FAULT


@virtual_time
async def test_recover_goes_on_where_the_joints_stand() -> None:
    async with following_arm(3, 4) as (host, _, arm):
        with pytest.raises(ChainFaultError):
            await follow(arm, at=50, do=lambda: fault(host, 0))
        await loop.sleep(1)
        stood = [position_of(host, node) for node in drives(host)]
        await arm.recover()
        assert arm.state is ChainState.FOLLOWING
        await loop.sleep(0.05)
        assert [position_of(host, node) for node in drives(host)] == stood
        assert await follow(arm, cycles=100) == 100
        await loop.sleep(0.06)
        assert [position_of(host, node) for node in drives(host)] == pytest.approx([each + 5730 for each in stood], abs=2)


@virtual_time
async def test_a_fault_that_stays_is_told_by_recover() -> None:
    async with following_arm(3) as (host, _, arm):
        with pytest.raises(ChainFaultError):
            await follow(arm, at=10, do=lambda: fault(host, 0))
        drives(host)[0].raise_fault(0x4310, host.now(), lasting=True)
        host.pump()
        with pytest.raises(ChainFaultError) as caught:
            await arm.recover()
        assert caught.value.error_code == 0x4310
        assert arm.state is ChainState.OFF


@virtual_time
async def test_a_fault_while_homing_halts_the_others() -> None:
    async with simulated(3, 4) as host, open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        await arm.initialise()
        async with loop.open_nursery() as nursery:

            async def homing() -> None:
                with pytest.raises(ChainFaultError, match="joint2"):
                    await arm.home()

            nursery.start_soon(homing)
            await loop.sleep(0.3)
            fault(host, 1)
        assert_all_halted(host)
        await assert_all_stand(host)
        assert arm.state is ChainState.FAULT
        assert not arm.is_homed


@virtual_time
async def test_a_fault_between_two_commands_is_told_by_the_next() -> None:
    async with simulated(3) as host, open_master(BUS) as master:
        arm = arm_of(master, 3)
        await arm.initialise()
        fault(host, 0, 0x4310)
        await loop.sleep(0.5)
        with pytest.raises(ChainFaultError, match="0x4310"):
            await arm.home()


@virtual_time
async def test_a_joint_that_is_switched_on_just_now_is_initialised() -> None:
    """Its boot-up aborts the first request, which was sent before it; the joint is there all the same."""
    async with open_master(BUS) as master, loop.open_nursery() as nursery:
        arm = arm_of(master, 3)
        initialised = loop.event()

        async def initialise() -> None:
            await arm.initialise()
            initialised.set()

        nursery.start_soon(initialise)
        await loop.sleep(0.1)
        await nursery.start(simulate, await open_transport(BUS), powerballs(3))
        await initialised.wait()
        assert arm.devices[0].state is State.OPERATION_ENABLED
        await arm.shut_down()
        nursery.cancel_scope.cancel()


@pytest.mark.parametrize("heartbeat", [0, 100_000_000])
def test_joints_that_an_earlier_program_left_stopped_are_initialised(heartbeat: int) -> None:
    @virtual_time
    async def test() -> None:
        async with simulated(3, 4) as host:
            for node in host.nodes:
                node.communication.heartbeat.set_period(heartbeat, host.now())
            for _ in range(2):
                async with open_master(BUS) as master:
                    arm = arm_of(master, 3, 4)
                    await loop.sleep(1)  # heard, where it has a heartbeat
                    await arm.initialise()
                    assert [node.drive.state for node in drives(host)] == [State.OPERATION_ENABLED] * 2
                    await arm.shut_down()
                assert [node.nmt.state for node in host.nodes] == [NmtState.STOPPED] * 2

    test()


@virtual_time
async def test_a_fault_at_power_on_is_reset_by_initialise() -> None:
    async with simulated(3) as host, open_master(BUS) as master:
        fault(host, 0)
        await loop.sleep(1)
        arm = arm_of(master, 3)
        await arm.initialise()
        assert drives(host)[0].drive.state is State.OPERATION_ENABLED


def _disable_by_hand(host: Host) -> None:
    node = drives(host)[0]
    node.values.store[0x6040_00] = 6
    node.drive.written(0x6040, 0, host.now())
    host.pump()


def _reset(host: Host) -> None:
    host.nodes[0].execute(NmtCommand.RESET_NODE, host.now())
    host.pump()


def _pre_operational(host: Host) -> None:
    host.nodes[0].communication.heartbeat.set_period(20_000_000, host.now())
    host.nodes[0].execute(NmtCommand.ENTER_PRE_OPERATIONAL, host.now())
    host.pump()


def _mute_tpdos(host: Host) -> None:
    host.nodes[0].pdos.set_enabled(False, host.now())


@pytest.mark.parametrize(
    ("do", "reason"),
    [
        (_disable_by_hand, "left operation enabled by itself: ready to switch on"),
        (_reset, "it has booted again"),
        (_pre_operational, "left NMT state Operational: PRE_OPERATIONAL"),
        (_mute_tpdos, "is silent: no PDO with its statusword for 30 ms, behind 3 SYNCs"),
    ],
)
def test_other_ways_to_fail(do: Callable[[Host], Any], reason: str) -> None:
    @virtual_time
    async def test() -> None:
        async with following_arm(3, 4) as (host, _, arm):
            with pytest.raises(ChainFaultError) as caught:
                await follow(arm, at=50, do=lambda: do(host))
            assert reason in caught.value.reason
            assert caught.value.joint == "joint1"
            assert value(drives(host)[1], 0x6040_00) & 0x100

    test()


@pytest.mark.parametrize("cycles", [3, 10])
def test_how_long_a_joint_may_be_silent_is_a_setting(cycles: int) -> None:
    @virtual_time
    async def test() -> None:
        async with following_arm(3, max_silent_cycles=cycles) as (host, _, arm):
            with pytest.raises(ChainFaultError, match=f"for {cycles * 10} ms, behind {cycles} SYNCs") as caught:
                await follow(arm, at=5, do=lambda: _mute_tpdos(host))
            assert "cause: its power is off, its cable is loose" in str(caught.value)

    test()


@virtual_time
async def test_frames_that_were_lost_here_are_the_likely_cause_of_a_silence() -> None:
    async with following_arm(3) as (host, master, arm):

        def lose() -> None:
            _mute_tpdos(host)
            lost = ReceiveOverrun("virtual:bus", 12, "the kernel's receive buffer for this socket was full")
            master.bus().take_in(iter((lost,)), master.now())

        with pytest.raises(ChainFaultError, match="is silent: no PDO") as caught:
            await follow(arm, at=5, do=lose)
        assert re.search(r"cause: received frames were lost here \d+ ms ago, 12 at least: the kernel's", str(caught.value))
        assert "its cable is loose" not in str(caught.value)


@virtual_time
async def test_a_stall_of_this_process_is_no_silence_of_the_joints() -> None:
    """They send behind SYNC, and there was none."""

    def stall() -> None:
        jump(0.3)

    async with following_arm(3, 4) as (_, _, arm):
        await follow(arm, at=50, do=stall)
        assert arm.skipped_cycles >= 29
        assert arm.state is ChainState.FOLLOWING


@virtual_time
async def test_a_lost_heartbeat_stops_the_chain() -> None:
    async with simulated(3, 4) as host, open_master(BUS, heartbeat_timeout=0.3) as master:
        arm = arm_of(master, 3, 4)
        await arm.initialise()
        await arm.enable_interpolated_position()

        def unplug() -> None:
            host.nodes[1].communication.heartbeat.set_period(0, host.now())

        with pytest.raises(ChainFaultError, match="joint2.*was lost: no heartbeat for 0.3 s"):
            await follow(arm, at=50, do=unplug)
        assert_all_halted(host)


@virtual_time
async def test_a_second_fault_does_not_hide_the_first() -> None:
    async with following_arm(3, 4) as (host, _, arm):
        with pytest.raises(ChainFaultError):
            await follow(arm, at=20, do=lambda: fault(host, 1))
        fault(host, 0)
        await loop.sleep(1)
        with pytest.raises(ChainFaultError, match="joint2"):
            arm.hold()
        await arm.shut_down()
        assert arm.state is ChainState.OFF


@virtual_time
async def test_a_joint_that_was_shut_down_is_supervised_no_more() -> None:
    async with following_arm(3) as (host, _, arm):
        await arm.shut_down()
        await loop.sleep(0.001)  # the NMT command is handed over by now, and also handled
        _reset(host)
        await loop.sleep(1)
        assert arm.state is ChainState.OFF
        await arm.initialise()
        assert arm.state is ChainState.READY


@virtual_time
async def test_a_reference_that_was_lost_is_lost() -> None:
    async with simulated(3, 4) as host, open_master(BUS) as master:
        arm = arm_of(master, 3, 4)
        await arm.initialise()
        await arm.home()
        await arm.enable_interpolated_position()
        with pytest.raises(ChainFaultError, match="booted again"):
            await follow(arm, at=50, do=lambda: _reset(host))
        stood = [position_of(host, node) for node in drives(host)]
        for _ in range(2):
            with pytest.raises(ChainError, match=r"joint1 .* has lost its reference") as caught:
                await arm.recover()
            assert (caught.value.code, caught.value.joint) == ("CO404", "joint1")
            assert "await chain.home(if_needed=True)" in str(caught.value)
            assert "keeps_reference" in str(caught.value)
            assert arm.state is ChainState.READY
            with pytest.raises(ChainError, match="could not enable interpolated position: joint1"):
                await arm.enable_interpolated_position()
            with pytest.raises(ChainError, match="could not follow set-points: joint1"):
                arm.set_positions([0.0, 0.0])
        assert [position_of(host, node) for node in drives(host)] == stood
        await arm.home()
        assert arm.is_homed
        await arm.enable_interpolated_position()
        assert await follow(arm, cycles=20) == 20


@virtual_time
async def test_a_drive_that_keeps_its_reference_goes_on() -> None:
    async with simulated(3, 4) as host, open_master(BUS) as master:
        axes = dataclasses.replace(SCHUNK_POWERBALL, keeps_reference=True)
        arm = master.load_chains(text=chain_text(3, 4), axes=axes)["arm"]
        await arm.initialise()
        await arm.home()
        await arm.enable_interpolated_position()
        with pytest.raises(ChainFaultError, match="booted again"):
            await follow(arm, at=50, do=lambda: _reset(host))
        await arm.recover()
        assert arm.state is ChainState.FOLLOWING
        assert arm.is_homed
        assert await follow(arm, cycles=20) == 20


@virtual_time
async def test_an_arm_that_was_never_homed_recovers_from_a_reset() -> None:
    async with following_arm(3, 4) as (host, _, arm):
        with pytest.raises(ChainFaultError, match="booted again"):
            await follow(arm, at=50, do=lambda: _reset(host))
        await arm.recover()
        assert arm.state is ChainState.FOLLOWING
