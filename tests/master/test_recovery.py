"""After an emergency stop, a joint without power, a loose cable, bus-off or a killed master: what the drives do, and what brings
the chain back. docs/recovery.md is the table of these tests."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from canopen_master import (
    ChainError,
    ChainState,
    MasterError,
    open_master,
)
from canopen_proto.drives.cia402 import objects
from canopen_proto.drives.cia402.states import State
from canopen_proto.simulation.drive.settings import DriveSettings, Track
from canopen_transports import BusState, BusStateChanged, Received, Report
from tests.drives.drive_dictionaries import changed, empty_pdos, supports
from tests.loops import Channel, loop
from tests.master.cell import WATCHDOG, assert_moves, assert_moves_back, chain_of, fails, homed_arm, joints, move
from tests.master.world import Link, position_of, value, virtual_time

# ---- emergency stop ----


@pytest.mark.thorough(2)
@pytest.mark.parametrize("code", [0, 0xFF01])
@virtual_time
async def test_an_emergency_stop_while_it_moves(code: int) -> None:
    """code: of the fault that the drive makes of "safe torque off"; 0: it just loses its power."""
    async with homed_arm(3, 4, drive=DriveSettings(sto_fault=code)) as ((one, two), arm):
        fault = await fails(arm, two.press_emergency_stop)
        assert fault.joint == "joint2"
        assert two.state is (State.FAULT if code else State.SWITCH_ON_DISABLED)
        assert two.node.values.store[objects.TORQUE_ACTUAL_VALUE] == 0
        if code:
            assert fault.error_code == code
        else:
            assert "left operation enabled by itself: switch on disabled" in fault.reason
            assert fault.cause == "safe torque off is active (bit 31 of 0x60FD:00 is 1)"
            assert fault.tries[0].startswith("release the emergency stop")
        assert one.state is State.OPERATION_ENABLED
        assert await one.stands()
        for _ in range(2):  # still pressed
            with pytest.raises(ChainError, match="joint2") as pressed:
                await arm.recover()
            assert ("0xFF01" if code else "safe torque off is active") in str(pressed.value)
        two.release_emergency_stop()
        await arm.recover()
        assert arm.is_homed
        await assert_moves(arm)


@virtual_time
async def test_an_emergency_stop_at_boot() -> None:
    """Connecting does not fail: only what needs power does, and says why."""
    async with joints(3, 4, drive=DriveSettings(torque_is_off=True)) as made, open_master(Link()) as master:
        arm = chain_of(master, 3, 4)
        assert await arm.devices[0].node.read("statusword") is not None
        with pytest.raises(ChainError, match="did not reach operation enabled") as pressed:
            await arm.initialise()
        assert pressed.value.cause == "safe torque off is active (bit 31 of 0x60FD:00 is 1)"
        with pytest.raises(ChainError, match="it is off"):
            await arm.home()
        for joint in made:
            joint.release_emergency_stop()
        await arm.initialise()
        await arm.home()
        await arm.follow()
        await assert_moves(arm)


# ---- power, cables, the bus ----


@virtual_time
async def test_a_joint_that_is_power_cycled() -> None:
    async with homed_arm(3, 4) as ((one, two), arm):
        async with loop.open_nursery() as nursery:
            fault = await fails(arm, lambda: nursery.start_soon(two.switch_off))
        assert fault.joint == "joint2"
        assert await one.stands()
        with pytest.raises(ChainError, match="joint2.*did not answer") as silent:  # still off
            await arm.recover()
        assert "power" in str(silent.value)
        await two.switch_on()
        with pytest.raises(ChainError, match="joint2 .* has lost its reference") as lost:
            await arm.recover()
        assert "await chain.home(if_needed=True), then await chain.follow()" in str(lost.value)
        assert arm.state is ChainState.READY
        assert [joint.state for joint in (one, two)] == [State.OPERATION_ENABLED] * 2
        # All that the boot took from it is there again: what it watches, what it sends
        assert value(two.node, objects.ABORT_CONNECTION_OPTION_CODE) == 3
        assert value(two.node, 0x1017_00) == 100
        assert value(two.node, 0x1016_01) == 127 << 16 | 500
        before = position_of(one.host, one.node)
        await arm.home(if_needed=True)
        assert position_of(one.host, one.node) == before
        await arm.enable_interpolated_position()
        await assert_moves(arm)


@pytest.mark.thorough(5)
@pytest.mark.parametrize("mode", [8, 7, 1])
@virtual_time
async def test_a_joint_that_is_power_cycled_gets_its_mapping_again(mode: int) -> None:
    """In csp, ip and slowly in pp. Its file has no PDOs: the chain maps them, and a boot forgets that."""
    dictionary = changed({**supports(0x20 | 1 << (mode - 1)), **empty_pdos()})
    async with homed_arm(3, 4, dictionary=dictionary) as ((_, two), arm):
        assert [device.plan.mode for device in arm.devices if device.plan is not None] == [mode] * 2
        counts = [index << 8 for index in (*range(0x1600, 0x1604), *range(0x1A00, 0x1A04))]
        mapped = [value(two.node, count) for count in counts]
        assert any(mapped)
        async with loop.open_nursery() as nursery:
            await fails(arm, lambda: nursery.start_soon(two.switch_off))
        await two.switch_on()
        assert not any(value(two.node, count) for count in counts)
        with pytest.raises(ChainError, match="joint2 .* has lost its reference"):
            await arm.recover()
        await arm.home(if_needed=True)
        await arm.follow()
        assert two.node.drive.mode == mode
        assert [value(two.node, count) for count in counts] == mapped
        await assert_moves(arm)


@virtual_time
async def test_all_joints_that_lost_their_reference_are_named() -> None:
    async with homed_arm(3, 4) as (made, arm):
        async with loop.open_nursery() as nursery:
            await fails(arm, lambda: [nursery.start_soon(joint.switch_off) for joint in made])
        for joint in made:
            await joint.switch_on()
        with pytest.raises(ChainError, match="joint1 .*, joint2 .* have lost their references"):
            await arm.recover()


@virtual_time
async def test_the_cable_of_a_joint_is_pulled_and_plugged() -> None:
    async with homed_arm(3, 4) as ((one, two), arm):
        fault = await fails(arm, two.pull_cable)
        assert (fault.joint, "is silent" in fault.reason) == ("joint2", True)
        await loop.sleep(WATCHDOG + 0.2)
        assert two.state is State.SWITCH_ON_DISABLED  # a quick stop, by its watchdog
        assert await two.stands()
        assert one.state is State.OPERATION_ENABLED
        assert await one.stands()
        with pytest.raises(ChainError, match="joint2.*did not answer"):
            await arm.recover()
        two.plug_cable()
        await arm.recover()
        assert arm.is_homed
        await assert_moves(arm)


@virtual_time
async def test_the_cable_of_the_master_is_pulled_and_plugged() -> None:
    cable = Link()
    async with homed_arm(3, 4, cable=cable) as ((one, two), arm):

        def pull() -> None:
            cable.copies = lambda frame, is_sent: 0

        await fails(arm, pull)
        await loop.sleep(WATCHDOG + 0.2)
        for joint in (one, two):
            assert joint.state is State.SWITCH_ON_DISABLED
            assert await joint.stands()
        cable.copies = lambda frame, is_sent: 1
        await arm.recover()
        assert arm.is_homed
        await assert_moves(arm)


@virtual_time
async def test_a_reference_that_was_lost_behind_a_pulled_cable() -> None:
    """Its boot-up was not heard. But the objects are gone by which the drive watches its master."""
    async with homed_arm(3, 4) as ((_, two), arm):
        await fails(arm, two.pull_cable)
        await two.switch_off()
        await two.switch_on(is_plugged=False)
        two.plug_cable()
        with pytest.raises(ChainError, match="joint2 .* has lost its reference"):
            await arm.recover()
        await arm.home()
        await arm.enable_interpolated_position()
        await assert_moves(arm)


@virtual_time
async def test_a_heartbeat_that_is_lost() -> None:
    async with homed_arm(3, 4) as ((one, two), arm):

        def lose() -> None:
            two.cable.copies = lambda frame, is_sent: int(not (is_sent and frame.key == 0x704))

        fault = await fails(arm, lose)
        assert fault.reason == "was lost: no heartbeat for 0.3 s"
        for joint in (one, two):
            assert joint.state is State.OPERATION_ENABLED
            assert await joint.stands()
        two.plug_cable()
        await arm.recover()
        assert arm.is_homed
        await assert_moves(arm)


class BusOff(Link):
    """A line whose controller can be made bus-off: it loses all frames, and says so."""

    def __init__(self) -> None:
        super().__init__()
        self._reports: Channel[BusStateChanged] = Channel()

    def change(self, state: BusState) -> None:
        self.copies = lambda frame, is_sent: int(state is not BusState.BUS_OFF)
        self._reports.send(BusStateChanged(self.locator, state, "by the test"))

    async def receive(self) -> Received | Report:  # type: ignore[override]
        got: list[Received | Report] = []
        async with loop.open_nursery() as nursery:

            async def first(source: Callable[[], object]) -> None:
                got.append(await source())  # type: ignore[misc]
                nursery.cancel_scope.cancel()

            nursery.start_soon(first, super().receive)
            nursery.start_soon(first, self._reports.receive)
        return got[0]


@virtual_time
async def test_bus_off_and_back() -> None:
    line = BusOff()
    async with homed_arm(3, 4, cable=line) as ((one, two), arm):
        await fails(arm, lambda: line.change(BusState.BUS_OFF))
        with pytest.raises(ChainError, match="is bus-off") as away:
            await arm.recover()
        assert "bus-off: by the test" in str(away.value)
        await loop.sleep(WATCHDOG + 0.2)
        for joint in (one, two):
            assert joint.state is State.SWITCH_ON_DISABLED
            assert await joint.stands()
        line.change(BusState.ACTIVE)
        await arm.recover()
        assert arm.is_homed
        await assert_moves(arm)


# ---- the master ----


@pytest.mark.thorough(5)
@pytest.mark.parametrize("moves", [True, False])
@pytest.mark.parametrize("pause", [0.1, 0.7])
@virtual_time
async def test_a_master_that_is_killed_and_started_again(moves: bool, pause: float) -> None:
    """pause: until it is started again; after 0.5 s its drives have stopped by themselves."""
    async with joints(3, 4) as made, loop.open_nursery() as nursery:
        cable = Link()

        async def first() -> None:
            with suppress(MasterError):
                async with open_master(cable) as master:
                    arm = chain_of(master, 3, 4)
                    await arm.initialise()
                    await arm.home()
                    if moves:
                        await arm.enable_interpolated_position()
                        await move(arm, 10_000)
                    await loop.sleep_forever()

        nursery.start_soon(first)
        await loop.sleep(3)
        cable.copies = lambda frame, is_sent: 0  # kill -9
        await loop.sleep(pause)
        expected = State.SWITCH_ON_DISABLED if pause > WATCHDOG else State.OPERATION_ENABLED
        assert [joint.state for joint in made] == [expected] * 2
        async with open_master(Link()) as master:
            arm = chain_of(master, 3, 4)
            await arm.initialise()
            for joint in made:
                assert joint.state is State.OPERATION_ENABLED
                assert await joint.stands()
            await arm.enable_interpolated_position()  # a new process has lost no reference
            await assert_moves(arm)
            await arm.home()
            await arm.enable_interpolated_position()
            await assert_moves(arm)
        nursery.cancel_scope.cancel()


# ---- a limit ----


@virtual_time
async def test_a_chain_moves_away_from_an_internal_limit() -> None:
    async with homed_arm(3, 4) as ((one, _), arm):
        await move(arm)
        limit = position_of(one.host, one.node) + 500
        one.node.values.store[objects.MAX_SOFTWARE_POSITION_LIMIT] = limit
        fault = await fails(arm, lambda: None)
        assert "is held by a limit of its own: bit 11" in fault.reason
        await arm.recover()
        await assert_moves_back(arm)
        assert not one.node.values.store[objects.STATUSWORD] & 0x800  # type: ignore[operator]


@virtual_time
async def test_a_chain_moves_away_from_a_limit_switch() -> None:
    async with homed_arm(3, 4, drive=DriveSettings(position=0, track=Track(positive_limit=3_000))) as ((one, _), arm):
        fault = await fails(arm, lambda: None)
        assert fault.cause == "it stands on its positive limit switch (0x60FD)"
        assert "move it the other way, then await chain.recover()" in fault.tries[0]
        assert 3_000 <= position_of(one.host, one.node) < 3_500
        await arm.recover()
        await assert_moves_back(arm)
        assert position_of(one.host, one.node) < 3_000
        assert not one.node.values.store[objects.STATUSWORD] & 0x800  # type: ignore[operator]


def test_the_page_of_recoveries_names_these_tests_and_no_others() -> None:
    page = (Path(__file__).parents[2] / "docs" / "recovery.md").read_text(encoding="utf-8")
    here = {name for name in globals() if name.startswith("test_") and "page" not in name}
    assert set(re.findall(r"`(test_[a-z_]+)`", page)) == here
